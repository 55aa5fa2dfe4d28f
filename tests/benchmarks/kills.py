"""Processes killed at any instant, and what is lost by it: nothing may be.

    python -m tests.benchmarks.kills [--kills N] [--seed S]

Campaigns on the simulated bench, upgrades, backups and restores of a database each run in a child that gets SIGKILL: at
a random moment, or where it was made to stop, with a transaction written but not committed, or just committed, or
between two statements of one. Then the next child goes on. A child says of every point once it is committed; all that
was ever said, or seen in the database, must be in it for good, once, and unchanged, and a campaign that was killed many
times must end with the very numbers of one that never was. SIGKILL leaves to the system what was handed to it; that it
reaches the disk before a commit returns is SQLite's `synchronous=FULL`, which no killed process can put to the test.
"""

import argparse
import asyncio
import hashlib
import os
import random
import select
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, event

from api.datasets import make_dataset
from api.service import open_bench
from goniometer.campaigns.campaign import Campaign, Resolution, Sample
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.database import Database
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from goniometer.upkeep.backup import back_up, restore
from goniometer.upkeep.integrity import check
from goniometer.upkeep.upgrade import upgrade
from tests.benchmarks.figures import tell
from tests.campaign_bench import NOMINAL_PANEL
from tests.goniometer.old_databases import SCHEMAS, build

CAMPAIGN = Campaign(
    name="Killed",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(20.0, 60.0),
    resolution=Resolution(mode="uniform", step=20.0),
    monitor=None,
    reference=NOMINAL_PANEL,
)
OLD = next(schema for schema in SCHEMAS if schema.stem == "version_3")
OLD_EXPOSURES = 400
PLACES = ("at a random moment", "written, not committed", "just committed", "between two statements")
LASTS = {"upgrade": 1.0, "backup": 0.1, "restore": 0.15}
"""Seconds."""
LONGEST = 120.0
"""Seconds after which a child that was not killed is called stuck."""

Say = Callable[[str], None]
Work = Callable[[Say], None]


@dataclass
class Tally:
    """What happened, and what went wrong by it."""

    kills: Counter[str] = field(default_factory=Counter)
    """SIGKILLs, by what was going on and where."""
    campaigns: int = 0
    """That came to their end."""
    points: int = 0
    """Measured in those."""
    faults: list[str] = field(default_factory=list)
    """What was lost, doubled or changed, a sentence each."""

    def expect(self, holds: bool, fault: str) -> None:
        """Note a fault where something does not hold."""
        if not holds:
            self.faults.append(fault)


@dataclass(frozen=True)
class Death:
    """When a child is killed."""

    place: str
    """One of `PLACES`."""
    after: float
    """Seconds, for a random moment; otherwise how often it passes the place before."""


def live(work: Work, death: Death | None) -> tuple[bool, list[str]]:
    """Do `work` in a child; returns whether it was killed and what it said before. Raises where it failed by itself."""
    heard, said = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(heard)
        _be(work, lambda line: void(os.write(said, f"{line}\n".encode())), death)
    os.close(said)
    by_time = death is not None and death.place == PLACES[0]
    end = time.monotonic() + (death.after if death is not None and by_time else LONGEST)
    told, killed = b"", False
    with closing(os.fdopen(heard, "rb", buffering=0)) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(end - time.monotonic(), 0))
            more = pipe.read(65536) if ready else b""
            told += more
            if not ready or told.endswith(b"halt\n"):
                os.kill(child, signal.SIGKILL)
                killed = True
                told += pipe.read() or b""  # what it had said before it died
                break
            if not more:
                break
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if killed and status == 0:
        killed = False  # it was faster
    if status not in {0, -signal.SIGKILL} or (killed and death is None):
        raise RuntimeError(f"the child ended with {status} by itself")
    return killed, [line for line in told.decode().splitlines() if line != "halt"]


def void(_: object) -> None:
    """Nothing."""


def _be(work: Work, say: Say, death: Death | None) -> None:
    """Be the child."""
    code = 70
    try:
        if death is not None and death.place != PLACES[0]:
            _halt_at(death, say)
        work(say)
        code = 0
    finally:
        if code:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _halt_at(death: Death, say: Say) -> None:
    """Stop this process where it is to be killed, and say so."""
    left = int(death.after)

    def pass_by() -> None:
        nonlocal left
        left -= 1
        if left < 0:
            say("halt")
            time.sleep(LONGEST)

    if death.place == "written, not committed":
        event.listen(Engine, "commit", lambda connection: pass_by())
    elif death.place == "just committed":
        event.listen(Engine, "checkin", lambda connection, record: pass_by())
    else:
        changes = ("INSERT", "UPDATE", "CREATE", "DROP", "ALTER", "COMMIT")
        event.listen(
            Engine,
            "before_cursor_execute",
            lambda connection, cursor, statement, *_: pass_by() if statement.lstrip().startswith(changes) else None,
        )


