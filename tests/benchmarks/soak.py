"""Point after point on a bench on which something happens all the time.

    python -m tests.benchmarks.soak [POINTS [RATE]]

The real scheduler runs campaigns with a uniform step through the real drivers. At every point a fault of any kind may
be laid in wait for one of the devices. When a run ends with an error an operator repairs what only a person can and
runs the campaign again. A stage that has become ten times slower may be too slow for a long move; that point is given
up and told. In the end every stored spectrum is compared with what the bench would have read without noise.
"""

import asyncio
import gc
import logging
import os
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from goniometer.campaigns.campaign import Campaign, Integration, OutgoingRange, Reference, Resolution, Sample
from goniometer.scans.progress import Progress
from goniometer.storage.store import Store
from simulators.bench.laboratory import Laboratory
from simulators.devices.faults import LASTING, Fault, FaultScript, Kind
from tests.benchmarks.figures import tell
from tests.benchmarks.nights import LASTS, ROLES, run
from tests.benchmarks.truth import Truth, lost, wrong

SIGMA = 7.0
"""Standard deviations within which counts are right: of 20 million pixels one lies 5.7 off by chance."""
STAGES = (("smc100", "oriental-az"), ("owis", "k10cr1"))
"""Families of the stages of one campaign and of the next."""
MATERIALS = ("sample-1", "sample-4")
INCIDENT = (10.0, 25.0, 40.0, 55.0)
EVERY = 250
"""Points between two looks at the memory."""
RUNS = 1000
"""How often the operator starts a campaign at most."""


class _Retries(logging.Handler):
    """Counts what is tried again: by drivers, and by the scheduler with a recovery in between."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.counts: Counter[str] = Counter()

    def emit(self, record: logging.LogRecord) -> None:
        self.counts[record.name.partition(".")[0] if record.name != "goniometer.scans.scheduler" else "scheduler"] += 1


@dataclass
class Soaked:
    """What came of it."""

    points: int = 0
    """Points measured."""
    struck: Counter[str] = field(default_factory=Counter)
    """Requests that were befallen, by kind."""
    retries: Counter[str] = field(default_factory=Counter)
    """Warnings of the drivers, of the instrument ("goniometer") and of the scheduler (a point that is tried again)."""
    ended: Counter[str] = field(default_factory=Counter)
    """Typed errors that ended a run, after which the operator began again."""
    wrong: list[str] = field(default_factory=list)
    """Points that are stored and false, twice there, or missing."""
    lost: list[str] = field(default_factory=list)
    """Points that were given up."""
    memory: list[tuple[int, float]] = field(default_factory=list)
    """Points, resident megabytes."""
    threads: tuple[int, int] = (0, 0)
    """At the start and at the end."""
    descriptors: tuple[int, int] = (0, 0)
    """At the start and at the end."""
    seconds: float = 0.0

    @property
    def unexplained(self) -> list[str]:
        """Points that were given up for another reason than that a stage had become too slow for a long move."""
        return [reason for reason in self.lost if "still moving" not in reason]


class Misfortune:
    """Lays faults in wait while campaigns are run, and keeps the books."""

    def __init__(self, soaked: Soaked, rate: float, seed: int, verbose: bool) -> None:
        self._soaked = soaked
        self._rate = rate
        self._chance = random.Random(seed)
        self._verbose = verbose
        self._scripts: list[FaultScript] = []
        self._point: object = None

    def __call__(self, laboratory: Laboratory, progress: Progress) -> None:
        """At every new point something may be about to happen."""
        point = progress.scan_id, progress.done
        if progress.phase != "running" or progress.geometry is None or point == self._point:
            return
        self._point = point
        self._soaked.points += 1
        if self._soaked.points % EVERY == 0:
            self._soaked.memory.append((self._soaked.points, resident()))
            if self._verbose:
                print(f"{self._soaked.points} points, {resident():.0f} MB", file=sys.stderr, flush=True)
        if self._chance.random() < self._rate:
            self._lay(laboratory)

    def settle(self) -> None:
        """Write down what has happened."""
        for script in self._scripts:
            self._soaked.struck.update(str(fault.kind) for _, fault in script.happened)
        self._scripts.clear()

    def _lay(self, laboratory: Laboratory) -> None:
        kind = self._chance.choice(list(Kind))
        role = self._chance.choice(ROLES)
        if kind is Kind.DRIFT and role == "detector_stage" and laboratory.families[1] == "k10cr1":
            return  # no encoder: nobody can see it
        device = getattr(laboratory, role)
        lasts = LASTS if kind in LASTING else 0.0
        fault = Fault(kind, self._chance.randint(1, 12), self._chance.choice((1, 1, 2, 5)), seconds=lasts)
        script = FaultScript([fault], seed=self._chance.randrange(1 << 30))
        self._scripts.append(script)
        device.script = script


def resident() -> float:
    """Resident memory of this process, megabytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def campaign(number: int, points: int) -> Campaign:
    """The campaign `number`, of about so many points at most: one or more samples with a uniform step."""
    per_sample = len(INCIDENT) * 150
    samples = max(min(round(points / per_sample), 4), 1)
    step = 1.0 if points >= per_sample else 10.0
    return Campaign(
        name=f"Soak {number}",
        seed=number,
        samples=tuple(Sample(name=f"S{i}", material=MATERIALS[i % len(MATERIALS)]) for i in range(samples)),
        incident=INCIDENT,
        outgoing=OutgoingRange(start=-80.0, stop=80.0),
        resolution=Resolution(mode="uniform", step=step),
        reference=Reference(step=10.0, scans=1),
        integration=Integration(scans=1, maximum=2.0),
    )


