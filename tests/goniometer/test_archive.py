"""Raw counts that were moved out of the database are read as if they had not been, and are never lost on the way."""

import multiprocessing
import os
import shutil
import signal
import sqlite3
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pytest
from sqlalchemy import event

from goniometer.errors import ArchiveMissing, InputError, RawDamaged
from goniometer.geometry import Geometry
from goniometer.radiometry.raw import read_raw
from goniometer.storage import look_up
from goniometer.storage.archive_file import archive_of
from goniometer.storage.store import Store
from goniometer.upkeep.archiving import archive_scan, finished_before, give_back, unarchive_scan
from goniometer.upkeep.backup import back_up
from goniometer.upkeep.integrity import check
from tests.goniometer.test_store import CAMPAIGN, CONSTANTS, spectrum

SPECTRA = 40


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A finished scan of forty spectra, of number 2."""
    opened = Store.open(tmp_path / "bench.db")
    scan_id = opened.scans(opened.add_campaign(CAMPAIGN))[1].id
    opened.set_phase(scan_id, "running")
    opened.save_constants(scan_id, CONSTANTS)
    opened.add_points(scan_id, [Geometry(10.0, -30.0)])
    point = opened.points(scan_id)[0]
    opened.start_point(point.id)
    opened.finish_point(point, Geometry(10.001, -30.002), [spectrum(0), spectrum(1)], "one", 5.0, 2.0, 99.0)
    opened.add_exposures(scan_id, "dark", [spectrum(i) for i in range(2, SPECTRA)], "one", 0.0)
    opened.finish_scan(scan_id, "completed")
    return opened


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where archives go."""
    made = tmp_path / "archive"
    made.mkdir()
    return made


def everything(store: Store) -> list[object]:
    """All that is read of the scan, comparable."""
    told: list[object] = [
        (e.id, e.kind, e.geometry, e.moment, e.taken, e.integration_time, e.counts.tobytes())
        for e in store.exposures(2)
    ]
    return [*told, *(look_up.exposure(store, number)[1].counts.tobytes() for number in (1, SPECTRA))]


def test_an_archived_scan_is_read_calibrated_and_checked_as_before(store: Store, folder: Path, tmp_path: Path) -> None:
    before, raw = everything(store), read_raw(store, 2)
    moved = archive_scan(store, 2, folder)
    assert moved.freed == SPECTRA * 1044 * 4
    with closing(sqlite3.connect(tmp_path / "bench.db")) as outside:
        assert outside.execute("SELECT sum(length(counts)) FROM exposures").fetchone() == (0,)
    assert everything(store) == before
    again = read_raw(store, 2)
    assert [shot.ids for shot in again.shots] == [shot.ids for shot in raw.shots]
    assert np.array_equal(again.darks[0].counts, raw.darks[0].counts)
    assert [e.id for e in store.exposures(2, ("light",))] == [1, 2]
    assert check(store).faults == []
    back_up(store, tmp_path / "copy.db")  # counts that are elsewhere are no damage
    assert archive_scan(store, 2, folder).freed == 0
    back = unarchive_scan(store, 2)
    assert back.freed == -moved.freed
    shutil.rmtree(folder)
    assert everything(store) == before
    assert archive_of(store, 2) is None


def test_the_file_tells_by_itself_what_was_read(store: Store, folder: Path) -> None:
    known = store.exposures(2)
    with h5py.File(archive_scan(store, 2, folder).path, "r") as file:
        assert np.array_equal(file["raw/counts"][()], [e.counts for e in known])
        assert file["raw/counts"].attrs["units"] == "counts"
        assert file["raw/id"][()].tolist() == [e.id for e in known]
        assert np.array_equal(file["raw/wavelength"][()], CONSTANTS.wavelengths)


def test_the_room_is_given_back_to_the_disk(store: Store, folder: Path, tmp_path: Path) -> None:
    archive_scan(store, 2, folder)
    smaller = give_back(store)
    assert smaller is not None
    assert smaller > 0.8 * SPECTRA * 1044 * 4
    with closing(sqlite3.connect(tmp_path / "bench.db")) as outside:
        assert outside.execute("PRAGMA freelist_count").fetchone() == (0,)


