"""The Python client and the example campaign, against a real server on the simulated bench."""

import asyncio
import json
import runpy
import socket
import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import h5py
import httpx
import numpy as np
import pytest

import api.client
from api import calls
from api.bodies.jobs import ExportAsked, HowAsked, ImportAsked, JobView
from api.call import Call
from api.client import AsyncClient, Client, Event, JobFailed, Refused, TimedOut, Unreachable
from api.errors import Conflict, Unauthorised
from goniometer.errors import InputError, NotInStore, StoreError
from tests.served import Served, served

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_campaign.py"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, str, Path]]:
    """A service that has measured the example campaign, a token, and the folder in which the example ran."""
    folder = tmp_path_factory.mktemp("client")
    patch = pytest.MonkeyPatch()
    with served(folder) as service:
        token = service.client.headers["authorization"].removeprefix("Bearer ")
        patch.setenv("GONIOMETER_URL", service.url)
        patch.setenv("GONIOMETER_TOKEN", token)
        patch.chdir(folder)
        runpy.run_path(str(EXAMPLE))
        yield service, token, folder
    patch.undo()


def test_the_example_campaign_measures_fits_draws_and_exports(bench: tuple[Served, str, Path]) -> None:
    service, token, folder = bench
    assert (folder / "distributions.png").stat().st_size > 10_000
    with Client(service.url, token) as client:
        (row,) = client.every(calls.datasets(sample="sample 4"))
        fitted = {model.model for model in client(calls.models(row.id)).models}
        spectra = client(calls.spectra(row.id))
    assert {"global", "cook-torrance", "cook-torrance-shift"} <= fitted
    stored = service.live.store.dataset(row.id)
    for name in ("theta_in", "theta_out", "wavelengths", "brdf", "u"):
        np.testing.assert_array_equal(getattr(spectra, name), getattr(stored, name))
    with h5py.File(folder / "sample-4.h5") as file:  # somebody else's reader

        def same(_: str, item: object) -> bool | None:
            if not isinstance(item, h5py.Dataset) or item.shape != stored.brdf.shape:
                return None
            return True if np.array_equal(item[()], stored.brdf, equal_nan=True) else None

        assert file.visititems(same)


def test_what_the_service_refuses_is_the_exception_of_the_same_work_here(bench: tuple[Served, str, Path]) -> None:
    service, token, _ = bench
    with Client(service.url, token) as client:
        with pytest.raises(NotInStore, match="no dataset 99"):
            client(calls.dataset(99))
        with pytest.raises(InputError, match="There is no model"):
            client(calls.fit(1, HowAsked(model="guess")))
        with pytest.raises(Conflict, match="is over") as refused:
            client(calls.cancel(1))
        cause = refused.value.__cause__
        assert isinstance(cause, Refused)
        assert (cause.problem.status, cause.method, cause.path) == (409, "DELETE", "/api/jobs/1")
        sent = client(calls.upload("none.csv", b"nothing in here\n"))
        with pytest.raises(JobFailed, match="aperture") as failed:
            client.wait(client(calls.import_file(ImportAsked(upload=sent.upload))))
        assert failed.value.job.fault == "option-error"
    with Client(service.url, "gonio_wrong") as stranger, pytest.raises(Unauthorised):
        stranger(calls.about())
    with Client("http://127.0.0.1:9", token) as nobody, pytest.raises(Unreachable, match="goniometer serve"):
        nobody(calls.about())


@pytest.mark.parametrize("kind", [Client, AsyncClient])
@pytest.mark.parametrize(
    "token", [None, "", "gonio_abc\n", "gonio_ä"], ids=["none", "empty", "read with its line", "no ASCII"]
)
def test_what_can_be_no_token_is_refused_before_it_is_sent_and_not_repeated(kind: Any, token: str | None) -> None:
    with pytest.raises(InputError, match="The token is empty, or has") as refused:
        kind("http://127.0.0.1:8000", token)
    assert "gonio_" not in str(refused.value)


@pytest.mark.parametrize("kind", [Client, AsyncClient])
@pytest.mark.parametrize(
    "url", [None, "", "127.0.0.1:8000", "localhost:8000", "ftp://bench", " http://a", "http://a\n"]
)
def test_what_is_no_address_is_not_called_a_service_that_does_not_answer(kind: Any, url: str | None) -> None:
    with pytest.raises(InputError, match=r"is not the address of a service; give e\.g\. http://"):
        kind(url, "gonio_abc")