# A campaign


def campaign_work(file: Path) -> Work:
    """Run or resume the campaign, and make its dataset; every point is said once it is committed."""

    def work(say: Say) -> None:
        finish = Store.finish_point

        def finish_and_say(self: Store, point: Any, *arguments: Any, **more: Any) -> None:
            finish(self, point, *arguments, **more)
            say(f"{point.id}")

        Store.finish_point = finish_and_say
        store = Store.open(file)
        asyncio.run(_run(store))
        store.close()

    return work


async def _run(store: Store) -> None:
    with store.exclusive():
        async with open_bench(None, CAMPAIGN.seed, _nobody) as (instrument, mount):
            await run_campaign(
                store, CAMPAIGN, instrument, mount, void, lambda scan: void(make_dataset(store, scan.id)), None
            )


async def _nobody(scan: Scan) -> None:
    """A simulated bench mounts by itself."""


@contextmanager
def opened(file: Path) -> Iterator[sqlite3.Connection]:
    """The database as SQLite sees it."""
    with closing(sqlite3.connect(file, timeout=10)) as connection:
        yield connection


@dataclass
class Seen:
    """What was in the database once, and so must stay."""

    points: dict[int, tuple[Any, ...]] = field(default_factory=dict)
    exposures: dict[int, bytes] = field(default_factory=dict)


def look(file: Path, seen: Seen, said: list[str], tally: Tally) -> None:
    """Compare the database with what was said and seen of it before."""
    if not file.exists():
        tally.expect(not said and not seen.points, "the database is gone")
        return
    with opened(file) as connection:
        if not connection.execute("SELECT count(*) FROM sqlite_master WHERE name = 'points'").fetchone()[0]:
            tally.expect(not said and not seen.points, "the tables are gone")
            return
        tally.expect(connection.execute("PRAGMA quick_check").fetchall() == [("ok",)], "the file is damaged")
        points = {row[0]: row for row in connection.execute("SELECT * FROM points WHERE status = 'done'")}
        exposures = {
            row[0]: hashlib.sha256(repr(row).encode()).digest() for row in connection.execute("SELECT * FROM exposures")
        }
        taken = dict(
            connection.execute(
                "SELECT point_id, count(DISTINCT session || ' ' || moment) FROM exposures "
                "WHERE point_id IS NOT NULL GROUP BY point_id"
            )
        )
    for number in said:
        tally.expect(int(number) in points, f"point {number} was committed and is not there")
    tally.expect(seen.points.items() <= points.items(), "a point that was done has changed or is gone")
    tally.expect(seen.exposures.items() <= exposures.items(), "an exposure has changed or is gone")
    tally.expect(set(taken) == set(points), "a point is done without exposures, or has some and is not")
    tally.expect(set(taken.values()) <= {1}, "a point was measured twice")
    seen.points, seen.exposures = points, exposures


def result(file: Path) -> list[tuple[Any, ...]]:
    """What a campaign found: the numbers of every point and the hash of the dataset, without when it was."""
    with opened(file) as connection:
        counts = connection.execute(
            "SELECT s.number, p.number, p.theta_in, p.theta_out, p.read_theta_in, p.read_theta_out, p.status, "
            "e.integration_time, e.counts FROM points p JOIN scans s ON s.id = p.scan_id "
            "JOIN exposures e ON e.point_id = p.id ORDER BY s.number, p.number, e.id"
        ).fetchall()
        return counts + connection.execute("SELECT content_hash FROM datasets").fetchall()


def kill_campaigns(folder: Path, kills: int, chance: random.Random, tally: Tally) -> None:
    """Run campaigns until so many of their processes were killed, each to its end."""
    undisturbed = folder / "undisturbed.db"
    began = time.monotonic()
    live(campaign_work(undisturbed), None)
    lasts = time.monotonic() - began
    wanted = result(undisturbed)
    passes = {"written, not committed": 25, "just committed": 40, "between two statements": 60}
    done = 0
    while done < kills:
        file = folder / f"campaign-{tally.campaigns}.db"
        seen, ended = Seen(), False
        while not ended:
            place = chance.choice(PLACES)
            after = chance.uniform(0, lasts / 2) if place == PLACES[0] else chance.randrange(passes[place])
            killed, said = live(campaign_work(file), Death(place, after) if done < kills else None)
            look(file, seen, said, tally)
            ended = not killed
            if killed:
                done += 1
                tally.kills[f"campaign, {place}"] += 1
        tally.expect(result(file) == wanted, f"campaign {tally.campaigns} ended with other numbers")
        database = Database.as_it_is(file)
        tally.faults += check(database).faults
        database.close()
        tally.campaigns += 1
        tally.points += len(seen.points)


# Keeping the database


