"""Jobs are never lost from sight: they end, are cancelled with all they have started, or are told to be interrupted."""

import json
import multiprocessing
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.access import audit
from api.bodies.base import Asked
from api.bodies.jobs import ExportArguments, StabilityArguments
from api.errors import Conflict
from api.events import Events
from api.jobs import rows as job_rows
from api.jobs.checks import check
from api.jobs.retention import Retention, prune
from api.jobs.rows import INTERRUPTED, SILENT, Job, add_job, begin, finish, interrupt_orphans, job
from api.jobs.running import Jobs
from goniometer.errors import InputError, NotInStore, StoreError
from goniometer.storage.store import Store
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
    end = time.monotonic() + 400
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
    assert (failed.state, failed.fault, failed.has_result) == ("failed", "not-in-store", False)
    assert "There is no dataset 7" in failed.reason
    assert {job(store, each.id).fault for each in (long, written)} == {None}


def test_programs_tell_a_job_that_was_killed_and_one_that_may_not_write_from_others(
    place: Place, jobs: Jobs, tmp_path: Path
) -> None:
    store, _ = place
    long = jobs.submit("stability", StabilityArguments(runs=500), "anna")
    until(store, long.id, lambda found: found.share)
    for process in multiprocessing.active_children():
        if process.pid and os.getpgid(process.pid) == process.pid:
            os.kill(process.pid, signal.SIGKILL)
    killed = until(store, long.id, lambda found: found.finished)
    assert (killed.state, killed.fault) == ("failed", "killed")
    assert "ended from outside" in killed.reason
    (tmp_path / "results").write_text("a file, where there should be a folder")
    barred = jobs.submit("export", ExportArguments(dataset=1, format="csv"), "anna")
    refused = until(store, barred.id, lambda found: found.finished)
    assert (refused.state, refused.fault) == ("failed", "store-full"), refused.reason


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
        waiting = add_job(store, "export", arguments, "anna", job_rows.runner())
        with pytest.raises(Conflict, match="wait for its end"):
            jobs.again(waiting.id, "berta")
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
def test_what_cannot_be_done_is_refused_before_it_waits(place: Place, arguments: Asked, fault: type[Exception]) -> None:
    with pytest.raises(fault):
        check(place[0], arguments)


def test_old_jobs_go_with_their_files_and_nothing_else_does(place: Place, tmp_path: Path) -> None:
    store, path = place
    output = tmp_path / "results"
    numbers = [add_job(store, "export", "{}", "anna", "another machine:1:ab").id for _ in range(6)]
    for number in numbers:
        begin(store, number)
        (output / "jobs" / str(number)).mkdir(parents=True)
        (output / "jobs" / str(number) / "sample.csv").write_text("1")
    (output / "long").mkdir()
    for number in numbers[1:]:  # the first one runs, whatever its age
        finish(store, number, "done", result="{}")
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE jobs SET created = '2020-01-01', finished = '2020-01-01' WHERE id < 6")
    connection.close()
    young = numbers[-1]
    assert prune(store, output, Retention(newest=2, days=30)) == numbers[1:4]
    assert [each.id for each in job_rows.all_jobs(store, 10)] == [young, numbers[4], numbers[0]]
    assert sorted(each.name for each in (output / "jobs").iterdir()) == ["1", "5", "6"]
    assert (output / "long").is_dir()
    assert prune(store, output, Retention(newest=0, days=30)) == [numbers[4]]
    assert prune(store, output, Retention(newest=0, days=30)) == []
    assert add_job(store, "export", "{}", "anna", "another machine:1:ab").id == young + 1, "no number comes again"


def test_a_service_deletes_what_is_old_by_itself_and_the_log_says_so(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, path = place
    monkeypatch.setattr("api.jobs.running.PRUNE_EVERY", 1.0)
    jobs = Jobs(store, path, tmp_path / "results", Events(), kept=Retention(newest=0, days=0))
    try:
        done = jobs.submit("export", ExportArguments(dataset=1, format="csv"), "anna")
        end = time.monotonic() + 120
        while job_rows.all_jobs(store, 10):
            assert time.monotonic() < end
            time.sleep(0.1)
    finally:
        jobs.close()
    assert not (tmp_path / "results" / "jobs" / str(done.id)).exists()
    assert "delete old jobs" in [row.action for row in audit.entries(store, limit=10)]


def test_a_job_ends_with_its_result_although_the_database_was_locked_when_it_did(
    place: Place, jobs: Jobs, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, _ = place
    refusals = iter(range(2))
    finished = job_rows.finish

    def locked(*how: Any) -> bool:
        if next(refusals, None) is not None:
            raise StoreError("The database is locked")
        return finished(*how)

    monkeypatch.setattr("api.jobs.running.AGAIN", 0.05)
    monkeypatch.setattr(job_rows, "finish", locked)
    written = jobs.submit("export", ExportArguments(dataset=1, format="csv"), "anna")
    assert until(store, written.id, lambda found: found.finished).state == "done"
    assert next(refusals, None) is None
