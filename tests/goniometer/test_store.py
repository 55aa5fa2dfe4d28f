"""What is written is there for good, and once; a resume goes on with what was begun, and with nothing else."""

import errno
import re
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest
from filelock import FileLock
from sqlalchemy import Engine, event, text
from sqlalchemy.exc import IntegrityError

from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Homogeneity, Override, Reference, Sample
from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.constants import BenchData, Constants
from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.errors import CampaignError, NotInStore, RawDamaged, StoreBusy, StoreError, StoreFull
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import certificate_of
from goniometer.radiometry.raw import read_raw
from goniometer.storage.store import Store
from goniometer.uncertainty import ErrorSource, everywhere
from tests.databases import fresh_database, outside

CAMPAIGN = Campaign(
    name="First light", samples=(Sample(name="Rough", material="sample-1"), Sample(name="Mirror", material="sample-6"))
)
CONSTANTS = Constants(
    "QE Pro QEP00001",
    {"sample stage": "SMC100"},
    np.linspace(250, 1050, 1044) / 3,
    np.array([0.998, 5e-8]),
    200_000,
    BenchData(),
)


@pytest.fixture
def store(database):
    opened = Store.open(database)
    yield opened
    opened.close()


def spectrum(seed=0, integration_time=0.1):
    counts = np.random.default_rng(seed).integers(0, 200_001, 1044, dtype=np.uint32)
    return Spectrum(counts, integration_time, seed, -10.0)


def first_point(store):
    """Id of the first sample's scan, and its first of two points."""
    scan_id = store.scans(store.add_campaign(CAMPAIGN))[1].id
    store.add_points(scan_id, [Geometry(10.0, -30.0), Geometry(10.0, 10.0)])
    return scan_id, store.points(scan_id)[0]


