"""What was measured can be had back: from a backup that was made while a campaign went on, never from half of one."""

import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.errors import NotInStore, RawDamaged, StoreBusy, StoreError
from goniometer.storage.database import Database
from goniometer.storage.filesystem import served_by
from goniometer.storage.store import Store
from goniometer.upkeep.backup import back_up, restore
from goniometer.upkeep.integrity import check

CAMPAIGN = Campaign(name="First light", samples=(Sample(name="Rough", material="sample-1"),))
PAIR = [Spectrum(np.random.default_rng(i).integers(0, 200_001, 1044, dtype=np.uint32), 0.1, i, -10.0) for i in (1, 2)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A database with a pair of exposures."""
    path = tmp_path / "bench.db"
    write(path, 1)
    return path


def write(path: Path, pairs: int, enough: Callable[[], bool] = lambda: True) -> None:
    """Add pairs of exposures, each pair in one transaction: so many, and more until it is `enough`."""
    store = Store.open(path)
    scan = store.scans(store.add_campaign(CAMPAIGN))[0].id
    while pairs > 0 or not enough():
        store.add_exposures(scan, "dark", PAIR, "one", 0.0)
        pairs -= 1
    store.close()


def rows(path: Path) -> list[tuple[Any, ...]]:
    """All exposures, read by SQLite alone."""
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT * FROM exposures ORDER BY id").fetchall()


def outside(path: Path, *statements: str) -> None:
    """Change a database as somebody does who goes around the program."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def spoil(path: Path) -> None:
    """Overwrite the middle of a file."""
    with path.open("r+b") as raw:
        raw.seek(path.stat().st_size // 2)
        raw.write(b"\xa5" * 9000)


def test_a_backup_made_while_a_campaign_writes_holds_whole_transactions_and_what_was_committed_before(
    file: Path, tmp_path: Path
) -> None:
    found: list[list[tuple[Any, ...]]] = []
    given_up = threading.Event()
    writer = threading.Thread(target=write, args=(file, 150, lambda: len(found) > 1 or given_up.is_set()))
    writer.start()
    database = Database.as_it_is(file)
    try:
        for number in range(100):
            before = len(rows(file))
            copy = tmp_path / f"copy-{number}.db"
            back_up(database, copy)
            kept = rows(copy)
            assert len(kept) % 2 == 0
            assert len(kept) >= before
            found.append(kept)
            if not writer.is_alive():
                break
    finally:
        given_up.set()
        writer.join()
    whole = rows(file)
    assert len(whole) >= 2 + 300
    assert len(found) > 1
    assert all(kept == whole[: len(kept)] for kept in found)
    assert not list(tmp_path.glob("*.part"))
    database.close()


def test_a_backup_is_one_file_that_replaces_no_other(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    database = Database.as_it_is(file)
    back_up(database, copy)
    assert not copy.with_name("copy.db-wal").exists()
    with pytest.raises(StoreError, match="is there already"):
        back_up(database, copy)
    database.close()
    assert rows(copy) == rows(file)


@pytest.mark.parametrize("folder", ["nowhere", "bench.db", "n" * 300])
def test_a_backup_that_can_be_made_nowhere_names_its_own_file(file: Path, tmp_path: Path, folder: str) -> None:
    target = tmp_path / folder / "copy.db"
    before = rows(file)
    database = Database.as_it_is(file)
    with pytest.raises(StoreError, match=r"^\S+/copy\.db cannot be made: .+; name a file in a folder") as caught:
        back_up(database, target)
    database.close()
    assert str(caught.value).startswith(str(target))
    assert [path.name for path in tmp_path.glob("*.part")] == []
    assert rows(file) == before


def test_a_damaged_database_gives_no_backup(file: Path, tmp_path: Path) -> None:
    write(file, 40)
    database = Database.as_it_is(file)
    spoil(file)
    with pytest.raises(StoreError):
        back_up(database, tmp_path / "copy.db")
    assert not list(tmp_path.glob("copy*"))
    database.close()


def test_a_backup_whose_raw_data_were_changed_is_not_restored(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    database = Database.as_it_is(file)
    back_up(database, copy)
    database.close()
    outside(copy, "DROP TRIGGER exposures_no_update", "UPDATE exposures SET counts = zeroblob(4176) WHERE id = 2")
    before = rows(file)
    with pytest.raises(RawDamaged) as caught:
        restore(copy, file, replace=True)
    assert caught.value.exposure_id == 2
    assert rows(file) == before
    spoil(copy)
    with pytest.raises(StoreError):
        restore(copy, file, replace=True)
    assert rows(file) == before


def test_restoring_brings_back_what_was_and_keeps_what_is(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    database = Database.as_it_is(file)
    back_up(database, copy)
    database.close()
    then = rows(file)
    write(file, 3)
    now = rows(file)
    with pytest.raises(StoreError, match="--replace"):
        restore(copy, file, replace=False)
    kept = restore(copy, file, replace=True)
    assert kept is not None
    assert (rows(file), rows(kept)) == (then, now)
    assert restore(copy, tmp_path / "elsewhere.db", replace=False) is None
    assert rows(tmp_path / "elsewhere.db") == then
    with pytest.raises(NotInStore, match="no backup"):
        restore(tmp_path / "nowhere.db", file, replace=True)


def test_a_damaged_database_is_replaced_by_its_backup_and_its_journal_does_not_spoil_it(
    file: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.db"
    database = Database.as_it_is(file)
    back_up(database, copy)
    then = rows(file)
    database.close()
    file.write_bytes(b"no database" * 500)
    file.with_name("bench.db-wal").write_bytes(b"nor a journal" * 500)
    restore(copy, file, replace=True)
    assert rows(file) == then


def test_a_database_in_use_is_not_replaced(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    store = Store.open(file)
    back_up(store, copy)
    with store.exclusive(), pytest.raises(StoreBusy):  # a campaign runs
        restore(copy, file, replace=True)
    assert store.campaigns()  # somebody looks only, but has it open
    with pytest.raises(StoreBusy):
        restore(copy, file, replace=True)
    store.close()
    restore(copy, file, replace=True)


@pytest.mark.parametrize(
    ("statements", "told"),
    [
        ((), None),
        (("DROP TRIGGER exposures_no_update", "UPDATE exposures SET moment = 9 WHERE id = 1"), "Exposure 1 is not"),
        (("DROP TRIGGER exposures_no_delete", "DELETE FROM campaigns"), "refers to a row of campaigns"),
        (
            (
                "INSERT INTO points (scan_id, number, theta_in, theta_out, status, attempts, reason, seconds) "
                "VALUES (1, 0, 0, 10, 'done', 1, '', 0)",
            ),
            "Point 1 is done",
        ),
        (
            (
                "INSERT INTO datasets (scan_id, sample, kind, points, incident_angles, shortest, longest, flags, "
                "flagged, checks_failed, content_hash, software_version, created, checks, lineage, arrays) VALUES "
                "(1, 'A', 'measured', 1, 1, 1, 2, 0, 0, 0, '', '', '', '[]', '{\"exposures\": [1, 77]}', x'')",
            ),
            "Dataset 1 was made of exposures 77",
        ),
        (("UPDATE alembic_version SET version_num = '0001'",), "db upgrade"),
    ],
)
def test_a_check_names_what_is_wrong(file: Path, statements: tuple[str, ...], told: str | None) -> None:
    outside(file, *statements)
    database = Database.as_it_is(file)
    found = check(database)
    database.close()
    if told is None:
        assert (found.faults, found.exposures) == ([], 2)
    else:
        assert told in found.faults[0]


def test_a_check_sees_a_damaged_file(file: Path) -> None:
    write(file, 40)
    spoil(file)
    database = Database.as_it_is(file)
    assert check(database).faults[0].startswith("The file is damaged")
    database.close()


MOUNTS = r"""
/dev/vda / ext4 rw 0 0
overlay /var overlay rw 0 0
tmpfs /tmp tmpfs rw 0 0
server:/home /home nfs4 rw 0 0
/dev/sdb /home/lab xfs rw 0 0
//nas/share /mnt/two\040words cifs rw 0 0
ada@host: /media/ssh fuse.sshfs rw 0 0
/dev/sdc /over ext4 rw 0 0
host:/x /over nfs rw 0 0
portal /run/portal fuse.portal rw 0 0
""".lstrip()


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("/srv/a.db", None),
        ("/var/a.db", None),
        ("/tmp/a.db", None),
        ("/home/ada/a.db", "nfs4"),
        ("/home/lab/a.db", None),
        ("/homely/a.db", None),
        ("/mnt/two words/deep/a.db", "cifs"),
        ("/media/ssh/a.db", "fuse.sshfs"),
        ("/over/a.db", "nfs"),
        ("/run/portal/a.db", None),
    ],
)
def test_a_file_that_another_machine_serves_is_told_from_a_local_one(
    tmp_path: Path, file: str, kind: str | None
) -> None:
    (tmp_path / "mounts").write_text(MOUNTS)
    assert served_by(Path(file), tmp_path / "mounts") == kind


def test_a_database_on_a_network_file_system_is_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("goniometer.storage.database.served_by", lambda file: "nfs4")
    with pytest.raises(StoreError, match=r"network file system \(nfs4\).*PostgreSQL"):
        Store.open(tmp_path / "bench.db")
    assert not (tmp_path / "bench.db").exists()
