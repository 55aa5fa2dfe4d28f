"""What events tell has the shape that the service documents, and who missed some is told so."""

import ast
import asyncio
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import Any, get_args

import pytest
from httpx_sse import ServerSentEvent, connect_sse
from jsonschema import Draft202012Validator

from api import calls
from api.bench.link import Link
from api.bench.messages import Told
from api.bench.runner import Task
from api.bench.worker import UNHEARD, _Worker
from api.bodies.bench import Alarm, BenchState, Prompt
from api.bodies.events import EntryChanged, EventData, EventKind, PointDone, PromptGone, QueueChanged
from api.bodies.jobs import ExportAsked
from api.client import Client, Event
from api.events import Events
from goniometer.storage.store import Store
from tests.served import TINY, served, wait_for

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Heard:
    """All that a service has told of a campaign, an export, and a bench that ended by itself."""

    lines: list[ServerSentEvent]
    """As they were sent."""
    events: list[Event]
    """The same, as the client reads them."""
    document: dict[str, Any]
    """OpenAPI."""
    measured: int
    """Points in the database."""


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Heard]:
    """From the first event of a service on."""
    with served(tmp_path_factory.mktemp("events")) as service:
        token = service.client.headers["authorization"].removeprefix("Bearer ")
        number = service.ordered(TINY)
        while (entry := service.entry(number))["outcome"] is None:
            if entry["prompt"] is not None:
                service.client.post(f"/api/queue/{number}/mounted")
            wait_for(partial(lambda before: service.entry(number) != before, entry))
        assert entry["outcome"] == "completed", entry["reason"]
        with Client(service.url, token) as client:
            client.wait(client(calls.export(1, ExportAsked(format="json"))))
            os.kill(service.state()["driver"]["process"], signal.SIGKILL)
            wait_for(lambda: service.state()["driver"] is None)
            wait_for(lambda: service.state()["driver"])
            with connect_sse(service.client, "GET", "/api/events", headers={"Last-Event-ID": "unknown"}) as source:
                lines = [next(source.iter_sse())]
            run, _, count = lines[0].id.rpartition("-")
            first = f"{run}-0"
            with connect_sse(service.client, "GET", "/api/events", headers={"Last-Event-ID": first}) as source:
                lines += list(islice(source.iter_sse(), int(count)))
            lost, listening = client.events("unknown"), client.events(first)
            events = [next(lost), *islice(listening, int(count))]
            for stream in (lost, listening):
                stream.close()
        document = service.client.get("/api/openapi.json").json()
        measured = sum(len(service.live.store.points(scan.id)) for scan in service.live.store.scans())
        yield Heard(lines, events, document, measured)


@pytest.mark.slow
def test_every_event_of_a_campaign_has_the_shape_that_the_service_documents(heard: Heard) -> None:
    assert {line.event for line in heard.lines} == set(EventData.model_fields)
    for line in heard.lines:
        where = f"#/components/schemas/EventData/properties/{line.event}"
        schema = {"$ref": where, "components": heard.document["components"]}
        Draft202012Validator(schema).validate(json.loads(line.data))


@pytest.mark.slow
def test_who_listens_is_told_that_the_bench_is_gone_and_that_it_is_back(heard: Heard) -> None:
    driven = [event.data.driver is not None for event in heard.events if isinstance(event.data, BenchState)]
    assert [there for there, _ in groupby(driven)][-3:] == [True, False, True]
    alarms = [
        [alarm.text for alarm in event.data.alarms] for event in heard.events if isinstance(event.data, BenchState)
    ]
    told = "The process that drives the bench has ended (code -9) and is started anew; see the log"
    assert [texts for texts, _ in groupby(alarms)][-2:] == [[], [told]], "it stays until somebody has used the bench"


@pytest.mark.slow
def test_a_script_reads_every_event_as_a_model_that_loses_nothing_of_it(heard: Heard) -> None:
    assert [(event.kind, event.name) for event in heard.events] == [(line.event, line.id) for line in heard.lines]
    for event, line in zip(heard.events, heard.lines, strict=True):
        assert event.data.model_dump(mode="json") == json.loads(line.data), event.kind
    told = [event.data for event in heard.events]
    points = [data for data in told if isinstance(data, PointDone)]
    assert len(points) == heard.measured
    asked = [data for data in told if isinstance(data, Prompt | PromptGone)]
    assert [type(data) for data in asked] == [Prompt, PromptGone] * 2, "the panel and the sample"
    assert {data.entry for data in told if isinstance(data, EntryChanged)} == {asked[0].entry}


@pytest.mark.slow
def test_a_script_hears_on_when_nothing_has_happened_for_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.events.HEARTBEAT", 0.05)
    with served(tmp_path) as service:
        token = service.client.headers["authorization"].removeprefix("Bearer ")
        wait_for(lambda: service.state()["driver"])
        with Client(service.url, token) as client:
            listening = client.events("unknown")
            assert next(listening).kind == "reset"
            later = threading.Timer(1.0, service.live.events.publish, ("queue", EntryChanged(entry=7)))
            later.start()
            told = next(event for event in listening if event.kind == "queue" and event.data != QueueChanged())
            listening.close()
        assert told.data == EntryChanged(entry=7)


def test_nothing_is_told_of_a_kind_that_is_not_documented() -> None:
    told = set()
    for file in (ROOT / "api").rglob("*.py"):
        for call in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(call, ast.Call) and ast.unparse(call.func).rpartition(".")[2] in {"publish", "Told"}:
                told |= {part.value for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant)}
    assert told == set(EventData.model_fields) == set(get_args(EventKind))


def test_a_service_that_could_not_hear_its_bench_lets_everybody_read_anew_what_is_up_to_date(tmp_path: Path) -> None:
    here, there = multiprocessing.Pipe()
    task = Task(tmp_path / "bench.db", tmp_path, None, "http://127.0.0.1:1", mounts_by_itself=True, bench="bench")
    worker, events = _Worker(there, task), Events()
    store = Store.open(task.database)
    link = Link(task, store, events)

    def hear() -> None:
        while not worker.outbox.empty() or here.poll(1.0):
            link._hear(here.recv())

    async def listen() -> list[tuple[EventKind, str]]:
        events.attach(asyncio.get_running_loop())
        stream = events.subscribe()
        await anext(stream)
        worker.tell_state()
        point = PointDone(scan=1, theta_in=30.0, theta_out=-10.0, done=1, failed=0, expected=9)
        while not worker.unheard:  # what waits before the pipe
            worker.say(Told("point", point))
        worker.bench.alarm = Alarm(text="The lamp is out.", since="2026-01-01T00:00:00+00:00")
        await worker._look_once()
        assert worker.outbox.qsize() == UNHEARD, "nothing more waits than before"
        threading.Thread(target=worker._send, daemon=True).start()
        await asyncio.to_thread(hear)
        assert (link.state.alarms, worker.state().alarms) == ((), (worker.bench.alarm,))
        await anext(stream)
        await worker._look_once()
        await asyncio.to_thread(hear)
        told = [(event.kind, event.text) for event in await anext(stream)]
        await worker._look_once()
        assert not here.poll(1.0), "it is told once"
        return told

    told = asyncio.run(listen())
    assert [kind for kind, _ in told] == ["state", "reset"]
    assert BenchState.model_validate_json(told[0][1]) == worker.state() == link.state
    assert told[1][1] == "{}"
    worker.store.close()
    store.close()
    here.close()