def test_a_script_that_reads_raw_counts_catches_a_damaged_exposure_as_it_does_here(
    bench: tuple[Served, str, Path],
) -> None:
    service, token, folder = bench
    connection = sqlite3.connect(folder / "goniometer.db", isolation_level=None)
    with closing(connection) as outside, Client(service.url, token) as client:
        before = client(calls.counts(1))
        (counts,) = outside.execute("SELECT counts FROM exposures WHERE id = 1").fetchone()
        outside.execute("DROP TRIGGER exposures_no_update")
        outside.execute("UPDATE exposures SET counts = zeroblob(length(counts)) WHERE id = 1")
        try:
            with pytest.raises(StoreError, match="Exposure 1 is not as it was written") as refused:
                client(calls.counts(1))
        finally:
            outside.execute("UPDATE exposures SET counts = ? WHERE id = 1", (counts,))
        np.testing.assert_array_equal(client(calls.counts(1)), before)
    cause = refused.value.__cause__
    assert isinstance(cause, Refused)
    assert (cause.problem.type, cause.path) == ("urn:goniometer:raw-damaged", "/api/exposures/1")


@pytest.mark.parametrize(
    ("sends", "error", "message"),
    [
        (None, TimedOut, "has not answered POST /api/instrument/home in time"),
        (b"", Unreachable, "broke off POST /api/instrument/home"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{", Unreachable, "broke off POST /api/instrument/home"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}", Unreachable, "answers something else"),
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", Unreachable, "is no service of this kind"),
    ],
)
def test_a_script_learns_which_request_was_lost_and_how(
    sends: bytes | None, error: type[Unreachable], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api.client, "_TIMEOUT", httpx.Timeout(0.5 if sends is None else 60.0))
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                if sends is None:
                    connection.recv(4096)  # until the client gives up
                else:
                    connection.sendall(sends)

        served = pool.submit(serve)
        with Client(f"http://127.0.0.1:{server.getsockname()[1]}", "token") as client, pytest.raises(error) as lost:
            client(calls.order("home"))
        served.result(timeout=10)
    assert type(lost.value) is error
    assert message in str(lost.value)
    assert (lost.value.method, lost.value.path) == ("POST", "/api/instrument/home")


def test_both_clients_give_the_same_answers_and_hear_of_jobs(bench: tuple[Served, str, Path]) -> None:
    service, token, _ = bench

    async def ask() -> tuple[object, list[str], dict[str, object], Event]:
        async with AsyncClient(service.url, token) as client:
            rows = [row.name async for row in client.every(calls.scans())]
            listening = client.events()
            first: asyncio.Future[Event] = asyncio.ensure_future(anext(listening))
            await asyncio.sleep(0.5)
            result = await client.wait(await client(calls.export(1, ExportAsked(format="json"))))
            heard = await first
            while heard.kind != "job":
                heard = await anext(listening)
            await listening.aclose()
            return await client(calls.colour_map(1)), rows, result, heard

    found, rows, result, heard = asyncio.run(ask())
    assert isinstance(heard.data, JobView)
    assert heard.data.kind == "export"
    assert result["format"] == "json"
    with Client(service.url, token) as client:
        assert found == client(calls.colour_map(1))
        assert rows == [row.name for row in client.every(calls.scans())]
        listening = client.events(after="unknown-1")
        assert next(listening).kind == "reset"
        listening.close()


def test_a_list_is_read_to_its_end_page_after_page(bench: tuple[Served, str, Path]) -> None:
    service, token, _ = bench
    with Client(service.url, token) as client:
        scan = service.live.store.scans()[0]
        asked = calls.points(scan.id)
        few = list(client.every(Call("GET", asked.path, asked.read, {"limit": 3})))
        assert [point.number for point in few] == [point.number for point in service.live.store.points(scan.id)]


def test_numbers_of_the_service_are_strict_json(bench: tuple[Served, str, Path]) -> None:
    service, _, _ = bench

    def refuse(name: str) -> float:
        raise AssertionError(name)

    for path in ("map", "slopes", "models", "distributions", "budget", "points/0", "lineage", "checks"):
        answer: httpx.Response = service.client.get(f"/api/datasets/1/{path}")
        assert answer.status_code == 200, answer.text
        json.loads(answer.text, parse_constant=refuse)
