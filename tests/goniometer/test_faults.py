"""What goes wrong under a database loses nothing that was measured and is said in a sentence: see docs/faults.md."""

import asyncio
import gc
import random
import re
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from sqlalchemy import Engine, event

from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Resolution, Sample
from goniometer.errors import GoniometerError, StoreBusy, StoreError, StoreFull
from goniometer.storage import database as database_module
from goniometer.storage.database import Database
from goniometer.storage.store import Store
from goniometer.upkeep.backup import back_up, restore
from tests.campaign_bench import NOMINAL_PANEL, run

ROOT = Path(__file__).parents[2]
TABLE = [
    [cell.strip() for cell in line.strip("|\n").split("|")]
    for line in (ROOT / "docs" / "faults.md").read_text().splitlines()
    if line.startswith("|") and not line.startswith(("| Fault", "|--"))
]
SAID = {fault: said for fault, said, _ in TABLE}
CAMPAIGN = Campaign(
    name="First light",
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(20.0,),
    resolution=Resolution(mode="uniform", step=30.0),
    reference=NOMINAL_PANEL,
    monitor=None,
)
TRIED: dict[str, Callable[..., None]] = {}


def fault(name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Mark the test of a row of the table."""

    def mark(test: Callable[..., None]) -> Callable[..., None]:
        TRIED[name] = test
        return test

    return mark


@contextmanager
def told(name: str, kind: type[GoniometerError] = StoreError) -> Iterator[None]:
    """What the block raises is an error in one line that says what the table says."""
    with pytest.raises(kind, match=re.escape(SAID[name].strip('"'))) as caught:
        yield
    assert "\n" not in str(caught.value)


def spectrum(seed: int) -> Spectrum:
    """Counts of a seed."""
    return Spectrum(np.random.default_rng(seed).integers(0, 200_001, 1044, dtype=np.uint32), 0.1, seed, -10.0)


def write(store: Store, count: int, scan: int = 1) -> int:
    """Add so many darks, each for itself; returns how many were committed before something went wrong."""
    for seed in range(count):
        store.add_exposures(scan, "dark", [spectrum(seed)], "one", 0.0)
    return count


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A database with thirty exposures."""
    path = tmp_path / "bench.db"
    store = Store.open(path)
    store.add_campaign(CAMPAIGN)
    write(store, 30)
    store.close()
    return path


def counts(file: Path) -> list[bytes]:
    """Of all exposures, read by SQLite alone."""
    with closing(sqlite3.connect(file)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return [row[0] for row in connection.execute("SELECT counts FROM exposures ORDER BY id")]


@contextmanager
def no_file_longer_than(size: int) -> Iterator[None]:
    """Every write beyond `size` bytes of a file fails, as with a quota."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def goes_on(file: Path, committed: list[bytes]) -> None:
    """Nothing of what was committed is lost, and more can be written."""
    kept = counts(file)
    assert kept[: len(committed)] == committed
    store = Store.open(file)
    write(store, 1)
    assert len(store.exposures(1)) == len(kept) + 1
    store.close()


@fault("The disk is full")
def test_a_full_disk(file: Path) -> None:
    committed = counts(file)

    def limit(connection: Any, _: object) -> None:
        connection.execute(f"PRAGMA max_page_count = {file.stat().st_size // 4096 + 40}")

    event.listen(Engine, "connect", limit)
    try:
        store = Store.open(file)
        with told("The disk is full", StoreFull):
            write(store, 1000)
        store.close()
    finally:
        event.remove(Engine, "connect", limit)
    assert len(counts(file)) > len(committed)
    goes_on(file, committed)


@fault("The disk or a quota refuses to write")
def test_a_quota(file: Path) -> None:
    committed = counts(file)
    store = Store.open(file)
    with no_file_longer_than(100_000), told("The disk or a quota refuses to write"):
        write(store, 1000)
    store.close()
    goes_on(file, committed)


@fault("No room for a backup")
def test_no_room_for_a_backup(file: Path, tmp_path: Path) -> None:
    committed = counts(file)
    database = Database.as_it_is(file)
    with no_file_longer_than(100_000), told("No room for a backup"):
        back_up(database, tmp_path / "copy.db")
    database.close()
    assert not list(tmp_path.glob("copy.db*"))
    goes_on(file, committed)


READ_ONLY = """
import os, sys
from goniometer.errors import StoreError
from goniometer.storage.store import Store
if os.geteuid() == 0:  # rights do not hold root up
    os.setgid(65534)
    os.setuid(65534)
try:
    store = Store.open(sys.argv[1])
    with store.exclusive():
        store.explain(1, "written")
except StoreError as error:
    print(error)
"""


@fault("The file or its folder is read-only")
@pytest.mark.parametrize("rights", [(0o555, 0o444), (0o777, 0o444), (0o555, 0o666)])
def test_read_only(file: Path, rights: tuple[int, int]) -> None:
    committed = counts(file)
    with tempfile.TemporaryDirectory() as name:  # everybody may look into it, other than into that of the tests
        folder, there = Path(name), Path(name) / "bench.db"
        there.write_bytes(file.read_bytes())
        folder.chmod(rights[0])
        there.chmod(rights[1])
        command = [sys.executable, "-c", READ_ONLY, str(there)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        folder.chmod(0o777)
        assert SAID["The file or its folder is read-only"].strip('"') in done.stdout, done.stderr
        assert len(done.stdout.strip().splitlines()) == 1
        assert counts(there) == committed


@fault("Bytes of the file were overwritten")
@pytest.mark.parametrize("seed", range(12))
def test_overwritten_bytes(file: Path, tmp_path: Path, seed: int) -> None:
    committed = counts(file)
    database = Database.as_it_is(file)
    back_up(database, tmp_path / "copy.db")
    database.close()
    chance = random.Random(seed)
    with file.open("r+b") as damaged:
        damaged.seek(chance.randrange(4096, file.stat().st_size - 64))
        damaged.write(chance.randbytes(64))
    said = ""
    try:
        with closing(Store.open(file)) as store:
            read = [exposure.counts.astype("<u4").tobytes() for exposure in store.exposures(1)]
    except StoreError as error:
        said = str(error)
    assert SAID["Bytes of the file were overwritten"].strip('"') in said or read == committed[: len(read)]
    gc.collect()  # an error keeps what it was raised in, and so the file open
    restore(tmp_path / "copy.db", file, replace=True)
    goes_on(file, committed)


@fault("Another program keeps the file locked")
def test_a_lock_that_does_not_go_away(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    committed = counts(file)

    def impatient(connection: Any, _: object) -> None:
        connection.execute("PRAGMA busy_timeout = 50")

    event.listen(Engine, "connect", impatient)
    store = Store.open(file)
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with told("Another program keeps the file locked", StoreBusy):
            write(store, 1)
        other.execute("ROLLBACK")
    store.close()
    event.remove(Engine, "connect", impatient)
    goes_on(file, committed)


@fault("Two processes write at once")
def test_two_writers(file: Path) -> None:
    script = (
        "import sys; from goniometer.storage.store import Store; from tests.goniometer.test_faults import write; "
        "write(Store.open(sys.argv[1]), 60, int(sys.argv[2]))"
    )
    before = len(counts(file))
    writers = [
        subprocess.Popen([sys.executable, "-c", script, str(file), str(scan)], cwd=ROOT, stderr=subprocess.PIPE)
        for scan in (1, 2)
    ]
    for writer in writers:
        assert writer.wait() == 0, writer.stderr.read() if writer.stderr else ""
        if writer.stderr:
            writer.stderr.close()
    assert len(counts(file)) == before + 120
    store = Store.open(file)
    assert len(store.exposures(2)) == 60
    store.close()


@fault("The clock jumps back a day")
def test_a_clock_that_jumps_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(name: str) -> list[tuple[Any, ...]]:
        store = Store.open(tmp_path / name)
        asyncio.run(run(store, CAMPAIGN))
        found = [
            (
                point.geometry,
                point.read_back,
                [e.counts.tobytes() for e in store.exposures(s.id) if e.point_id == point.id],
            )
            for s in store.scans()
            for point in store.points(s.id)
        ]
        assert all(scan.outcome == "completed" for scan in store.scans())
        store.close()
        return found

    undisturbed = measured("undisturbed.db")
    asked = []

    class Jumping(datetime):
        """A day earlier from the twentieth question on."""

        @classmethod
        def now(cls, tz: Any = None) -> Self:
            asked.append(tz)
            return super().now(tz) - timedelta(days=1 if len(asked) > 20 else 0)

    monkeypatch.setattr("goniometer.storage.records.datetime", Jumping)
    assert measured("jumping.db") == undisturbed
    assert len(asked) > 40


@fault("The program is killed at any instant")
def test_a_killed_writer(file: Path) -> None:
    script = (
        "import sys; from goniometer.storage.store import Store; from tests.goniometer.test_faults import spectrum\n"
        "store = Store.open(sys.argv[1])\n"
        "for seed in range(1000):\n"
        "    store.add_exposures(1, 'dark', [spectrum(seed)], 'one', 0.0)\n"
        "    print(seed, flush=True)\n"
    )
    before = len(counts(file))
    with subprocess.Popen(
        [sys.executable, "-c", script, str(file)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        said = [writer.stdout.readline() for _ in range(20)]
        writer.kill()
        said += writer.stdout.readlines()
    assert len(counts(file)) - before in {len(said), len(said) + 1}  # the last may have been committed, and not said
    goes_on(file, counts(file))


@fault("The file lies on a network drive")
def test_a_network_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_module, "served_by", lambda file: "nfs4")
    with told("The file lies on a network drive"):
        Store.open(tmp_path / "bench.db")
    assert not list(tmp_path.iterdir())


def test_every_row_of_the_table_is_tried() -> None:
    assert list(TRIED) == list(SAID)