def dataset():
    random = np.random.default_rng(1)
    shape = (3, 4)
    brdf = random.random(shape)
    brdf[1, 2] = np.nan
    return Dataset(
        "Rough",
        np.array([0.1, 10, 20]),
        np.array([-3.0, 1 / 3, 5]),
        np.array([400.0, 500, 600, 700]),
        brdf,
        (
            ErrorSource("counts", "random", random.random(shape), None, False),
            ErrorSource("reference: certificate", "reference", random.random(shape), everywhere(3), True),
        ),
        np.array([0, Flag.SATURATED | Flag.NEGATIVE, 0], dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.01,
        aperture=1.0,
        checks=(Check("energy", True, "The reflectance is at most 0.91."),),
        lineage={"scan": 2, "exposures": [1, 2]},
    )


def test_a_campaign_becomes_a_reference_scan_and_one_scan_a_sample(store):
    campaign_id = store.add_campaign(CAMPAIGN)
    scans = store.scans(campaign_id)
    assert [(s.kind, s.sample, s.material) for s in scans] == [
        ("reference", "reference", "spectralon"),
        ("sample", "Rough", "sample-1"),
        ("sample", "Mirror", "sample-6"),
    ]
    assert {(s.phase, s.outcome) for s in scans} == {("idle", None)}
    assert store.campaign(campaign_id) == CAMPAIGN
    assert store.reference_scan(scans[2].id) == scans[0]


def test_a_resume_with_a_changed_campaign_is_refused_in_one_line(store):
    campaign_id = store.add_campaign(CAMPAIGN)
    first_point(store)
    assert store.add_campaign(CAMPAIGN) == campaign_id
    with pytest.raises(CampaignError, match=r'"First light".*other content') as caught:
        store.add_campaign(CAMPAIGN.model_copy(update={"seed": 1}))
    assert "\n" not in str(caught.value)


def test_a_campaign_that_has_measured_nothing_gives_way_to_its_correction(store):
    other_id = store.add_campaign(CAMPAIGN.model_copy(update={"name": "Other"}))
    store.add_campaign(CAMPAIGN)
    corrected = CAMPAIGN.model_copy(update={"samples": CAMPAIGN.samples[:1]})
    campaign_id = store.add_campaign(corrected)
    assert store.campaign(campaign_id) == corrected
    assert [s.sample for s in store.scans(campaign_id)] == ["reference", "Rough"]
    assert sorted(store.campaigns().values()) == ["First light", "Other"]
    assert len(store.scans(other_id)) == 3


def test_the_scan_of_another_spot_follows_its_sample(store):
    campaign_id = store.add_campaign(CAMPAIGN.model_copy(update={"homogeneity": Homogeneity()}))
    assert [(s.number, s.kind, s.sample, s.material) for s in store.scans(campaign_id)] == [
        (0, "reference", "reference", "spectralon"),
        (1, "sample", "Rough", "sample-1"),
        (2, "spot", "Rough", "sample-1"),
        (3, "sample", "Mirror", "sample-6"),
        (4, "spot", "Mirror", "sample-6"),
    ]


def test_each_repeat_is_a_scan_of_its_own_and_served_by_the_panel_of_its_round(store):
    once, often = CAMPAIGN.samples[0], CAMPAIGN.samples[1].model_copy(update={"repeats": 2})
    reference = Reference(every_round=True)
    changes = {"samples": (once, often), "rounds": 2, "reference": reference, "homogeneity": Homogeneity()}
    scans = store.scans(store.add_campaign(CAMPAIGN.model_copy(update=changes)))
    assert [scan.name for scan in scans if scan.kind != "spot"] == [
        *("reference #1", "Rough #1", "Mirror #1", "Mirror #2"),
        *("reference #2", "Rough #2", "Mirror #3", "Mirror #4"),
    ]
    assert [scan.number for scan in scans] == list(range(14))
    for scan in scans:
        assert store.scan(scan.id) == scan
        assert store.reference_scan(scan.id) == (scans[0] if scan.number < 7 else scans[7])
        if scan.kind == "spot":
            assert (scan.sample, scan.repeat) == (scans[scan.number - 1].sample, scans[scan.number - 1].repeat)


def test_somebody_may_answer_for_a_certificate_that_expired_while_a_campaign_was_measured(store):
    campaign_id = store.add_campaign(CAMPAIGN)
    first_point(store)
    override = Override(name="A. Smith", reason="The panel is away for calibration.")
    answered = CAMPAIGN.model_copy(update={"reference": Reference(override=override)})
    assert store.add_campaign(answered) == campaign_id
    assert store.campaign(campaign_id).reference.override == override
    assert len(store.scans()) == 3


def certified(tmp_path, reflectance):
    """`CAMPAIGN` with a certificate of this reflectance."""
    path = tmp_path / "panel.csv"
    path.write_text(
        "# serial_number: P1\n# calibrated: 2024-03-01\n# valid_until: 2025-03-01\n"
        f"wavelength_nm,reflectance,standard_uncertainty\n300,{reflectance},0.004\n1000,{reflectance},0.004\n"
    )
    return CAMPAIGN.model_copy(update={"reference": Reference(certificate=str(path))})


def test_a_campaign_keeps_the_certificate_that_it_began_with_wherever_the_file_goes(store, tmp_path):
    campaign_id = store.add_campaign(certified(tmp_path, 0.98))
    (tmp_path / "panel.csv").unlink()
    certificate = certificate_of(store, campaign_id)
    assert (certificate.serial_number, certificate.reflectance_8h.tolist()) == ("P1", [0.98, 0.98])
    assert certificate_of(store, store.add_campaign(CAMPAIGN.model_copy(update={"name": "b"}))) == NOMINAL_SRS99


def test_a_resume_with_another_certificate_is_refused_in_one_line_and_not_silently_ignored(store, tmp_path):
    begun = certified(tmp_path, 0.98)
    campaign_id = store.add_campaign(begun)
    store.add_points(store.scans(campaign_id)[0].id, [Geometry(10.0, -30.0)])
    assert store.add_campaign(begun) == campaign_id
    for changed in (certified(tmp_path, 0.97), CAMPAIGN):
        with pytest.raises(CampaignError, match=r"another certificate; .* another name") as caught:
            store.add_campaign(changed)
        assert "\n" not in str(caught.value)
    assert certificate_of(store, campaign_id).reflectance_8h[0] == 0.98


def test_raw_counts_come_back_bit_for_bit(database):
    store = Store.open(database)
    scan_id, point = first_point(store)
    store.save_constants(scan_id, CONSTANTS)
    light, dark = [spectrum(1), spectrum(2)], [spectrum(3), spectrum(4)]
    store.start_point(point.id)
    store.add_exposures(scan_id, "dark", dark, "one", 3.0)
    store.finish_point(point, Geometry(10.003, -30.004), light, "one", 7.25, 12.5, 20.5, "too dark")
    store.close()

    reopened = Store.open(database)
    raw = read_raw(reopened, scan_id)
    assert raw.planned == (Geometry(10.0, -30.0),)
    assert raw.read_back == (Geometry(10.003, -30.004),)
    (shot,), (taken,) = raw.shots, raw.darks
    assert np.array_equal(shot.counts, [s.counts for s in light])
    assert (shot.geometry, shot.integration_time, shot.point) == (raw.read_back[0], 0.1, 0)
    assert (shot.session, shot.moment) == ("one", 7.25)
    assert np.array_equal(taken.counts, [s.counts for s in dark])
    assert (taken.integration_time, taken.temperature) == (0.1, -10.0)
    assert np.array_equal(raw.constants.wavelengths, CONSTANTS.wavelengths)
    assert (raw.constants.spectrometer, raw.constants.stages) == (CONSTANTS.spectrometer, CONSTANTS.stages)
    done, waiting = reopened.points(scan_id)
    assert (done.status, done.attempts, done.seconds, done.reason) == ("done", 1, 12.5, "too dark")
    assert done.signal_to_noise == 20.5
    assert (waiting.status, waiting.read_back, waiting.signal_to_noise) == ("pending", None, None)
    reopened.close()


def test_raw_and_derived_data_cannot_be_changed_or_deleted_by_anybody(store, database):
    scan_id, point = first_point(store)
    store.start_point(point.id)
    store.finish_point(point, point.geometry, [spectrum()], "one", 0.0, 1.0, 50.0)
    dataset_id = store.add_dataset(scan_id, dataset())
    store.add_fit(dataset_id, "global", "{}")
    changes = [
        "UPDATE exposures SET integration_time = 1",
        "DELETE FROM exposures",
        "UPDATE datasets SET sample = 'x'",
        "DELETE FROM fits",
    ]
    if isinstance(database, str):
        changes.append("TRUNCATE exposures")
    for change in changes:
        with pytest.raises(IntegrityError, match="only ever added"), outside(database) as other:
            other.execute(text(change))


def test_a_dataset_comes_back_bit_for_bit_and_a_second_one_stands_beside_it(store):
    scan_id, _ = first_point(store)
    before = dataset()
    first, second = store.add_dataset(scan_id, before), store.add_dataset(scan_id, before)
    after = store.dataset(first)
    assert after.content_hash == before.content_hash
    assert np.array_equal(after.flags, before.flags)
    assert after.flags.dtype == before.flags.dtype
    assert np.array_equal(after.u, before.u, equal_nan=True)
    assert (after.lineage, after.checks) == (before.lineage, before.checks)
    assert (after.u_angle, after.u_zero, after.aperture, after.sample) == (0.005, 0.01, 1.0, "Rough")
    assert store.datasets(scan_id) == {first: scan_id, second: scan_id}
    assert store.lineage(first) == before.lineage


def test_fits_and_exports_stay_with_their_dataset(store, tmp_path):
    scan_id, _ = first_point(store)
    dataset_id = store.add_dataset(scan_id, dataset())
    store.add_fit(dataset_id, "global", '{"w": 2.3}')
    store.add_fit(dataset_id, "global", '{"w": 2.4}')
    store.add_export(dataset_id, tmp_path / "a.bsdf", "mitsuba", "0" * 64)
    assert [(f.kind, f.text) for f in store.fits(dataset_id)] == [("global", '{"w": 2.3}'), ("global", '{"w": 2.4}')]
    assert [(e.kind, e.text) for e in store.exports(dataset_id)] == [("mitsuba", str(tmp_path / "a.bsdf"))]


def test_a_point_that_was_being_measured_at_a_power_cut_is_measured_again(store):
    scan_id, point = first_point(store)
    store.start_point(point.id)
    store.release_points(scan_id)
    assert [(p.status, p.attempts) for p in store.points(scan_id)] == [("pending", 1), ("pending", 0)]


def test_another_spectrometer_in_the_middle_of_a_scan_is_refused_and_another_stage_is_not(store):
    scan_id, _ = first_point(store)
    store.save_constants(scan_id, CONSTANTS)
    store.save_constants(scan_id, replace(CONSTANTS, stages={"sample stage": "another"}))
    with pytest.raises(StoreError, match="another spectrometer"):
        store.save_constants(scan_id, replace(CONSTANTS, spectrometer="QE Pro QEP00002"))
    other = replace(CONSTANTS, bench=BenchData(gain=1.0), wavelengths=CONSTANTS.wavelengths + 1e-12)
    with pytest.raises(StoreError, match="another bench and wavelengths"):
        store.save_constants(scan_id, other)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"spectrometer": "QE Pro QEP00002"}, "another spectrometer"),
        ({"nonlinearity": np.array([1.0])}, "another nonlinearity"),
        ({"bench": BenchData(u_angle=0.1)}, "another bench"),
    ],
)
def test_a_sample_is_not_measured_with_another_bench_than_the_reference(store, change, words):
    reference, sample, _ = (scan.id for scan in store.scans(store.add_campaign(CAMPAIGN)))
    store.save_constants(reference, CONSTANTS)
    with pytest.raises(StoreError, match=words) as caught:
        store.save_constants(sample, replace(CONSTANTS, **change))
    assert "\n" not in str(caught.value)
    with pytest.raises(NotInStore):
        store.constants(sample)
    store.save_constants(sample, replace(CONSTANTS, stages={"sample stage": "another"}))
    assert store.constants(sample).stages == {"sample stage": "another"}


