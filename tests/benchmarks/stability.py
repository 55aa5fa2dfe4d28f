"""Whether fits of difficult measurements that fail say so: every regime, severity and method.

    python -m tests.benchmarks.stability [RUNS]

makes what `goniometer stability` makes, with RUNS (5) measurements of every cell; `--page` of that command draws it.
"""

import os
import sys

from api.executor import processes
from api.results.stability import silent_line
from simulators.choices import ABOUT, METHODS
from simulators.stability.ensemble import ensemble, jobs
from tests.benchmarks.figures import tell


def main(runs: int) -> None:
    """Fit everything, and tell how many failures were silent."""
    with processes(None, os.cpu_count()) as executor:
        found = list(ensemble(jobs(list(ABOUT), list(METHODS), runs), executor))
    silent = [each for each in found if each.silent]
    for each in silent:
        print(silent_line(each))
    tell(f"fits, {runs} measurements of every cell", len(found))
    tell("failures that were not said", len(silent), aim="= 0")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
