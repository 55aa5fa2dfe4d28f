"""Work that takes longer than an answer may, asked for over REST: it ends with what the same call in Python finds."""

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from analysis.strict_json import strict_json
from api import calls
from api.access.accounts import add_user
from api.access.tokens import create_token
from api.bodies.jobs import DoctorArguments
from api.choices import ChartKind
from api.client import Client as PythonClient
from api.jobs import rows
from api.results.choose import choice_content, choose_model
from api.results.products import report_dataset
from api.results.tradeoff import charts
from api.web.live import Live, open_live
from goniometer.storage.database import Database
from goniometer.storage.store import Store
from simulators.stability.ensemble import cells, ensemble, jobs
from tests.api.service_client import Client
from tests.drawn_dataset import drawn_dataset
from tests.served import Served, served, wait_for

SUN = """
camera: {position: [0, -4, 1], pixels: [12, 12], field_of_view: 32}
material: [{sphere: 1}]
lights: [{sun: [1, -1, 1]}]
"""

Service = tuple[Client, Live]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service with one dataset and without a bench."""
    folder = tmp_path_factory.mktemp("long work")
    with open_live(folder / "bench.db", folder / "results") as live:
        live.store.add_dataset(None, drawn_dataset("sample-4"))
        add_user(live.store, "anna", "admin", None)
        client = Client(live)
        client.headers["Authorization"] = f"Bearer {create_token(live.store, 'anna', 'test')[0]}"
        yield client, live


def ended(client: Any, answer: Any) -> dict[str, Any]:
    """The job that an answer tells of, once it is over."""
    assert answer.status_code == 202, answer.text
    number = answer.json()["id"]
    end = time.monotonic() + 300
    while (job := client.get(f"/api/jobs/{number}").json())["state"] in {"waiting", "running"}:
        assert time.monotonic() < end, job
        time.sleep(0.1)
    found: dict[str, Any] = job
    return found


def result(client: Any, answer: Any) -> Any:
    """What came of the job that an answer tells of."""
    job = ended(client, answer)
    assert (job["state"], job["reason"]) == ("done", "")
    return client.get(f"/api/jobs/{job['id']}/result").json()


def test_the_report_is_the_one_that_python_writes(service: Service, tmp_path: Path) -> None:
    client, live = service
    answer = client.post("/api/datasets/1/report", {})
    found = result(client, answer)
    page = client.get(f"/api/jobs/{answer.json()['id']}/page").text
    assert hashlib.sha256(page.encode()).hexdigest() == found["sha256"]
    other = Store.open(tmp_path / "other.db")
    other.add_dataset(None, live.store.dataset(1))
    written = report_dataset(other, 1, tmp_path / found["file"])
    assert page == written.path.read_text(encoding="utf-8")
    other.close()


def test_the_model_that_a_scene_needs_is_the_one_that_python_finds(service: Service, tmp_path: Path) -> None:
    client, live = service
    asked = {"dataset": 1, "scene": SUN, "tolerance": 2.0, "rendering": False}
    found = result(client, client.post("/api/choose", asked))
    scene = tmp_path / "scene.yaml"
    scene.write_text(SUN)
    here = choice_content(choose_model(live.store, 1, scene, 2.0, dielectric=False, rendering=False))
    timed = {"nanoseconds"}
    wanted = {name: value for name, value in json.loads(json.dumps(here["chosen"])).items() if name not in timed}
    assert {name: value for name, value in found["chosen"].items() if name not in timed} == wanted
    assert [(each["model"], each["state"]) for each in found["rungs"]] == [
        (each["model"], each["state"]) for each in here["rungs"]
    ]
    refused = client.post("/api/choose", asked | {"scene": SUN.replace("sphere: 1", "sphere: -1")})
    assert "sphere" in ended(client, refused)["reason"]


def test_the_map_of_stability_is_the_one_that_python_draws(service: Service) -> None:
    client, _ = service
    asked = {"regimes": ["few points"], "methods": ["local"], "runs": 1}
    found = result(client, client.post("/api/stability", asked))
    with ThreadPoolExecutor(1) as executor:
        here = cells(list(ensemble(jobs(["few points"], ["local"], 1), executor)))
    assert found["cells"] == [json.loads(strict_json(asdict(each))) for each in here]
    assert found["silent_failures"] == []


@pytest.mark.slow
def test_a_chart_of_speed_against_accuracy_has_the_errors_that_python_finds(service: Service) -> None:
    client, live = service
    found = result(client, client.post("/api/tradeoff", {"kinds": ["fits"], "dataset": 1, "rounds": 1}))
    here = charts(ChartKind.FITS, live.store.dataset(1), "sample-4", "sample-1", 1, lambda _: None, dielectric=False)
    for told, chart in zip(found["charts"], here, strict=True):
        errors = {(each["family"], each["name"]): each["error"] for each in told["choices"]}
        assert errors == pytest.approx({(each.family, each.name): each.error for each in chart.choices}, rel=1e-6)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service that drives the simulated bench."""
    with served(tmp_path_factory.mktemp("bench"), mounts_by_itself=True) as service:
        wait_for(lambda: service.state()["driver"])
        yield service