def raw(file: Path) -> list[tuple[Any, ...]]:
    """The raw data, in columns that every version has."""
    with opened(file) as connection:
        return connection.execute(
            "SELECT id, scan_id, point_id, kind, integration_time, counts, taken FROM exposures ORDER BY id"
        ).fetchall()


def whole(file: Path) -> bool:
    """Whether SQLite finds nothing wrong."""
    with opened(file) as connection:
        return connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def old_database(folder: Path) -> Path:
    """One of an old version with so many exposures that to upgrade it takes a while."""
    file = folder / "old.db"
    build(OLD, file)
    with opened(file) as connection, connection:
        columns = [name for _, name, *_ in connection.execute("PRAGMA table_info(exposures)") if name != "id"]
        names = ", ".join(columns)
        for _ in range(OLD_EXPOSURES):
            connection.execute(f"INSERT INTO exposures ({names}) SELECT {names} FROM exposures WHERE id = 11")
    return file


def kill_keepers(folder: Path, kills: int, chance: random.Random, tally: Tally) -> None:
    """Kill upgrades, backups and restores, a third of `kills` each."""
    old = old_database(folder)
    file, copy = folder / "kept.db", folder / "copy.db"
    current = folder / "current.db"
    shutil.copy(old, current)
    live(lambda say: void(upgrade(current)), None)
    then, now = raw(old), raw(current)
    tally.expect(then == now, "an upgrade changed raw data")
    for _ in range(kills - 2 * (kills // 3)):
        _kill(lambda: _copy(old, file), lambda say: void(upgrade(file)), "upgrade", chance, tally)
        tally.expect(whole(file) and raw(file) == then, "a killed upgrade changed raw data")
        live(lambda say: void(upgrade(file)), None)
        database = Database.as_it_is(file)
        tally.faults += check(database).faults
        database.close()
        tally.expect(raw(file) == then, "an upgrade after a killed one changed raw data")
        _clear(file)
    for _ in range(kills // 3):
        _clear(file)
        shutil.copy(current, file)
        _kill(lambda: _clear(copy), lambda say: _back_up(file, copy), "backup", chance, tally)
        tally.expect(whole(file) and raw(file) == now, "a killed backup changed the database")
        tally.expect(not copy.exists() or (whole(copy) and raw(copy) == now), "a killed backup left half a copy")
        _clear(copy)
        live(lambda say: _back_up(file, copy), None)
        tally.expect(raw(copy) == now, "a backup after a killed one is not whole")
        _clear(copy)
        _clear(file)
    live(lambda say: _back_up(current, copy), None)
    for _ in range(kills // 3):
        _kill(lambda: _copy(old, file), lambda say: void(restore(copy, file, replace=True)), "restore", chance, tally)
        tally.expect(whole(file) and raw(file) == then, "a killed restore left neither the old nor the new database")
        live(lambda say: void(restore(copy, file, replace=True)), None)
        tally.expect(raw(file) == now, "a restore after a killed one did not bring the backup")
        _clear(file)


def _back_up(file: Path, copy: Path) -> None:
    database = Database.as_it_is(file)
    back_up(database, copy)
    database.close()


def _kill(prepare: Callable[[], None], work: Work, what: str, chance: random.Random, tally: Tally) -> None:
    """Have `work` killed at a random moment of what it takes; where it was faster, it is prepared and tried again."""
    place = chance.choice((PLACES[0], PLACES[3]) if what == "upgrade" else PLACES[:1])
    latest = LASTS[what] if place == PLACES[0] else 60
    while True:
        prepare()
        after = chance.uniform(0, latest)
        killed, _ = live(work, Death(place, after))
        if killed:
            break
        latest = after
    tally.kills[f"{what}, {place}"] += 1


def _copy(source: Path, target: Path) -> None:
    _clear(target)
    shutil.copy(source, target)


def _clear(file: Path) -> None:
    for each in file.parent.glob(f"{file.name}*"):
        each.unlink()


def main() -> None:
    """Kill, and tell what came of it; exit with 1 where anything was lost."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=210)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    chance, tally = random.Random(asked.seed), Tally()
    keepers = asked.kills * 3 // 10
    with tempfile.TemporaryDirectory() as name:
        kill_campaigns(Path(name), asked.kills - keepers, chance, tally)
        kill_keepers(Path(name), keepers, chance, tally)
    print(*tally.faults, sep="\n")
    tell("SIGKILLs", tally.kills.total(), aim=f">= {asked.kills}")
    for place, kills in sorted(tally.kills.items()):
        tell(f"of these: {place}", kills)
    tell("campaigns that came to their end", tally.campaigns)
    tell("points measured in them", tally.points)
    tell("lost, doubled or changed", len(tally.faults), aim="= 0")
    sys.exit(1 if tally.faults else 0)


if __name__ == "__main__":
    main()