def test_another_process_can_ask_for_a_pause_but_only_of_a_running_scan(store, database):
    scan_id, _ = first_point(store)
    other = Store.open(database)
    with store.exclusive(), pytest.raises(NotInStore, match="not running"):
        other.request(scan_id, "pause")
    store.set_phase(scan_id, "running")
    with store.exclusive():
        other.request(scan_id, "pause")
    assert store.command(scan_id) == "pause"
    assert other.scan(scan_id).phase == "pausing"
    with pytest.raises(NotInStore, match="no process runs it"):
        other.request(scan_id, "resume")
    store.finish_scan(scan_id, "completed")
    with store.exclusive(), pytest.raises(NotInStore, match="not running"):
        other.request(scan_id, "abort")
    assert (other.scan(scan_id).phase, other.command(scan_id)) == ("finished", None)
    other.close()


def test_a_scan_whose_process_was_killed_does_not_stay_running_for_ever(store):
    scans = store.scans(store.add_campaign(CAMPAIGN))
    store.finish_scan(scans[0].id, "completed")
    scan_id, point = first_point(store)
    store.set_phase(scan_id, "paused")
    store.start_point(point.id)
    store.end_stale_scans()
    ended = store.scan(scan_id)
    assert (ended.phase, ended.outcome, ended.command) == ("finished", "aborted", None)
    assert "run the campaign again" in ended.reason
    assert [(p.status, p.attempts) for p in store.points(scan_id)] == [("pending", 1), ("pending", 0)]
    assert [s.outcome for s in store.scans()] == ["completed", "aborted", None]
    assert store.scan(scans[2].id) == scans[2]