def test_the_doctor_is_a_job_that_tells_how_far_it_is_and_can_be_stopped(
    bench: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, told = rows.tell, set()
    may_go_on = threading.Event()
    may_go_on.set()

    def seen(database: Database, job_id: int, share: float | None, words: str) -> None:
        written(database, job_id, share, words)
        told.add(bench.client.get(f"/api/jobs/{job_id}").json()["words"])
        may_go_on.wait(60)

    monkeypatch.setattr(rows, "tell", seen)
    with PythonClient(bench.url, bench.client.headers["Authorization"].removeprefix("Bearer ")) as client:
        number = client(calls.doctor(DoctorArguments(home=True))).id
    job = wait_for(
        lambda: (now := bench.client.get(f"/api/jobs/{number}").json())["state"] not in {"waiting", "running"} and now
    )
    assert told >= {"Opening all devices", "Opened 1 of 3 devices", "Opened 2 of 3 devices", "Examining all devices"}
    assert (job["state"], job["reason"], job["title"]) == ("done", "", "Examine every device")
    found = bench.client.get(f"/api/jobs/{number}/result").json()
    assert found["fit"] is True
    assert [each["device"] for each in found["findings"]] == ["sample stage", "detector stage", "spectrometer", "light"]
    assert bench.state()["phase"] == "disconnected"
    may_go_on.clear()
    again = bench.client.post(f"/api/jobs/{number}/again").json()["id"]
    wait_for(lambda: bench.state()["phase"] == "busy")
    assert bench.client.delete(f"/api/jobs/{again}").json()["state"] == "cancelled"
    may_go_on.set()
    wait_for(lambda: bench.state()["phase"] == "disconnected")
    assert bench.client.post("/api/instrument/connect").json()["phase"] == "ready"
    assert "disconnect it first" in bench.refused("/api/instrument/doctor", json={})
    bench.client.post("/api/instrument/disconnect")


def test_a_job_whose_process_is_killed_is_failed_with_the_reason_and_the_next_one_is_done(service: Service) -> None:
    client, live = service
    job = client.post("/api/stability", {"runs": 500}).json()
    (group,) = wait_for(lambda: [each for each in live.jobs._groups.values() if each])
    wait_for(lambda: client.get(f"/api/jobs/{job['id']}").json()["share"])
    os.kill(group, signal.SIGKILL)
    killed = wait_for(lambda: (now := client.get(f"/api/jobs/{job['id']}").json())["finished"] and now)
    assert killed["state"] == "failed"
    assert "ended from outside" in killed["reason"]
    assert not killed["has_result"]
    exported = client.post("/api/datasets/1/exports", {"format": "csv"})
    assert ended(client, exported)["state"] == "done"
