"""The service on the simulated bench, over HTTP: what operators rely on at night."""

import asyncio
import json
import os
import signal
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from httpx_sse import connect_sse

from api.service import open_bench
from goniometer.campaigns.campaign import Campaign
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.materials.materials import PANEL_CERTIFICATE
from tests.api.conftest import COMMAND
from tests.served import LONG, TINY, Served, served, wait_for


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service on which samples lie without anybody being asked."""
    with served(tmp_path_factory.mktemp("service"), mounts_by_itself=True) as service:
        wait_for(lambda: service.state()["driver"])
        yield service


@pytest.fixture
def running(service: Served) -> Iterator[int]:
    """The entry of a campaign that is being measured; it is gone afterwards."""
    number = service.ordered(LONG)
    wait_for(lambda: service.entry(number)["points_done"] > 3)
    yield number
    if service.entry(number)["phase"] not in {"finished", "idle"}:
        asked(service, number, "abort")
    wait_for(lambda: service.entry(number)["phase"] in {"finished", "idle"})
    service.client.delete(f"/api/queue/{number}")


def asked(service: Served, number: int, command: str) -> dict[str, Any]:
    """The entry once it is asked to pause, go on or abort: between two scans of a campaign nothing can be asked."""
    answer = wait_for(lambda: (now := service.client.post(f"/api/queue/{number}/{command}")).is_success and now)
    entry: dict[str, Any] = answer.json()
    return entry


def exposures(file: Path) -> list[tuple[Any, ...]]:
    """All raw spectra of points, with where they were taken."""
    with closing(sqlite3.connect(file)) as database, database:
        return database.execute(
            "SELECT points.scan_id, number, integration_time, counts "
            "FROM exposures JOIN points ON points.id = point_id "
            "ORDER BY points.scan_id, number, exposures.id"
        ).fetchall()


FINE = TINY | {"resolution": {"mode": "uniform", "step": 1}}
"""One whose sample takes seconds."""


def uninterrupted(file: Path) -> None:
    """Measure the fine campaign without a service, from end to end."""
    campaign = Campaign.model_validate(FINE)
    store = Store.open(file)

    async def measure() -> None:
        async with open_bench(None, campaign.seed, pytest.fail) as (instrument, mount):
            certificate = certificate_csv(PANEL_CERTIFICATE)
            with store.exclusive():
                await run_campaign(store, campaign, instrument, mount, lambda _: None, lambda _: None, certificate)

    asyncio.run(measure())
    store.close()


def newest_is_of_the_dataset(service: Served, file: Path, scan: dict[str, Any]) -> None:
    """The newest point of a scan that is complete has the BRDF that its dataset has there, and the uncertainty."""
    newest = service.client.get(f"/api/scans/{scan['id']}/brdf").json()
    store = Store.open(file)
    data = store.dataset(scan["datasets"][0])
    store.close()
    here = np.isclose(data.theta_in, newest["theta_in_deg"]) & np.isclose(data.theta_out, newest["theta_out_deg"])
    assert here.sum() == 1
    np.testing.assert_allclose(newest["wavelengths_nm"], data.wavelengths, atol=0.02)  # weighted by fewer panel points
    brdf, u = (np.array(newest[name], float) for name in ("brdf", "u"))
    assert np.all(np.abs(brdf - data.brdf[here][0]) < 0.05 * data.u[here][0])
    np.testing.assert_allclose(u, data.u[here][0], rtol=0.05)


def test_a_campaign_ends_in_a_dataset_with_every_count_as_it_should_be_although_the_bench_process_was_killed(
    tmp_path: Path,
) -> None:
    with served(tmp_path) as service:
        number = service.ordered(FINE)
        mounted = []
        killed = False
        while (entry := service.entry(number))["phase"] != "finished":
            if entry["prompt"]:
                mounted.append(entry["prompt"]["request"])
                service.client.post(f"/api/queue/{number}/mounted", json={"scan": entry["prompt"]["scan"]})
            if not killed and entry["points_done"] > 12:
                killed = True
                os.kill(service.state()["driver"]["process"], signal.SIGKILL)
                wait_for(lambda: service.entry(number)["phase"] == "idle")
                assert "start it again to go on where it stood" in service.entry(number)["reason"]
                assert service.client.post(f"/api/queue/{number}/start").status_code == 200
            time.sleep(0.2)
        assert entry["outcome"] == "completed", entry["reason"]
        assert mounted == ["Mount the reference panel (Spectralon)", "Mount Sample 1", "Mount Sample 1"]
        scans = service.client.get("/api/scans").json()["items"]
        assert [len(scan["datasets"]) for scan in scans] == [0, 1]
        newest_is_of_the_dataset(service, tmp_path / "goniometer.db", scans[1])
        refused = service.client.get(f"/api/scans/{scans[0]['id']}/brdf")
        assert "whose BRDF the certificate tells" in refused.json()["detail"]
        assert (tmp_path / "results" / "tiny" / "sample-1" / "report.html").exists()
    uninterrupted(tmp_path / "other.db")
    assert exposures(tmp_path / "goniometer.db") == exposures(tmp_path / "other.db")


@pytest.mark.slow
def test_an_entry_of_a_campaign_that_was_complete_before_leads_to_its_scans_all_the_same(service: Served) -> None:

    def ended() -> dict[str, Any]:
        number = service.ordered(TINY, name="Twice")
        wait_for(lambda: service.entry(number)["phase"] == "finished")
        return service.entry(number)

    first, second = ended(), ended()
    assert second["outcome"] == "completed", second["reason"]
    assert second["campaign_id"] == first["campaign_id"] is not None
    assert second["scans"] == first["scans"] != []


def test_a_pause_takes_effect_after_the_point_and_an_abort_keeps_what_is_measured(
    service: Served, running: int
) -> None:
    assert asked(service, running, "pause")["phase"] in {"pausing", "paused"}
    paused = wait_for(lambda: (now := service.entry(running))["phase"] == "paused" and now)
    wait_for(lambda: service.state()["shutter"] == "closed")
    time.sleep(0.3)
    assert service.entry(running)["points_done"] == paused["points_done"]
    service.client.post(f"/api/queue/{running}/resume")
    wait_for(lambda: service.entry(running)["points_done"] > paused["points_done"])
    asked(service, running, "abort")
    ended = wait_for(lambda: (now := service.entry(running))["phase"] == "finished" and now)
    assert ended["outcome"] == "aborted"
    assert ended["points_done"] > paused["points_done"]
    assert service.client.post(f"/api/queue/{running}/start").json()["phase"] in {"queued", "running"}
    wait_for(lambda: service.entry(running)["points_done"] > ended["points_done"])


def test_stop_ends_a_campaign_at_once_and_nothing_begins_before_somebody_has_looked(
    service: Served, running: int
) -> None:
    next_one = service.ordered(TINY)
    assert service.entry(next_one)["phase"] == "queued"
    state = service.client.post("/api/instrument/stop").json()
    assert state["phase"] == "ready"
    assert state["shutter"] == "closed"
    assert not any(stage["moving"] for stage in state["stages"])
    assert wait_for(lambda: service.entry(running)["outcome"]) == "aborted"
    held = service.entry(next_one)
    assert held["phase"] == "idle"
    assert "look at it" in held["reason"]
    assert service.client.delete(f"/api/queue/{next_one}").status_code == 204


def test_what_is_not_possible_now_is_refused_with_the_reason_and_what_is(service: Served, running: int) -> None:
    jog = {"json": {"sample": 10}}
    for command, options in (("home", {}), ("jog", jog), ("disconnect", {}), ("doctor", {"json": {}})):
        reason = service.refused(f"/api/instrument/{command}", **options)
        assert "a campaign owns it; abort that, or stop it" in reason
    assert service.state()["possible"] == ["stop"]
    assert "is running" in service.refused(f"/api/queue/{running}/start")
    assert "does not wait for a sample" in service.refused(f"/api/queue/{running}/mounted")
    assert service.client.delete(f"/api/queue/{running}").status_code == 409
    assert "is in the queue" in service.refused("/api/queue", json={"campaign": LONG})
    asked(service, running, "abort")
    wait_for(lambda: service.entry(running)["phase"] == "finished")
    assert "so it cannot pause; start it first" in service.refused(f"/api/queue/{running}/pause")
    service.client.post("/api/instrument/disconnect")
    assert "connect it first" in service.refused("/api/instrument/jog", **jog)
    assert service.client.post("/api/instrument/stop").status_code == 200, "a stop is always obeyed"
    assert service.client.post("/api/instrument/disconnect").status_code == 200, "it is done already"


def test_a_material_that_there_is_not_keeps_a_campaign_out_of_the_queue(service: Served) -> None:
    before = service.client.get("/api/queue").json()
    for material, told in (("sample-9", "two-component-1"), ("file:nowhere.npz", "nowhere.npz")):
        campaign = LONG | {"name": "Night", "samples": [{"name": "A", "material": material}]}
        answer = service.client.post("/api/queue", json={"campaign": campaign})
        assert answer.status_code == 422, answer.text
        assert told in answer.json()["detail"]
    assert service.client.get("/api/queue").json() == before


def test_an_operator_sees_where_the_arm_went_and_what_it_saw(service: Served) -> None:
    assert service.client.post("/api/instrument/connect").json()["phase"] == "ready"
    state = service.client.post("/api/instrument/jog", json={"theta_in": 30, "theta_out": -10}).json()
    assert (state["theta_in"], state["theta_out"]) == (pytest.approx(30, abs=0.1), pytest.approx(-10, abs=0.1))
    assert [stage["angle"] for stage in state["stages"]] == [pytest.approx(30, abs=0.1), pytest.approx(20, abs=0.1)]
    outside = service.client.post("/api/instrument/jog", json={"sample": 120})
    assert outside.status_code == 422
    assert "outside 0 to 90 deg" in outside.json()["detail"]
    assert service.client.post("/api/instrument/expose", json={"integration_time": 0.1}).json()["shutter"] == "open"
    seen = service.client.get("/api/instrument/spectrum").json()
    octets = service.client.get("/api/instrument/spectrum", headers={"Accept": "application/octet-stream"}).content
    assert len(octets) == 8 * (len(seen["wavelengths"]) + len(seen["counts"])) == 16 * 1044
    assert seen["integration_time"] == 0.1
    assert service.client.post("/api/instrument/home").json()["theta_in"] == 0


def test_a_stop_reaches_a_bench_that_another_service_drives_and_the_other_takes_over_when_it_ends(
    tmp_path: Path, database: Path | str
) -> None:
    with served(tmp_path, database, mounts_by_itself=True) as first:
        wait_for(lambda: first.state()["driver"])
        with served(tmp_path, database, mounts_by_itself=True) as second:
            there = wait_for(lambda: second.state()["driver"])
            assert not there["here"]
            assert first.url in second.refused("/api/instrument/connect")
            number = second.ordered(LONG)  # the queue is everybody's
            wait_for(lambda: first.entry(number)["points_done"] > 3)
            assert second.entry(number)["phase"] == "running"
            assert second.client.post("/api/instrument/stop").status_code == 200
            wait_for(lambda: second.entry(number)["phase"] == "finished")
            wait_for(lambda: first.state()["shutter"] == "closed")
            first.live.worker.close()
            wait_for(lambda: (second.state()["driver"] or {}).get("here"))


def events(service: Served, enough: int, after: str | None = None) -> list[Any]:
    """The first events of a stream."""
    headers = {"Last-Event-ID": after} if after else {}
    with connect_sse(service.client, "GET", "/api/events", headers=headers) as source:
        stream = source.iter_sse()
        return [next(stream) for _ in range(enough)]


def test_a_listener_who_comes_back_misses_nothing(service: Served, running: int) -> None:
    before = events(service, 5)
    wait_for(lambda: service.live.events.count > int(before[-1].id.partition("-")[2]) + 20)
    after = events(service, 5, before[0].id)
    assert [event.data for event in after[:4]] == [event.data for event in before[1:]]
    assert {event.event for event in before + after} & {"point", "progress", "state"}


def test_a_listener_who_missed_too_much_is_told_to_read_everything_anew(service: Served, running: int) -> None:
    for lost in ("nonsense", "00000000-5", "x" * 5000):
        assert events(service, 1, lost)[0].event == "reset"


@pytest.mark.slow
def test_a_service_that_is_told_to_end_parks_the_bench_and_the_next_one_goes_on_where_it_stood(folder: Path) -> None:
    with command(folder) as (process, client):
        number = client.post("/api/queue", json={"campaign": LONG}).json()["id"]
        client.post(f"/api/queue/{number}/start").raise_for_status()
        wait_for(lambda: client.get(f"/api/queue/{number}").json()["points_done"] > 5)
        listening = threading.Thread(target=listen_to_the_end, args=(client,))
        listening.start()  # nor does a page that is open somewhere keep it from ending
        process.send_signal(signal.SIGTERM)
        output, log = process.communicate(timeout=60)
        assert process.returncode == 0, log
        listening.join()
    assert [json.loads(line)["level"] for line in log.splitlines()], "a log is one object a line"
    assert client.headers["Authorization"].removeprefix("Bearer ") not in output + log
    with closing(sqlite3.connect(folder / "goniometer.db")) as database, database:
        begun = database.execute("SELECT phase, outcome FROM scans WHERE started IS NOT NULL ORDER BY id").fetchall()
        assert begun == [("finished", "completed")] * (len(begun) - 1) + [("finished", "aborted")]
        assert database.execute("SELECT count(*) FROM points WHERE status = 'running'").fetchone() == (0,)
        assert database.execute("SELECT holder FROM lease").fetchone() == (None,)
    with command(folder, client.headers["Authorization"]) as (_, client):
        entry = client.get(f"/api/queue/{number}").json()
        assert entry["phase"] == "idle"
        assert "start it again" in entry["reason"]
        client.post(f"/api/queue/{number}/start").raise_for_status()
        wait_for(lambda: client.get(f"/api/queue/{number}").json()["points_done"] > entry["points_done"])


@contextmanager
def command(folder: Path, authorization: str | None = None) -> Iterator[tuple[subprocess.Popen[str], httpx.Client]]:
    """`goniometer serve` as a process of its own, and a client with the token that it prints when it starts first."""
    arguments = [COMMAND, "serve", "--port", "0", "--mount-by-itself"]
    process = subprocess.Popen(arguments, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        if authorization is None:
            authorization = f"Bearer {process.stdout.readline().split('#token=')[1].strip()}"
        url = next(line for line in process.stderr if "Serves" in line)
        url = json.loads(url)["message"].split()[1]
        with httpx.Client(
            base_url=url, headers={"Authorization": authorization}, timeout=60, trust_env=False
        ) as client:
            wait_for(lambda: client.get("/api/instrument").json()["driver"])
            yield process, client
    finally:
        process.kill()
        process.communicate()


def listen_to_the_end(client: httpx.Client) -> None:
    """Follow the events until the service ends them."""
    with connect_sse(client, "GET", "/api/events") as source:
        for _ in source.iter_sse():
            pass
