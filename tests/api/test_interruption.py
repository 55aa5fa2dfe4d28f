"""A run survives being killed, paused, aborted and started twice."""

import json
import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from goniometer.storage.store import Store

PATIENCE = 600.0
"""Seconds after which a process that should have got somewhere is called stuck."""


@contextmanager
def running(folder: Path, campaign: str = "small.yaml") -> Iterator[subprocess.Popen[str]]:
    """A run in the background; killed when the context ends."""
    command = [Path(sys.executable).with_name("goniometer"), "run", campaign, "--json"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def wait_for(condition: Callable[[], bool]) -> None:
    """Return when `condition` holds; fail when it does not in time."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


def count(folder: Path, query: str) -> int:
    """A number from the database; 0 while there is none."""
    file = folder / "goniometer.db"
    if not file.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as database, database:
            return int(database.execute(query).fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def ended(process: subprocess.Popen[str]) -> bool:
    return process.poll() is not None


DONE = "SELECT count(*) FROM points WHERE status = 'done'"
IN_FLIGHT = "SELECT count(*) FROM points WHERE status = 'running'"


def comparable(result: dict[str, Any]) -> list[dict[str, Any]]:
    """What must be the same after any interruption: everything but the time that it took and the folder."""
    return [
        {k: v for k, v in sample.items() if k != "bench_seconds"} | {"files": [Path(f).name for f in sample["files"]]}
        for sample in result["samples"]
    ]


@pytest.mark.slow
def test_a_run_goes_on_when_nobody_reads_its_progress_any_more(
    small: tuple[Path, dict[str, Any]], folder: Path
) -> None:
    with running(folder) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert "reference panel" in process.stderr.readline()
        process.stderr.close()
        output = process.stdout.read()
        assert process.wait(PATIENCE) == 0
    assert comparable(json.loads(output)) == comparable(small[1])


@pytest.mark.slow
def test_killed_anywhere_a_run_continues_and_ends_with_the_same_numbers(
    small: tuple[Path, dict[str, Any]], folder: Path
) -> None:
    total = count(small[0], DONE)
    moments = sorted(random.Random(20).sample(range(2, total), 5))
    for moment in moments:
        with running(folder) as process:
            wait_for(partial(lambda points, run: count(folder, DONE) >= points or ended(run), moment, process))
            process.send_signal(signal.SIGKILL)
            process.wait()
    # a killed process leaves its point as running, unless it was so late that none is left
    while count(folder, IN_FLIGHT) == 0 and count(folder, DONE) < total:
        with running(folder) as process:
            wait_for(partial(lambda run: count(folder, IN_FLIGHT) == 1 or ended(run), process))
            process.send_signal(signal.SIGKILL)
            process.wait()
    with running(folder) as process:  # once more, when everything is measured and the fits are under way
        wait_for(lambda: count(folder, "SELECT count(*) FROM datasets") == 2)
        process.send_signal(signal.SIGKILL)
        process.wait()
    with running(folder) as process:
        output, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
    assert comparable(json.loads(output)) == comparable(small[1])
    assert count(folder, DONE) == total
    assert count(folder, "SELECT count(*) FROM datasets") == 2
    assert count(folder, "SELECT max(attempts) FROM points") > 1


def test_a_second_run_on_the_same_database_is_refused_and_harms_nothing(cli: Any, folder: Path) -> None:
    with running(folder, "long.yaml") as process:
        wait_for(lambda: count(folder, DONE) > 1)
        second = cli("run", "long.yaml", cwd=folder)
        assert second.returncode == 1
        assert "in use by another run" in second.stderr
        assert len(second.stderr.strip().splitlines()) == 1
        before = count(folder, DONE)
        wait_for(lambda: count(folder, DONE) > before)
        assert process.poll() is None


PAUSED = "SELECT count(*) FROM scans WHERE phase = 'paused'"


def test_pause_resume_and_abort_reach_a_run_in_another_process_and_nothing_is_lost(cli: Any, folder: Path) -> None:
    with running(folder, "long.yaml") as process:
        wait_for(lambda: count(folder, DONE) > 1)
        wait_for(lambda: cli("pause", cwd=folder).returncode == 0)  # between two scans there is none
        wait_for(lambda: count(folder, PAUSED) == 1)
        paused = count(folder, DONE)
        time.sleep(0.5)
        assert count(folder, DONE) == paused
        wait_for(lambda: cli("resume", cwd=folder).returncode == 0)
        wait_for(lambda: count(folder, DONE) > paused)
        wait_for(lambda: cli("abort", cwd=folder).returncode == 0)
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 1
        assert "aborted" in errors
    kept = count(folder, DONE)
    assert kept > paused
    refused = cli("pause", cwd=folder)
    assert refused.returncode == 2  # nothing runs any more
    assert "Nothing is running" in refused.stderr
    with closing(Store.open(folder / "goniometer.db")) as store, store.exclusive():
        refused = cli("pause", cwd=folder)
        assert refused.returncode == 2
        assert "No scan is under way just now on bench, which is in use" in refused.stderr
    with running(folder, "long.yaml") as process:
        wait_for(lambda: count(folder, DONE) > kept)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_in_one_line_with_its_scan_put_down_as_aborted(
    folder: Path, number: signal.Signals
) -> None:
    with running(folder, "long.yaml") as process:
        wait_for(lambda: count(folder, DONE) > 1)
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == (130 if number == signal.SIGINT else 143)
    assert output == ""
    assert errors.strip().splitlines()[-1].startswith("goniometer: Stopped; run the same command again")
    assert "Traceback" not in errors
    assert count(folder, "SELECT count(*) FROM scans WHERE outcome = 'aborted'") == 1


def test_a_killed_run_is_called_interrupted(cli: Any, folder: Path) -> None:
    with running(folder, "long.yaml") as process:
        wait_for(lambda: count(folder, DONE) > 1)
        process.kill()
        process.wait()
    told = cli("status", cwd=folder).stdout
    assert "Long: reference panel: interrupted" in told
    assert re.search(r"of about 162 points, \d.* \(\d.* to \d.*\) to go", " ".join(told.split()))
    assert cli("pause", cwd=folder).returncode == 2