def soak(points: int, *, rate: float = 0.05, seed: int = 0, verbose: bool = False) -> Soaked:
    """Measure at least so many points, at each of which a fault is laid in wait with the probability `rate`."""
    soaked = Soaked()
    misfortune = Misfortune(soaked, rate, seed, verbose)
    retries = _Retries()
    root = logging.getLogger()
    names = ("drivers", "goniometer")
    asyncio.run(asyncio.sleep(0))
    soaked.memory.append((0, resident()))
    gc.collect()  # what was there before must not go in between, and what is left must be more than garbage
    before = threading.active_count(), len(os.listdir("/proc/self/fd"))
    begin = time.monotonic()
    root.addHandler(retries)
    try:
        number = 0
        while soaked.points < points:
            _one(soaked, misfortune, number, points - soaked.points)
            number += 1
    finally:
        root.removeHandler(retries)
    soaked.seconds = time.monotonic() - begin
    soaked.retries = Counter({name: n for name, n in retries.counts.items() if name in {*names, "scheduler"}})
    gc.collect()
    deadline = time.monotonic() + 3.0
    while threading.active_count() > before[0] and time.monotonic() < deadline:
        time.sleep(0.01)
    soaked.memory.append((soaked.points, resident()))
    gc.collect()
    soaked.threads = before[0], threading.active_count()
    soaked.descriptors = before[1], len(os.listdir("/proc/self/fd"))
    return soaked


def _one(soaked: Soaked, misfortune: Misfortune, number: int, points: int) -> None:
    """One campaign in a database of its own, and the comparison with the truth."""
    wanted = campaign(number, points)
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "soak.db")
        try:
            stages = STAGES[number % len(STAGES)]
            soaked.ended.update(run(store, wanted, stages, misfortune, runs=RUNS, quiet_last=False))
            misfortune.settle()
            truth = Truth(wanted.seed)
            for scan in store.scans():
                soaked.wrong += wrong(store, scan, truth, sigma=SIGMA)
                soaked.lost += lost(store, scan)
        finally:
            store.close()


def main(points: int, rate: float) -> int:
    """Print what came of it; returns 1 where a point is wrong, or lost without a stage that is too slow."""
    logging.getLogger().addHandler(logging.NullHandler())
    soaked = soak(points, rate=rate, verbose=True)
    print(f"points a second   {soaked.points / soaked.seconds:.1f}")
    print(f"requests struck   {soaked.struck.total()}: {dict(sorted(soaked.struck.items()))}")
    print(f"tried again       {dict(soaked.retries)}")
    print(f"runs ended        {soaked.ended.total()}: {dict(soaked.ended)}")
    print("points given up  ", *soaked.lost[:20], sep="\n  ")
    print("points wrong     ", *soaked.wrong[:20], sep="\n  ")
    print("resident memory  ", ", ".join(f"{at}: {size:.0f} MB" for at, size in soaked.memory))
    tell("points", soaked.points)
    tell("requests struck", soaked.struck.total(), f"by {len(soaked.struck)} kinds of faults")
    tell("runs ended by a typed error and taken up again", soaked.ended.total())
    tell("points wrong, twice there or missing", len(soaked.wrong), aim="= 0")
    tell("points given up because a stage was ten times too slow", len(soaked.lost) - len(soaked.unexplained))
    tell("points given up for another reason", len(soaked.unexplained), aim="= 0")
    tell("threads left", soaked.threads[1] - soaked.threads[0], aim="= 0")
    tell("descriptors left", soaked.descriptors[1] - soaked.descriptors[0], aim="= 0")
    (_, early), (_, late) = soaked.memory[1], soaked.memory[-1]
    tell(f"resident memory at the end, after {soaked.memory[1][0]} points {early:.0f} MB", late, "MB")
    return bool(soaked.unexplained or soaked.wrong)


if __name__ == "__main__":
    numbers = sys.argv[1:]
    sys.exit(main(int(numbers[0]) if numbers else 20_000, float(numbers[1]) if len(numbers) > 1 else 0.05))
