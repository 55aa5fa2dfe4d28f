"""What lacks in a dataset is filled where it holds nobody up, and nothing of it outlives the service."""

import asyncio
import os
import signal
import subprocess
import sys
import threading
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest

from analysis.figures.filled import STEP
from api.access.accounts import add_user
from api.access.tokens import create_token
from api.errors import Conflict
from api.views import opened
from api.web.app import make_app
from api.web.filling import NAME, fill_apart
from api.web.live import open_live
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import fill, unmeasured
from goniometer.errors import StoreBusy
from goniometer.storage.store import Store
from tests.api.service_client import Client
from tests.drawn_dataset import drawn_dataset
from tests.served import wait_for

KILLED = """
import sys, threading
from api.web.filling import fill_apart
from pathlib import Path

threading.Thread(target=fill_apart, args=(Path(sys.argv[1]), 1, threading.Event()), daemon=True).start()
sys.stdin.read()
"""
"""A process that has something filled until it is killed."""


def drawn(incident: int, outgoing: int) -> Dataset:
    """A dataset of a grid of directions, but for the blocked ones."""
    theta_in, theta_out = (
        each.ravel() for each in np.meshgrid(np.linspace(0, 60, incident), np.linspace(-80, 80, outgoing))
    )
    seen = np.abs(theta_in + theta_out) >= 5
    return drawn_dataset("sample-4", at=(theta_in[seen], theta_out[seen]))


def stored(file: Path, dataset: Dataset) -> None:
    store = Store.open(file)
    store.add_dataset(None, dataset)
    store.close()


def test_a_page_tells_what_lacks_in_a_dataset_and_the_process_that_answers_it_computes_nothing_of_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = drawn(3, 9)
    expected = fill(dataset, *unmeasured(dataset, STEP))

    def refuse(*_: object) -> None:
        raise AssertionError("it fills in the process of the service")

    monkeypatch.setattr(opened, "fill", refuse)
    with open_live(tmp_path / "bench.db", tmp_path) as live:
        number = live.store.add_dataset(None, dataset)
        add_user(live.store, "anna", "viewer", None)
        client = Client(live)
        client.headers["Authorization"] = f"Bearer {create_token(live.store, 'anna', 'test')[0]}"
        answer = client.get(f"/api/datasets/{number}/map")
    assert answer.status_code == 200, answer.text
    assert 0 < len(answer.json()["filled"]) == int(expected.tells.sum())


def test_a_service_that_cannot_read_its_database_does_not_start_and_leaves_no_bench_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> int:
        wait_for(lambda: live.worker.lives)
        raise StoreBusy("bench.db is locked by another program")

    async def start() -> None:
        async with app.router.lifespan_context(app):
            pass

    with open_live(tmp_path / "bench.db", tmp_path) as live:
        app = make_app(live)
        monkeypatch.setattr(live.store, "newest_dataset", refuse)
        with pytest.raises(StoreBusy):
            asyncio.run(start())
        assert all(each.name != "goniometer bench" for each in active_children())


def test_a_service_that_ends_does_not_wait_for_what_is_being_filled(tmp_path: Path) -> None:
    stored(tmp_path / "bench.db", drawn(13, 161))
    stop = threading.Event()
    ended: list[Exception] = []

    def ask() -> None:
        try:
            fill_apart(tmp_path / "bench.db", 1, stop)
        except Conflict as error:
            ended.append(error)

    asking = threading.Thread(target=ask)
    asking.start()
    wait_for(lambda: any(each.name == NAME for each in active_children()))
    stop.set()
    asking.join()
    assert "Dataset 1 was not filled" in str(ended[0])
    assert all(each.name != NAME for each in active_children())


def test_a_service_that_is_killed_leaves_no_process_behind_that_fills(tmp_path: Path) -> None:
    stored(tmp_path / "bench.db", drawn(13, 161))
    command = [sys.executable, "-c", KILLED, str(tmp_path / "bench.db")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as service:

        def of_it() -> list[int]:
            """Processes of its session that are at work."""
            found = [int(each.name) for each in Path("/proc").iterdir() if each.name.isdecimal()]
            return [each for each in found if each != service.pid and session(each) == service.pid]

        wait_for(lambda: any(niceness(each) > 0 for each in of_it()))
        os.kill(service.pid, signal.SIGKILL)
        wait_for(lambda: not of_it())


def session(process: int) -> int | None:
    """The session of a process; None where it has ended."""
    try:
        state, _, _, number = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[:4]
    except (FileNotFoundError, ProcessLookupError):
        return None
    return None if state == "Z" else int(number)


def niceness(process: int) -> int:
    """How far a process steps back; 0 where it has ended."""
    try:
        return os.getpriority(os.PRIO_PROCESS, process)
    except ProcessLookupError:
        return 0
