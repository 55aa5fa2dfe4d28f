"""How long all tests take, and whether they pass.

    python -m tests.benchmarks.suite

runs the tests as `make test` does.
"""

import re
import subprocess
import sys
import time

from tests.benchmarks.figures import tell
from tests.benchmarks.page import ROOT

LONGEST = 900
"""Seconds that are allowed on two cores."""


def main() -> int:
    """Run them; returns what pytest returns."""
    began = time.monotonic()
    command = [sys.executable, "-m", "pytest", "-q", "-n", "4", "--dist", "loadfile", "--no-loadscope-reorder"]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    seconds = time.monotonic() - began
    print(done.stdout)
    counts = {what: int(count) for count, what in re.findall(r"(\d+) (passed|failed|error|skipped)", done.stdout)}
    tell("tests that passed", counts.get("passed", 0), aim="> 0")
    tell("tests that failed", counts.get("failed", 0) + counts.get("error", 0), aim="= 0")
    tell("tests left out", counts.get("skipped", 0))
    tell("all tests", seconds, "s", f"< {LONGEST}")
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
