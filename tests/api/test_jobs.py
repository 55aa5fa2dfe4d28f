"""Jobs are never lost from sight: they end, are cancelled with all they have started, or are told to be interrupted."""

import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api import job_rows
from api.errors import Conflict
from api.events import Events
from api.job_arguments import ExportArguments, StabilityArguments
from api.job_rows import INTERRUPTED, SILENT, Job, add_job, begin, finish, interrupt_orphans, job
from api.jobs import Jobs
from goniometer.errors import InputError, NotInStore
from goniometer.store import Store
from tests.drawn_dataset import drawn_dataset

Place = tuple[Store, Path]


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """A database with a dataset, and where it is."""
    path = tmp_path / "bench.db"
    store = Store.open(path)
    store.add_dataset(None, drawn_dataset("sample-4"))
    return store, path


@pytest.fixture
def jobs(place: Place, tmp_path: Path) -> Iterator[Jobs]:
    """The jobs of a service."""
    store, path = place
    made = Jobs(store, path, tmp_path / "results", Events())
    yield made
    made.close()


def until(store: Store, number: int, wanted: Callable[[Job], object]) -> Job:
    """The job once it is as wanted."""
    end = time.monotonic() + 120
    while not wanted(found := job(store, number)):
        assert time.monotonic() < end, found
        time.sleep(0.05)
    return found


def alive(group: int) -> bool:
    """Whether any process of a group is there."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_job_ends_with_its_result_or_a_sentence_and_a_cancelled_one_with_all_it_has_started(
    place: Place, jobs: Jobs
) -> None:
    store, _ = place
    long = jobs.submit("stability", StabilityArguments(runs=500), "anna")
    written = jobs.submit("export", ExportArguments(dataset=1, format="csv"), "anna")
    damaged = jobs.submit("export", ExportArguments(dataset=7, format="csv"), "anna")
    until(store, long.id, lambda found: found.share)  # its own processes have made something
    (process,) = [
        each.pid for each in multiprocessing.active_children() if each.pid and os.getpgid(each.pid) == each.pid
    ][:1]
    jobs.cancel(long.id)
    assert job(store, long.id).state == "cancelled"
    end = time.monotonic() + 20
    while alive(process):
        assert time.monotonic() < end, "something of the job goes on"
        time.sleep(0.05)
    with pytest.raises(Conflict, match="is over"):
        jobs.cancel(long.id)
    assert until(store, written.id, lambda found: found.finished).state == "done"
    told = json.loads(job_rows.result_of(store, written.id) or "")
    assert Path(store.export(told["export"]).path).read_text().count("\n") > 1000
    failed = until(store, damaged.id, lambda found: found.finished)
    assert (failed.state, failed.has_result) == ("failed", False)
    assert "There is no dataset 7" in failed.reason


def test_a_job_whose_service_died_is_told_so_and_can_be_run_again(place: Place, tmp_path: Path) -> None:
    store, path = place
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    machine, _, life = job_rows.runner().rsplit(":", 2)
    arguments = ExportArguments(dataset=1, format="csv").model_dump_json()
    old = add_job(store, "export", arguments, "anna", f"{machine}:{gone.pid}:{life}")
    begin(store, old.id)
    jobs = Jobs(store, path, tmp_path / "results", Events())
    try:
        found = job(store, old.id)
        assert (found.state, found.reason) == ("interrupted", INTERRUPTED)
        again = jobs.again(old.id, "berta")
        assert (again.arguments, again.who) == (arguments, "berta")
        with pytest.raises(Conflict, match="wait for its end"):
            jobs.again(again.id, "berta")
    finally:
        jobs.close()
    ended = job(store, again.id)
    assert ended.state in {"interrupted", "done"}
    with pytest.raises(Conflict, match="ending"):
        jobs.again(old.id, "anna")


def test_a_job_of_another_living_service_is_left_alone_until_that_is_silent(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, _ = place
    other = add_job(store, "export", "{}", "anna", "another machine:1:ab")
    assert interrupt_orphans(store, job_rows.runner()) == []
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + SILENT + 1)
    assert interrupt_orphans(store, job_rows.runner()) == [other.id]
    assert not finish(store, other.id, "done")  # what has ended stays as it is
    assert job(store, other.id).state == "interrupted"


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (ExportArguments(dataset=7, format="csv"), NotInStore),
        (ExportArguments(dataset=1, format="word"), InputError),
        (ExportArguments(dataset=1, format="csv", options={"raw": True}), InputError),
        (StabilityArguments(regimes=["none"]), InputError),
    ],
)
def test_what_cannot_be_done_is_refused_before_it_waits(place: Place, arguments: Any, fault: type[Exception]) -> None:
    with pytest.raises(fault):
        arguments.check(place[0])