def test_a_point_that_another_process_has_finished_is_not_written_twice(store):
    scan_id, point = first_point(store)
    store.start_point(point.id)
    store.finish_point(point, point.geometry, [spectrum(1)], "one", 0.0, 1.0, 50.0)
    with pytest.raises(StoreError, match="not being measured"):
        store.finish_point(point, point.geometry, [spectrum(2)], "one", 0.0, 1.0, 50.0)
    assert [e.counts.tolist() for e in store.exposures(scan_id)] == [spectrum(1).counts.tolist()]


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda _: b"", lambda b: b[:300] + bytes(9) + b[309:]])
def test_a_damaged_dataset_is_said_to_be_damaged(store, database, damage):
    scan_id, _ = first_point(store)
    dataset_id = store.add_dataset(scan_id, dataset())
    trigger = "datasets_only_added ON datasets" if isinstance(database, str) else "datasets_no_update"
    with outside(database) as other:
        other.execute(text(f"DROP TRIGGER {trigger}"))
        blob = other.execute(text("SELECT arrays FROM datasets")).scalar_one()
        other.execute(text("UPDATE datasets SET arrays = :damaged"), {"damaged": damage(blob)})
    with pytest.raises(StoreError, match=f"Dataset {dataset_id} is damaged") as caught:
        store.dataset(dataset_id)
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_named(store):
    for ask in (store.scan, store.campaign, store.dataset):
        with pytest.raises(NotInStore, match="77"):
            ask(77)


def test_a_second_run_on_the_same_database_is_refused_with_its_name(store, database):
    other = Store.open(database)
    with store.exclusive(), pytest.raises(StoreBusy, match=re.escape(store.where)), other.exclusive():
        pass
    with other.exclusive():
        pass
    other.close()