def test_a_missing_archive_is_named_and_a_carried_one_is_found(store: Store, folder: Path, tmp_path: Path) -> None:
    before = everything(store)
    path = Path(archive_scan(store, 2, folder).path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.move(path, elsewhere)
    with pytest.raises(ArchiveMissing, match=f"scan 2 .*{path.name}.* not there; .*db archive --scan 2"):
        store.exposures(2)
    with pytest.raises(ArchiveMissing, match=str(path)):
        unarchive_scan(store, 2)
    assert [path.name in fault for fault in check(store).faults] == [True]
    archive_scan(store, 2, elsewhere)
    assert everything(store) == before


@pytest.mark.parametrize("damage", ["cut", "replaced", "counts"])
def test_an_archive_that_was_changed_is_never_taken_for_data(store: Store, folder: Path, damage: str) -> None:
    path = Path(archive_scan(store, 2, folder).path)
    match damage:
        case "cut":
            os.truncate(path, path.stat().st_size // 2)
        case "replaced":
            path.write_bytes(b"something else")
        case "counts":
            with h5py.File(path, "r+") as file:
                file["raw/counts"][3, 5] += 1
    with pytest.raises((ArchiveMissing, RawDamaged)) as caught:
        store.exposures(2)
    assert {"cut": path.name, "replaced": path.name, "counts": "Exposure 4"}[damage] in str(caught.value)
    assert len(check(store).faults) == 1


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE exposures SET counts = x'' WHERE id = 1",
        "UPDATE exposures SET counts = x'00' WHERE id = 1",
        "DELETE FROM exposures WHERE id = 1",
    ],
)
def test_counts_are_not_removed_without_an_archive(store: Store, tmp_path: Path, statement: str) -> None:
    with (
        closing(sqlite3.connect(tmp_path / "bench.db")) as outside,
        pytest.raises(sqlite3.IntegrityError, match="only ever added"),
    ):
        outside.execute(statement)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE exposures SET counts = x'', moment = 7.0 WHERE id = 1",
        "UPDATE exposures SET sha256 = 'other' WHERE id = 1",
        "DELETE FROM archives",
    ],
)
def test_an_archive_allows_nothing_but_the_move(store: Store, folder: Path, tmp_path: Path, statement: str) -> None:
    archive_scan(store, 2, folder)
    with closing(sqlite3.connect(tmp_path / "bench.db")) as outside, pytest.raises(sqlite3.IntegrityError):
        outside.execute(statement)


def test_only_what_has_ended_is_archived(store: Store, folder: Path, tmp_path: Path) -> None:
    assert finished_before(store, "2100-01-01") == [2]
    assert finished_before(store, "2000-01-01") == []
    store.set_phase(2, "running")
    with pytest.raises(InputError, match="Scan 2 has not ended"):
        archive_scan(store, 2, folder)
    with pytest.raises(InputError, match="not archived"):
        unarchive_scan(store, 2)


def test_a_scan_that_goes_on_after_it_was_archived_is_archived_again(store: Store, folder: Path) -> None:
    archive_scan(store, 2, folder)
    store.set_phase(2, "running")
    store.add_exposures(2, "dark", [spectrum(77)], "two", 1.0)
    assert len(store.exposures(2)) == SPECTRA + 1
    store.finish_scan(2, "completed")
    assert archive_scan(store, 2, folder).freed == 1044 * 4
    assert len(store.exposures(2)) == SPECTRA + 1


def _interrupted(file: Path, folder: Path, deed: str, statements: int) -> None:
    """Archive or unarchive, and be killed before the statement of this number, or at the commit behind all."""
    signal.alarm(60)
    store = Store.open(file)
    left = [statements]

    @event.listens_for(store._engine, "before_cursor_execute")
    def stop(*_: object) -> None:
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    if deed == "archive":
        archive_scan(store, 2, folder)
    else:
        unarchive_scan(store, 2)


@pytest.mark.parametrize("deed", ["archive", "unarchive"])
def test_a_kill_at_any_statement_loses_no_count(store: Store, folder: Path, tmp_path: Path, deed: str) -> None:
    before = everything(store)
    if deed == "unarchive":
        archive_scan(store, 2, folder)
    store.close()
    context = multiprocessing.get_context("fork")
    killed = 0
    for statements in range(40):
        process = context.Process(target=_interrupted, args=(tmp_path / "bench.db", folder, deed, statements))
        process.start()
        process.join()
        again = Store.open(tmp_path / "bench.db")
        assert everything(again) == before
        assert check(again).faults == []
        done = (archive_of(again, 2) is None) == (deed == "unarchive")
        again.close()
        if process.exitcode == 0:
            assert done
            break
        assert not done or statements > 5
        killed += 1
    assert killed > 8
