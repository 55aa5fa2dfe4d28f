"""Fits are made while the bench goes on, and whatever becomes of them is the end of their campaign, with its reason."""

import asyncio
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.access.accounts import add_user
from api.access.tokens import create_token
from api.bench import queue
from api.bench.messages import Told
from api.bench.operated import OperatedBench
from api.bench.runner import Runner, Task
from api.commands.main import app
from api.results import fitting
from api.results.fitting import Fits
from api.web.live import open_live
from api.web.queue_view import entry_view
from goniometer.campaigns.campaign import Campaign
from goniometer.scans import scheduler
from goniometer.storage.store import Store
from tests.api.service_client import Client
from tests.served import TINY


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "bench.db")


def next_entry(store: Store, name: str) -> queue.Entry:
    """A small campaign whose turn it is."""
    added = queue.add_entry(store, Campaign.model_validate(TINY | {"name": name}), "anna")
    queue.start_entry(store, added.id)
    entry = queue.next_entry(store)
    assert entry is not None
    return entry


async def fits_end(runner: Runner) -> None:
    """Return when no fits are made any more."""
    if runner.fitting:
        await asyncio.wait(runner.fitting.values())


def runner_on(store: Store, tmp_path: Path, told: list[Told]) -> tuple[Runner, OperatedBench]:
    bench = OperatedBench(None, lambda: None)
    task = Task(tmp_path / "bench.db", tmp_path / "results", None, "http://localhost", True, bench="simulated")
    return Runner(store, bench, task, told.append, lambda: None), bench


def test_a_fault_of_the_program_in_a_calibration_or_a_fit_ends_the_entry_with_its_reason_and_not_the_bench(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def go() -> None:
        runner, bench = runner_on(store, tmp_path, [])
        with store.exclusive():
            entry = next_entry(store, "Tiny")
            for name in ("make_dataset", "derive"):
                with monkeypatch.context() as broken:
                    broken.setattr(fitting, name, operator.truediv)  # a TypeError wherever it is called
                    await runner.run(entry)
                    await fits_end(runner)
                assert bench.phase == "ready"
                ended = queue.entry(store, entry.id)
                assert (ended.phase, ended.outcome) == ("finished", "failed")
                assert "Sample 1" in ended.reason
                assert "TypeError" in ended.reason
                queue.start_entry(store, entry.id)
                again = queue.next_entry(store)
                assert again is not None
                entry = again
            await runner.run(entry)
            await fits_end(runner)
            ended = queue.entry(store, entry.id)
            assert (ended.outcome, ended.reason) == ("completed", "")
            assert any(fit.kind == "analysis" for fit in store.fits(1))
            await bench.park()

    asyncio.run(go())


def test_a_fault_of_the_program_in_a_scan_ends_its_entry_with_its_reason_and_the_next_one_is_measured(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def go() -> None:
        runner, bench = runner_on(store, tmp_path, [])
        with store.exclusive():
            entry = next_entry(store, "Tiny")
            with monkeypatch.context() as broken:
                broken.setattr(scheduler, "take", operator.truediv)
                await runner.run(entry)
            (scan, *_) = store.scans()
            for outcome, reason in (
                (queue.entry(store, entry.id).outcome, queue.entry(store, entry.id).reason),
                (scan.outcome, scan.reason),
            ):
                assert outcome == "failed"
                assert "fault of the program (TypeError" in reason
            assert bench.phase == "ready"
            second = next_entry(store, "Second")
            await runner.run(second)
            await fits_end(runner)
            assert queue.entry(store, second.id).outcome == "completed"
            await bench.park()

    asyncio.run(go())


def test_the_next_campaign_is_measured_while_the_fits_of_the_one_before_are_made(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def go() -> None:
        runner, bench = runner_on(store, tmp_path, [])
        goes_on = asyncio.Event()
        kept = Fits.kept

        async def late(fits: Fits, note: Callable[[str], None]) -> None:
            await goes_on.wait()
            await kept(fits, note)

        monkeypatch.setattr(Fits, "kept", late)
        with store.exclusive():
            first = next_entry(store, "First")
            await runner.run(first)
            seen = queue.entry(store, first.id)
            with open_live(tmp_path / "bench.db", tmp_path / "results") as live:
                assert entry_view(live, seen, live.worker.state).phase == "fitting"
            second = next_entry(store, "Second")
            await runner.run(second)
            assert sum(scan.outcome == "completed" for scan in store.scans()) == 4
            assert [queue.entry(store, each.id).outcome for each in (first, second)] == [None, None]
            goes_on.set()
            await fits_end(runner)
            assert [queue.entry(store, each.id).outcome for each in (first, second)] == ["completed", "completed"]
            await bench.park()

    asyncio.run(go())


def test_fits_that_are_let_go_of_or_aborted_leave_the_dataset_and_the_entry_to_be_started_again(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = tmp_path / "bench.db"

    def abort_over_rest(number: int) -> dict[str, Any]:
        with open_live(database, tmp_path / "results") as live:
            add_user(live.store, "anna", "operator", None)
            client = Client(live)
            client.headers["Authorization"] = f"Bearer {create_token(live.store, 'anna', 'test')[0]}"
            assert client.get(f"/api/queue/{number}").json()["phase"] == "fitting"
            found: dict[str, Any] = client.post(f"/api/queue/{number}/abort").json()
            return found

    async def never(_: Fits, __: Callable[[str], None]) -> None:
        await asyncio.Event().wait()

    async def go() -> None:
        runner, bench = runner_on(store, tmp_path, [])
        with store.exclusive():
            entry = next_entry(store, "Tiny")
            await runner.run(entry)
            await runner.leave()
            assert not runner.fitting
            queue.interrupt(store, "The service has ended.")
            assert queue.entry(store, entry.id).phase == "idle"

            async def again() -> None:
                queue.start_entry(store, entry.id)
                started = queue.next_entry(store)
                assert started is not None
                await runner.run(started)

            with monkeypatch.context() as slow:
                slow.setattr(Fits, "kept", never)
                await again()
                seen = await asyncio.to_thread(abort_over_rest, entry.id)
                assert (seen["phase"], seen["outcome"]) == ("finished", "aborted")
                assert "starting it again makes them" in seen["reason"]
                await fits_end(runner)
                assert bench.phase == "ready"

                await again()
                said = await asyncio.to_thread(CliRunner().invoke, app, ["abort", "--database", str(database)])
                assert said.exit_code == 0, said.output
                await fits_end(runner)
                assert queue.entry(store, entry.id).outcome == "aborted"
            assert store.fits(1) == []
            await bench.park()

    asyncio.run(go())
    assert [len(store.datasets(scan.id)) for scan in store.scans()] == [0, 1]
