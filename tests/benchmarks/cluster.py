"""What a Dask cluster costs and gains, against a process pool and one process, all in one run on this machine.

    python -m tests.benchmarks.cluster

First the same ensemble of fits in one process, in a pool and on a cluster of as many workers as there are processors,
by turns; then what a task costs without any work in it; then, for each kind of task, its work, what travels there and
back, and what travels once, and what the database takes to keep fits. Seconds of a clock depend on what else the
machine does; those of processors do not, nor the share of them that one process would have needed for the same.
"""

import os
import pickle
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil
from distributed import LocalCluster
from distributed.protocol.pickle import dumps

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reports.report import NO_RUN
from api.cluster import connected
from api.executor import processes
from api.results.derive import derive
from api.results.products import fit_datasets
from goniometer.storage.store import Store
from simulators.choices import Kernel
from simulators.rays.rays import terrain
from simulators.rays.scan import Goniometer, ray_scan
from simulators.stability.ensemble import ensemble, jobs
from simulators.topographies.topography import topography
from simulators.waves.diffraction import seen_through
from simulators.waves.scan import Setup, choose_patches
from simulators.waves.simulation import simulate
from tests.benchmarks.figures import tell
from tests.drawn_dataset import drawn_dataset

WORKERS = os.cpu_count() or 1
ROUNDS = 3
EMPTY = 3000
"""Tasks without work."""


class Watched(ThreadPoolExecutor):
    """One thread that notes what every task takes and what would travel."""

    def __init__(self) -> None:
        super().__init__(1)
        self.seconds: list[float] = []
        self.there: list[int] = []
        self.back: list[int] = []
        self.once: dict[int, int] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
        """Do it, watched."""
        if isinstance(fn, partial) and id(fn) not in self.once:
            self.once[id(fn)] = len(dumps(fn))
        self.there.append(len(dumps(args)) + (0 if isinstance(fn, partial) else len(dumps(fn))))
        return super().submit(self._watched, fn, *args, **kwargs)

    def _watched(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        before = time.thread_time()
        made = fn(*args, **kwargs)
        self.seconds.append(time.thread_time() - before)
        self.back.append(len(pickle.dumps(made)))
        return made

    def line(self, name: str) -> str:
        """Medians."""
        seconds, there, back = (np.median(each) for each in (self.seconds[1:], self.there[1:], self.back[1:]))
        once = max(self.once.values(), default=0)
        return (
            f"{name:22} {len(self.seconds):5} tasks {1e3 * seconds:8.0f} ms {1e-3 * there:9.1f} kB there "
            f"{1e-3 * back:9.1f} kB back {1e-3 * once:9.1f} kB once"
        )


@contextmanager
def cluster() -> Iterator[Executor]:
    """As many workers on this machine as it has processors."""
    with (
        LocalCluster(WORKERS, threads_per_worker=1, dashboard_address=":0", protocol="tcp://") as started,
        connected(started.scheduler_address) as executor,
    ):
        yield executor


def processor_seconds() -> float:
    """What this process and all that it has started have used so far."""
    own = psutil.Process()
    times = [each.cpu_times() for each in (own, *own.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


def efficiency(pool: Executor, dask: Executor) -> None:
    """The same ensemble by all three, in turns."""
    wanted = jobs(["few points", "outliers"], ["global", "cook-torrance-shift"], 5)
    took: dict[str, list[float]] = {"one process": [], "pool": [], "cluster": []}
    used: dict[str, list[float]] = {name: [] for name in took}
    with ThreadPoolExecutor(1) as one:
        executors = dict(zip(took, (one, pool, dask), strict=True))
        for executor in executors.values():
            list(ensemble(wanted[:16], executor))  # loads and compiles
        results = set()
        for _ in range(ROUNDS):
            for name, executor in executors.items():
                before, begun = time.perf_counter(), processor_seconds()
                results.add(repr(list(ensemble(wanted, executor))))
                took[name].append(time.perf_counter() - before)
                used[name].append(processor_seconds() - begun)
    print(f"{len(wanted)} fits, {ROUNDS} rounds, {WORKERS} processors")
    tell("different results of one process, a pool and a cluster", len(results), aim="= 1")
    alone, work = np.median(took["one process"]), np.median(used["one process"])
    for name, seconds in took.items():
        many = 1 if name == "one process" else WORKERS
        middle, busy = np.median(seconds), np.median(used[name])
        print(
            f"{name:12} {middle:6.1f} s   speed-up {alone / middle:4.2f}   efficiency {alone / middle / many:4.2f}   "
            f"{busy:6.1f} s of processors, {100 * work / busy:3.0f} % work"
        )
        tell(
            f"{len(wanted)} fits, {name}: efficiency",
            100 * alone / middle / many,
            f"% of {many} processors ({middle:.1f} s)",
        )


def overhead(name: str, executor: Executor) -> None:
    """Of tasks that do nothing; the scheduler of this cluster is a part of this process."""
    list(executor.map(abs, range(100)))
    before, used = time.perf_counter(), time.process_time()
    list(executor.map(abs, range(EMPTY)))
    clock, used = (time.perf_counter() - before) / EMPTY, (time.process_time() - used) / EMPTY
    tell(f"a task without work, {name}", 1e3 * clock, f"ms, {1e3 * used:.2f} ms of it computing here")


def tasks() -> None:
    """What every kind of task takes and moves."""
    metal, nm = load_conductor(), np.arange(380.0, 991.0, 10.0)
    n, k = metal.index(nm)
    with Watched() as watched:
        list(ensemble(jobs(["few points", "outliers"], ["global", "cook-torrance-shift"], 2), watched))
        print(watched.line("ensemble, 4 fits"))
    datasets = [drawn_dataset("sample-1", seed=seed) for seed in range(4)]
    with TemporaryDirectory() as folder, Watched() as watched:
        store = Store.open(Path(folder) / "fits.db")
        made = [store.add_dataset(None, each) for each in datasets]
        before = time.thread_time()
        list(fit_datasets(store, made, None, executor=watched))
        kept = (time.thread_time() - before) / len(made)
        size = datasets[0].theta_in.size
        print(watched.line(f"fit, {size} spectra"))
        stored = sum(len(fit.text) for fit in store.fits(made[0]))
        tell("the database keeps the fits of a dataset", 1e3 * kept, f"ms ({1e-3 * stored:.0f} kB)")
        with Watched() as apart:
            for each in made:
                apart.submit(derive, store.dataset(each), NO_RUN).result()
            print(apart.line(f"fit and files, {size}"))
    reflectance = partial(fresnel_conductor, n=n, k=k)
    asked = Goniometer(np.array([0.0, 40.0]), np.arange(-85.0, 86), nm, reflectance, 0, 4_000_000, 1, 1.0, 0.0)
    fields = [topography("sample-1", None, None, seed, micro=False).field for seed in range(4)]
    with Watched() as watched:
        ray_scan([terrain(each) for each in fields], asked, watched)
        print(watched.line("rays, some windows"))
    theta_in, theta_out = (x.ravel() for x in np.meshgrid([0.0, 40.0], np.arange(-85.0, 86, 5), indexing="ij"))
    setup = Setup(theta_in, theta_out, nm, seen_through(1.0), Kernel.HARVEY_SHACK, metal)
    with Watched() as watched:
        simulate(choose_patches("sample-4", 512, 0.5, 1, 4, micro=False), setup, watched)
        print(watched.line("waves, a patch"))


def main() -> None:
    """Print everything."""
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    with processes(None, WORKERS) as pool, cluster() as dask:
        efficiency(pool, dask)
        overhead("pool", pool)
        overhead("cluster", dask)
    tasks()
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