def test_a_link_to_the_database_does_not_open_a_way_round_the_lock(tmp_path):
    store = Store.open(tmp_path / "bench.db")
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "link.db"
    link.symlink_to(tmp_path / "bench.db")
    for where in (link, f"sqlite:///{link}"):
        other = Store.open(where)
        with store.exclusive(), pytest.raises(StoreBusy), other.exclusive():
            pass
        other.close()
    store.close()


def test_who_looks_whether_a_database_is_in_use_keeps_no_run_from_beginning(tmp_path, monkeypatch):
    monkeypatch.setattr("goniometer.storage.database._LOOKED_AT", 10.0)
    store = Store.open(tmp_path / "bench.db")
    with store.exclusive():
        (file,) = tmp_path.glob("bench.db.lock*")
    look = FileLock(file, thread_local=False)  # as `in_use` takes it for a moment
    look.acquire()
    threading.Timer(0.1, look.release).start()
    with store.exclusive():
        assert not look.is_locked
    store.close()


def test_who_only_reads_is_let_in_while_another_program_writes(tmp_path):
    file = tmp_path / "bench.db"
    Store.open(file).close()
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        assert other.execute("PRAGMA auto_vacuum").fetchone() == (2,), "incremental"
        other.execute("BEGIN IMMEDIATE")
        store = Store.open(file)
        assert store.campaigns() == {}
        store.close()


def test_a_killed_run_leaves_no_lock_behind(store, database):
    script = f"""
        import time
        from goniometer.storage.store import Store
        with Store.open({str(database)!r}).exclusive():
            print("locked", flush=True)
            time.sleep(60)
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "locked\n"
    with pytest.raises(StoreBusy), store.exclusive():
        pass
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    end = time.monotonic() + 60  # a server sees a moment later that somebody is gone
    while store.in_use():
        assert time.monotonic() < end
        time.sleep(0.01)
    with store.exclusive():
        pass


@pytest.mark.parametrize("content", [b"", None])
def test_an_empty_or_missing_file_becomes_a_database(tmp_path, content):
    path = tmp_path / "new.db"
    if content is not None:
        path.write_bytes(content)
    store = Store.open(f"sqlite:///{path}")
    assert store.campaigns() == {}
    store.close()


def test_a_start_that_is_killed_halfway_does_not_spoil_the_database_for_ever(tmp_path):
    script = f"""
        import os, signal
        from goniometer.storage import tables
        from goniometer.storage.store import Store
        tables.insert = lambda _: os.kill(os.getpid(), signal.SIGKILL)  # comes after the tables, before the triggers
        Store.open({str(tmp_path / "bench.db")!r})
    """
    killed = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert (tmp_path / "bench.db").exists()
    store = Store.open(tmp_path / "bench.db")
    assert store.campaigns() == {}
    store.close()


def test_a_start_on_a_full_disk_does_not_spoil_the_database_for_ever(tmp_path):
    def limit(connection, _):
        connection.execute("PRAGMA max_page_count = 8")

    event.listen(Engine, "connect", limit)
    try:
        with pytest.raises(StoreFull):
            Store.open(tmp_path / "bench.db")
    finally:
        event.remove(Engine, "connect", limit)
    Store.open(tmp_path / "bench.db").close()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_two_first_starts_at_once_make_one_database(kind, tmp_path, request):
    with ExitStack() as stack:
        database = tmp_path / "bench.db"
        if kind == "postgresql":
            database = stack.enter_context(fresh_database(request.getfixturevalue("postgresql"), empty=True))
        start_at_once(database)


def start_at_once(database):
    script = f"""
        import sys
        from goniometer.storage.store import Store
        print(flush=True)
        sys.stdin.readline()
        Store.open({str(database)!r}).close()
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    pipe = subprocess.PIPE
    processes = [subprocess.Popen(command, text=True, stdin=pipe, stdout=pipe, stderr=pipe) for _ in range(3)]
    for process in processes:
        process.stdout.readline()
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    ended = [(process.communicate()[1], process.returncode) for process in processes]
    assert ended == [("", 0)] * 3


