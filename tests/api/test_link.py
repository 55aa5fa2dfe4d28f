"""The process that drives the bench, as its service holds it."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.bench.link import Link
from api.bench.runner import Task
from api.bodies.events import Notice
from api.errors import BenchEnded
from api.events import Events
from goniometer.storage.store import Store
from tests.served import wait_for

ENDED = "The process that drives the bench has ended (code -9) and is started anew; see the log"


@pytest.fixture
def make_link(tmp_path: Path) -> Iterator[Callable[[], Link]]:
    """Makes links of services on one database; all are closed in the end."""
    store = Store.open(tmp_path / "bench.db")
    links: list[Link] = []

    def make() -> Link:
        task = Task(tmp_path / "bench.db", tmp_path, None, "http://127.0.0.1:1", mounts_by_itself=True, bench="bench")
        links.append(Link(task, store, Events()))
        return links[-1]

    yield make
    for link in links:
        link.close()
    store.close()


def processes() -> set[int]:
    """Those that drive benches or would."""
    return {each.pid for each in multiprocessing.active_children() if each.name == "goniometer bench" and each.pid}


def texts(link: Link) -> list[str]:
    """Of the alarms that are told now."""
    return [alarm.text for alarm in link.state.alarms]


def drives_here(link: Link) -> bool:
    """Whether this service drives, as far as it knows."""
    return link.state.driver is not None and link.state.driver.here


@pytest.mark.parametrize("after", [0.0, 0.05, 0.3])
def test_a_service_that_is_told_to_end_while_its_bench_is_being_started_ends(
    make_link: Callable[[], Link], after: float
) -> None:
    link = make_link()
    link.start()
    time.sleep(after)
    closing = threading.Thread(target=link.close, daemon=True)
    closing.start()
    closing.join(60)
    assert not closing.is_alive()
    assert processes() == set()


def test_a_bench_whose_process_ended_while_a_command_was_given_up_comes_back_with_an_alarm_until_it_is_used(
    make_link: Callable[[], Link],
) -> None:
    link = make_link()
    link.start()
    wait_for(lambda: link.state.driver)
    (process,) = processes()
    os.kill(process, signal.SIGSTOP)
    assert link.ask("connect", lambda *_: None).cancel()
    waiting = link.ask("connect", lambda *_: None)
    os.kill(process, signal.SIGKILL)
    assert isinstance(waiting.exception(60), BenchEnded)
    wait_for(lambda: link.state.driver)
    assert processes() - {process}
    assert texts(link) == [ENDED]
    link.ask("connect", lambda *_: None).result(60)
    assert texts(link) == []


def test_the_alarm_of_a_service_that_stands_by_is_not_told_beside_the_bench_that_another_drives(
    make_link: Callable[[], Link],
) -> None:
    driving, standing_by = make_link(), make_link()
    driving.start()
    wait_for(lambda: driving.state.driver)
    before = processes()
    told: list[Any] = []
    standing_by._events.publish = lambda kind, data: told.append(data)
    standing_by.start()
    wait_for(lambda: standing_by.state.driver)
    said = [data.message for data in told if isinstance(data, Notice)]
    assert [text for text in said if text.startswith("This service does not drive the bench: The bench is driven by")]
    (process,) = processes() - before
    os.kill(process, signal.SIGKILL)
    wait_for(lambda: not standing_by.lives)
    wait_for(lambda: standing_by.state.driver)
    assert texts(driving) == texts(standing_by) == []
    (driver,) = before
    os.kill(driver, signal.SIGKILL)
    wait_for(lambda: not driving.lives)
    wait_for(lambda: driving.lives and driving.state.driver and standing_by.state.driver)
    wait_for(lambda: sorted(drives_here(link) for link in (driving, standing_by)) == [False, True])
    (other,) = [link for link in (driving, standing_by) if not drives_here(link)]
    assert texts(other) == [], "who drives now tells of the bench"


def test_a_command_to_a_process_that_has_ended_is_refused_and_forgotten(make_link: Callable[[], Link]) -> None:
    link = make_link()
    here, there = multiprocessing.Pipe()
    there.close()
    link._connection = here
    with pytest.raises(BenchEnded, match="has ended"):
        link.ask("connect", lambda *_: None)
    assert link._waiting == {}
