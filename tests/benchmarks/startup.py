"""How soon the command line answers: medians over new processes, of help and of a command that does something.

    python -m tests.benchmarks.startup

A clock also counts what else the machine does; the processor's seconds are those of the process alone.
"""

import os
import subprocess
import sys
import time
from statistics import median

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
    """Print a line for each."""
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    for arguments in COMMANDS:
        took(arguments)
        clock, busy = (median(each) for each in zip(*(took(arguments) for _ in range(ROUNDS)), strict=True))
        print(f"goniometer {' '.join(arguments):24} {clock:5.2f} s, of processors {busy:5.2f} s")
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
