"""Runs the benchmarks one after the other and writes docs/measured.md, the page of all figures.

    python -m tests.benchmarks [NAME ...]

Without a name all are run but those that take too long, which are run where they are named. Exit code 1 where one of
them failed, that is, ended with an error, took far too long, or told no figure; a figure that misses its aim does not.
"""

import os
import shlex
import signal
import subprocess
import sys
import threading
import time
import timeit
from contextlib import suppress
from dataclasses import dataclass
from datetime import date

from tests.benchmarks.page import PAGE, ROOT, Outcome, machine, remembered, write

ONE_THREAD = "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1"
"""For processor times that are compared, and for benchmarks that keep both cores busy by themselves."""


@dataclass(frozen=True)
class Benchmark:
    """A module of this folder, and the size at which it is run for the page."""

    name: str
    minutes: float
    """That it takes on two idle cores, about."""
    arguments: str = ""
    environment: str = ""
    named: bool = False
    """Whether it is run only where it is named."""

    @property
    def command(self) -> str:
        """What a person would type."""
        return f"{self.environment} python -m tests.benchmarks.{self.name} {self.arguments}".strip()


PROOFS = {
    "The bench and its drivers": (
        Benchmark("driver_overhead", 0.7),
        Benchmark("fault_matrix", 1, "1"),
        Benchmark("soak", 1, "500"),
        Benchmark("time_left", 0.5),
    ),
    "Measurements and their uncertainty": (
        Benchmark("coverage", 2, "24"),
        Benchmark("corrections", 1),
        Benchmark("recalibration", 0.2),
    ),
    "Where to measure": (
        Benchmark("sampling", 2.5, environment=ONE_THREAD),
        Benchmark("sampling_search", 0.7, "40", environment=ONE_THREAD),
        Benchmark("planning_cost", 0.2, environment=ONE_THREAD),
        Benchmark("sector", 1.4, "1"),
    ),
    "Models and fits": (
        Benchmark("demo", 0.6),
        Benchmark("fits", 1.5, environment=ONE_THREAD),
        Benchmark("table2", 2.2),
        Benchmark("shift_forms", 0.4),
    ),
    "From topography to scattering": (
        Benchmark("waves", 2.3, "sums sample", environment=ONE_THREAD),
        Benchmark("rays", 1.5),
        Benchmark("tabulated", 0.4),
        Benchmark("claims", 11, named=True),
    ),
    "Speed against accuracy, stability, and scenes": (
        Benchmark("stability", 3.2, "5"),
        Benchmark("choose", 2.4, "512"),
        Benchmark("scene_scan", 1.5, "1.0"),
    ),
    "Into a renderer": (
        Benchmark("bsdf", 1.5),
        Benchmark("render_time", 2.4, "--rounds 20"),
    ),
    "The service, its screen and the command line": (
        Benchmark("service_load", 5),
        Benchmark("first_paint", 0.4),
        Benchmark("startup", 0.7),
    ),
    "Nothing lost, and room to grow": (
        Benchmark("kills", 3.5),
        Benchmark("restarts", 2.5),
        Benchmark("write_rate", 0.6),
        Benchmark("cluster", 1),
        Benchmark("year", 3.5, "10000 0.01"),
    ),
    "The whole": (Benchmark("suite", 15, named=True),),
}
BENCHMARKS = {each.name: each for some in PROOFS.values() for each in some}


def output(*command: str) -> str:
    """What a command prints."""
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def commit() -> str:
    """The code that is measured."""
    changed = output("git", "status", "--porcelain", "--", "*.py")
    return output("git", "rev-parse", "--short", "HEAD") + (" with changes" if changed else "")


def run(benchmark: Benchmark) -> Outcome:
    """Run a benchmark in a process of its own, show what it prints, and keep its figures."""
    setting = dict(each.split("=") for each in benchmark.environment.split())
    command = [sys.executable, "-m", f"tests.benchmarks.{benchmark.name}", *shlex.split(benchmark.arguments)]
    load, pace = os.getloadavg()[0], 1000 * min(timeit.repeat("x += 1", "x = 0", number=10**6, repeat=3))
    began, used = time.monotonic(), _processors()
    process = subprocess.Popen(
        command, cwd=ROOT, env=os.environ | setting, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    longest = 10 + 5 * benchmark.minutes
    timer = threading.Timer(60 * longest, _kill, (process.pid,))
    timer.start()
    rows = []
    try:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            if line.startswith("| "):
                rows.append(line.strip())
        code = process.wait()
    finally:
        timed_out = not timer.is_alive()
        timer.cancel()
        _kill(process.pid)  # with whatever it has started
    failure = f"it ended with exit code {code}" if code else "" if rows else "it told no figure"
    if timed_out:
        failure = f"it had not ended after {longest:.0f} minutes"
    minutes, processors = (time.monotonic() - began) / 60, (_processors() - used) / 60
    today = date.today().isoformat()
    return Outcome(benchmark.command, today, commit(), machine(), load, minutes, processors, rows, failure, pace)


def _processors() -> float:
    """Seconds of processors that all children used that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def _kill(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def main(names: list[str]) -> int:
    """Run what is named, or all but the long ones; returns 1 where one failed, and 2 for an unknown name."""
    if unknown := sorted(set(names) - set(BENCHMARKS)):
        print(f"there is no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was started ends, too
    wanted = [each for name, each in BENCHMARKS.items() if name in names or not (names or each.named)]
    proofs = {proof: [each.name for each in some] for proof, some in PROOFS.items()}
    outcomes = remembered()
    for number, benchmark in enumerate(wanted):
        left = sum(each.minutes for each in wanted[number:])
        print(f"\n[{number + 1} of {len(wanted)}, about {left:.0f} minutes left] {benchmark.command}", flush=True)
        outcomes[benchmark.name] = run(benchmark)
        write(proofs, {name: outcomes[name] for name in BENCHMARKS if name in outcomes})
    failed = [each.name for each in wanted if outcomes[each.name].failure]
    print(f"\n{PAGE.relative_to(ROOT)} is written" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
