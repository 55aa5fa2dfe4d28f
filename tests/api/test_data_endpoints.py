"""Datasets, exports, uploads and certificates over REST, without a bench."""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.fits.analyse import analyse
from analysis.fits.fit_json import fit_to_json
from api.access.accounts import add_user
from api.access.tokens import create_token
from api.web.live import Live, open_live
from goniometer.certificates.certificate import Certificate
from goniometer.certificates.certificate_file import certificate_csv
from simulators.materials.materials import PANEL_CERTIFICATE
from tests.api.service_client import Client
from tests.drawn_dataset import drawn_dataset

Service = tuple[Client, Live, Path]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service with three datasets, and a client that may do everything."""
    folder = tmp_path_factory.mktemp("endpoints")
    with open_live(folder / "bench.db", folder / "results") as live:
        for seed in range(3):
            live.store.add_dataset(None, drawn_dataset("sample-4", seed=seed))
        add_user(live.store, "anna", "admin", None)
        client = Client(live)
        client.headers["Authorization"] = f"Bearer {create_token(live.store, 'anna', 'test')[0]}"
        yield client, live, folder


def test_an_answer_need_not_be_sent_twice_until_there_is_another_fit(service: Service) -> None:
    client, live, _ = service
    first = client.get("/api/datasets/1/models")
    tag = {"If-None-Match": first.headers["etag"]}
    again = client.get("/api/datasets/1/models", headers=tag)
    assert (again.status_code, again.content) == (304, b"")
    assert client.get("/api/datasets/2/models", headers=tag).status_code == 200
    data = live.store.dataset(1)
    analysis = analyse(data, models=("cook-torrance",))
    fit = analysis.models[0]
    live.store.add_fit(1, fit.model, fit_to_json(fit, data, analysis.differences[fit.model], analysis.conductor))
    changed = client.get("/api/datasets/1/models", headers=tag)
    assert [model["model"] for model in changed.json()["models"]] == ["cook-torrance"]


def test_pages_of_datasets_follow_one_another_and_filters_say_what_they_know(service: Service) -> None:
    client, _, _ = service
    first = client.get("/api/datasets?limit=2").json()
    assert [row["id"] for row in first["items"]] == [3, 2]
    last = client.get(f"/api/datasets?limit=2&after={first['next']}").json()
    assert ([row["id"] for row in last["items"]], last["next"]) == ([1], None)
    wrong = client.get("/api/datasets?flag=odd")
    assert wrong.status_code == 422
    assert "below-noise" in wrong.json()["detail"]
    assert client.get("/api/datasets?since=yesterday").status_code == 422
    assert client.get("/api/datasets?since=2200-01-01").json()["items"] == []


def test_octets_hold_every_number_of_a_dataset(service: Service) -> None:
    client, live, _ = service
    content = client.get("/api/datasets/1/spectra").content
    points, wavelengths = np.frombuffer(content[:8], "<u4").tolist()
    data = live.store.dataset(1)
    assert data.brdf.shape == (points, wavelengths)
    numbers = np.frombuffer(content[8:], "<f8")
    assert numbers.size == wavelengths + 2 * points + 2 * points * wavelengths
    np.testing.assert_array_equal(numbers[-points * wavelengths :], data.u.ravel())


def test_an_exported_file_is_given_only_as_it_was_written(service: Service) -> None:
    client, live, folder = service
    path = folder / "sample.csv"
    path.write_text("a,b\n")
    number = live.store.add_export(1, path, "csv", hashlib.sha256(b"a,b\n").hexdigest())
    given = client.get(f"/api/exports/{number}/file")
    assert (given.content, given.headers["x-content-type-options"]) == (b"a,b\n", "nosniff")
    assert given.headers["content-disposition"] == 'attachment; filename="sample.csv"'
    path.write_text("secret\n")
    assert client.get(f"/api/exports/{number}/file").status_code == 409
    path.unlink()
    assert client.get(f"/api/exports/{number}/file").status_code == 404
    assert client.get("/api/datasets/1/exports").json()[0]["available"] is False


@pytest.mark.parametrize("name", ["../bench.db", "/etc/passwd", ".hidden", "a\\b", "a\nb", "-o", ""])
def test_no_upload_leaves_its_folder(service: Service, name: str) -> None:
    client, _, folder = service
    before = set(folder.rglob("*"))
    answer = client.request("POST", "/api/uploads", params={"name": name}, content=b"x")
    assert answer.status_code == 422, answer.text
    assert set(folder.rglob("*")) == before


def test_an_upload_that_is_too_large_is_refused_and_leaves_nothing(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, _, folder = service
    sent = client.request("POST", "/api/uploads", params={"name": "large.csv"}, content=b"x" * (5 << 20))
    assert sent.json()["size"] == 5 << 20  # more than other bodies may have
    monkeypatch.setattr("api.web.imports.LARGEST", 1000)
    refused = client.request("POST", "/api/uploads", params={"name": "larger.csv"}, content=b"x" * 1001)
    assert refused.status_code == 413
    assert list(folder.rglob("larger.csv")) == []
    assert client.post("/api/datasets/import", {"upload": "../../bench.db"}).status_code == 404


def test_a_certificate_that_was_handed_in_is_known_by_its_content(service: Service) -> None:
    client, _, _ = service
    assert isinstance(PANEL_CERTIFICATE, Certificate)
    text = certificate_csv(PANEL_CERTIFICATE)
    headers = {"Content-Type": "text/csv"}

    def hand_in(content: str) -> Any:
        return client.request("POST", "/api/certificates?name=panel.csv", content=content.encode(), headers=headers)

    made = hand_in(text).json()
    assert made["sha256"] == hashlib.sha256(text.encode()).hexdigest()
    assert made["reflectance"] == PANEL_CERTIFICATE.reflectance_8h.tolist()
    assert hand_in(text).json() == made
    assert [row["sha256"] for row in client.get("/api/certificates").json()] == [made["sha256"]]
    refused = hand_in("serial,1\n")
    assert refused.status_code == 422
    assert "panel.csv" in refused.json()["detail"]


def test_what_a_file_does_not_say_is_asked_for_by_the_name_of_its_field(service: Service) -> None:
    client, _, _ = service
    table = "theta_in,theta_out," + ",".join(map(str, range(400, 710, 10))) + "\n"
    table += "".join(f"{t},{t},{','.join(['0.3'] * 31)}\n" for t in (10, 20, 30))
    sent = client.request("POST", "/api/uploads", params={"name": "theirs.csv"}, content=table.encode())
    token = sent.json()["upload"]
    job = client.post("/api/datasets/import", {"upload": token, "aperture": 1, "angle_uncertainty": 0.1}).json()
    end = time.monotonic() + 120
    while (job := client.get(f"/api/jobs/{job['id']}").json())["state"] in {"waiting", "running"}:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert job["state"] == "failed"
    assert "state quantity, angles, wavelengths as well" in job["reason"]
    assert "--" not in job["reason"]
    assert job["reason"].startswith("theirs.csv: ")
    refused = client.post("/api/datasets/1/exports", {"format": "csv", "options": {"creators": ["A, B"]}})
    assert refused.status_code == 422, refused.text
    assert "no option creators" in refused.json()["detail"]
    for options, told in (
        ({}, "A package needs terms; state license"),
        ({"license": "CC-BY-4.0"}, "A package needs terms; state license"),
        ({"license": "mine", "creators": ["A, B"]}, '"mine" is no licence'),
        ({"license": "CC-BY-4.0", "creators": [" , "]}, 'A creator has no name; write creators "Family'),
    ):
        refused = client.post("/api/datasets/1/exports", {"format": "package", "options": options})
        assert refused.status_code == 422, refused.text
        assert refused.json()["detail"].startswith(told)


def test_a_metal_or_a_scene_that_cannot_be_is_a_fault_of_what_was_sent(service: Service) -> None:
    client, _, _ = service
    unknown = client.post("/api/datasets/1/fits", {"conductor": "main/Au/Nobody"})
    assert unknown.status_code == 422, unknown.text
    assert "main/Au/Johnson" in unknown.json()["detail"]
