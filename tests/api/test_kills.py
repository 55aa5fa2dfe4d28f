"""A process killed at any instant loses nothing that was committed, and its campaign ends as if it had not been."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_twenty_kills_in_a_row_lose_nothing_and_change_no_number() -> None:
    # in a process of its own, for its children are forked from it, and this one may have threads
    command = [sys.executable, "-m", "tests.benchmarks.kills", "--kills", "20", "--seed", "7"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=500)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "| SIGKILLs | 20 |" in done.stdout
    assert "| lost, doubled or changed | 0 |" in done.stdout
    assert "| campaigns that came to their end | 0 |" not in done.stdout


@pytest.mark.slow
def test_a_service_that_is_killed_and_started_again_keeps_what_it_confirmed() -> None:
    command = [sys.executable, "-m", "tests.benchmarks.restarts", "--restarts", "4", "--seed", "7"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=500)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "| lost, doubled or changed | 0 |" in done.stdout
    assert "| campaigns that it confirmed as queued | 0 |" not in done.stdout