def test_a_file_that_is_no_database_is_refused_in_one_line(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("This is a shopping list and not a database at all.\n" * 30)
    with pytest.raises(StoreError, match="is not a database") as caught:
        Store.open(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_the_database_of_another_program_or_version_is_refused_and_left_as_it_is(tmp_path):
    path = tmp_path / "music.db"
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE songs (title TEXT)")
    other.close()
    with pytest.raises(StoreError, match="another program"):
        Store.open(path)
    Store.open(tmp_path / "bench.db").close()
    with sqlite3.connect(tmp_path / "bench.db") as old:
        old.execute("UPDATE alembic_version SET version_num = '9999'")
    old.close()
    with pytest.raises(StoreError, match=r"newer version .* 9999"):
        Store.open(tmp_path / "bench.db")


def test_a_missing_folder_and_a_wrong_address_are_named(tmp_path):
    with pytest.raises(StoreError, match="nowhere"):
        Store.open(tmp_path / "nowhere" / "bench.db")
    with pytest.raises(StoreError, match="://"):
        Store.open("://")


def fill(store, scan_id):
    for seed in range(1000):
        store.add_exposures(scan_id, "dark", [spectrum(seed)], "one", 0.0)


def test_a_full_disk_is_said_to_be_full_and_loses_nothing_that_was_written(tmp_path):
    def limit(connection, _):
        connection.execute("PRAGMA max_page_count = 60")

    event.listen(Engine, "connect", limit)
    try:
        store = Store.open(tmp_path / "bench.db")
        scan_id, point = first_point(store)
        store.start_point(point.id)
        store.finish_point(point, point.geometry, [spectrum()], "one", 0.0, 1.0, 50.0)
        with pytest.raises(StoreFull, match="no room left"):
            fill(store, scan_id)
        assert store.points(scan_id)[0].status == "done"
        assert np.array_equal(store.exposures(scan_id)[0].counts, spectrum().counts)
        store.close()
    finally:
        event.remove(Engine, "connect", limit)


def test_a_point_and_its_exposures_are_written_together_or_not_at_all(tmp_path):
    def limit(connection, _):
        connection.execute("PRAGMA max_page_count = 60")

    event.listen(Engine, "connect", limit)
    try:
        store = Store.open(tmp_path / "bench.db")
        scan_id, point = first_point(store)
        store.start_point(point.id)
        with pytest.raises(StoreFull):
            store.finish_point(point, point.geometry, [spectrum(i) for i in range(200)], "one", 0.0, 1.0, 50.0)
        assert store.points(scan_id)[0].status == "running"
        assert store.exposures(scan_id) == []
        store.close()
    finally:
        event.remove(Engine, "connect", limit)


def test_a_lock_that_finds_no_room_is_a_full_disk(tmp_path, monkeypatch):
    store = Store.open(tmp_path / "bench.db")

    def no_room(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("goniometer.storage.database.FileLock.acquire", no_room)
    with pytest.raises(StoreFull), store.exclusive():
        pass
    store.close()


def test_somebody_who_reads_does_not_hold_up_a_run(tmp_path):
    store = Store.open(tmp_path / "bench.db")
    _, point = first_point(store)
    reader = sqlite3.connect(tmp_path / "bench.db", isolation_level=None)
    store.start_point(point.id)
    reader.execute("BEGIN")
    assert reader.execute("SELECT status FROM points").fetchall() == [("running",), ("pending",)]
    store.finish_point(point, point.geometry, [spectrum()], "one", 0.0, 1.0, 50.0)
    assert reader.execute("SELECT status FROM points").fetchall() == [("running",), ("pending",)]
    reader.execute("COMMIT")
    assert reader.execute("SELECT status FROM points").fetchall() == [("done",), ("pending",)]
    reader.close()
    store.close()


@pytest.mark.parametrize(
    "change", ["counts = zeroblob(4176)", "integration_time = 0.2", "moment = 1.0", "kind = 'stray'"]
)
def test_a_raw_exposure_that_was_changed_from_outside_is_never_taken_for_data(tmp_path, change):
    store = Store.open(tmp_path / "bench.db")
    scan_id, _ = first_point(store)
    store.add_exposures(scan_id, "monitor", [spectrum(1), spectrum(2)], "one", 0.0, Geometry(10.0, -0.0))
    first, second = store.exposures(scan_id)
    assert first.geometry == Geometry(10.0, 0.0)
    with sqlite3.connect(tmp_path / "bench.db") as outside:
        outside.execute("DROP TRIGGER exposures_no_update")
        outside.execute(f"UPDATE exposures SET {change} WHERE id = {second.id}")
    outside.close()
    with pytest.raises(RawDamaged, match=rf"Exposure {second.id} .* db restore") as caught:
        read_raw(store, scan_id)
    assert caught.value.exposure_id == second.id
    store.close()
