"""How soon the command line answers: medians over new processes, of help and of a command that does something.

    python -m tests.benchmarks.startup

A clock also counts what else the machine does; the processor's seconds are those of the process alone.
"""

import os
import subprocess
import sys
import time
from statistics import median

from tests.benchmarks.figures import tell

ROUNDS = 15
COMMANDS = (
    ("--help",),
    ("run", "--help"),
    ("fit", "--help"),
    ("export", "--help"),
    ("simulate", "waves", "--help"),
    ("stability", "--help"),
    ("serve", "--help"),
)


def took(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Seconds by the clock and of processors."""
    before, used = time.perf_counter(), os.times()
    command = [sys.executable, "-c", "from api.commands.main import main; main()", *arguments]
    subprocess.run(command, capture_output=True, check=True)
    after = os.times()
    busy = after.children_user + after.children_system - used.children_user - used.children_system
    return time.perf_counter() - before, busy


def main() -> None:
    """Tell both for each."""
    for arguments in COMMANDS:
        took(arguments)
        clock, busy = (median(each) for each in zip(*(took(arguments) for _ in range(ROUNDS)), strict=True))
        aim = "< 0.3" if arguments == ("--help",) else ""
        tell(f"`goniometer {' '.join(arguments)}`", clock, f"s ({busy:.2f} s of processors)", aim)


if __name__ == "__main__":
    main()
