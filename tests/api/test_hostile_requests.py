"""Requests made to harm the service: endless, late, nested, misspelt on purpose, or full of quotes and line ends."""

import json
import re
import socket
import time
from collections.abc import Iterator
from dataclasses import replace

import httpx
import pytest

from api.access.accounts import add_user
from api.access.audit import entries
from api.access.tokens import create_token
from api.web import patience
from api.web.live import Live, open_live
from api.written import write_text
from tests.api.service_client import Client
from tests.drawn_dataset import drawn_dataset
from tests.served import Served, served

NAME = "Robert'); DROP TABLE datasets;--"


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    folder = tmp_path_factory.mktemp("hostile")
    with open_live(folder / "bench.db", folder) as opened:
        add_user(opened.store, "root", "admin", None)
        for name in (NAME, "100 %", "a_b"):
            opened.store.add_dataset(None, replace(drawn_dataset("sample-2", seed=5), sample=name))
        yield opened


@pytest.fixture(scope="module")
def client(live: Live) -> Client:
    found = Client(live)
    found.headers["Authorization"] = f"Bearer {create_token(live.store, 'root', 'test')[0]}"
    return found


def check_refused(answer: httpx.Response, *statuses: int) -> None:
    """An answer is a problem of one of these statuses, in one sentence of ordinary length."""
    assert answer.status_code in statuses, (answer.status_code, answer.text[:500])
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.json()["detail"]) < 2000


POSTS = [
    "/api/campaigns/validate",
    "/api/campaigns/preview",
    "/api/queue",
    "/api/login",
    "/api/users",
    "/api/tokens",
    "/api/tradeoff",
    "/api/stability",
    "/api/choose",
    "/api/datasets/import",
    "/api/datasets/1/fits",
    "/api/datasets/1/exports",
    "/api/datasets/1/recalibrate",
]
BODIES = {
    "nested lists": "[" * 200_000,
    "nested objects": '{"a":' * 200_000,
    "a number of a million digits": "1" * 1_000_000,
    "a number beyond all": '{"dataset": 1e400, "runs": 1e400, "rounds": 1e400, "name": 1e400}',
    "no number": '{"dataset": NaN, "tolerance": NaN, "runs": Infinity, "name": NaN}',
    "half a character": '{"name": "\\ud800", "scene": "\\ud800", "upload": "\\ud800", "format": "\\ud800"}',
    "a null character": '{"name": "\\u0000", "scene": "\\u0000", "upload": "\\u0000", "format": "\\u0000"}',
    "no UTF-8": b'{"name": "\xff\xfe"}',
    "a list": "[]",
    "nothing": "",
    "a prototype": '{"__proto__": {"role": "admin"}, "constructor": {}}',
    "laughs": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{n}: &{n} [{','.join([f'*{m}'] * 9)}]\n" for m, n in zip("abcdefgh", "bcdefghi", strict=True)),
}


@pytest.mark.parametrize("path", POSTS)
@pytest.mark.parametrize("body", BODIES)
def test_a_body_that_is_none_is_refused_with_a_sentence_and_soon(client: Client, path: str, body: str) -> None:
    began = time.process_time()
    answer = client.request("POST", path, content=BODIES[body], headers={"Content-Type": "application/json"})
    check_refused(answer, 400, 401, 404, 409, 422)
    assert time.process_time() - began < 20


@pytest.mark.parametrize(
    "query",
    [
        {"sample": "' OR '1'='1"},
        {"sample": "%"},
        {"sample": "_"},
        {"sample": "a%b"},
        {"sample": "x\0y"},
        {"sample": '"; ATTACH DATABASE "/tmp/x" AS x; --'},
        {"sample": "*"},
    ],
)
def test_a_name_that_is_sql_finds_nothing_more_than_its_name(client: Client, query: dict[str, str]) -> None:
    answer = client.get("/api/datasets", params=query)
    assert answer.status_code == 200
    assert answer.json()["items"] == []


def test_a_sample_whose_name_is_sql_is_found_by_it_alone_and_harms_nothing(client: Client) -> None:
    for name in (NAME, "100 %", "a_b"):
        (found,) = client.get("/api/datasets", params={"sample": name}).json()["items"]
        assert found["sample"] == name
    assert len(client.get("/api/datasets").json()["items"]) == 3


@pytest.mark.parametrize(
    "path",
    [
        "/api/datasets?after=1;DROP TABLE datasets",
        "/api/datasets?order=id;--",
        "/api/datasets?kind=' OR 1=1",
        "/api/datasets?flag=' OR 1=1",
        "/api/datasets?since=2026-01-01' OR '1'='1",
        "/api/datasets?limit=1 UNION SELECT 1",
        "/api/datasets/1%27%20OR%201=1",
        "/api/datasets/99999999999999999999",
        "/api/jobs?kind=" + 50 * "x",
        "/api/jobs?state=' OR 1=1",
        "/api/certificates/' OR 1=1",
        "/api/samples/..%2f..%2fetc",
        "/api/exports/..%2f..%2fetc/file",
        "/api/nothing",
        "/assets/..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd.txt",
        "/assets/%00",
        "/assets/" + 5000 * "x",
        "//etc/passwd.txt",
        "/..\\..\\windows\\win.ini",
    ],
)
def test_an_address_that_means_something_else_leads_nowhere(client: Client, path: str) -> None:
    answer = client.get(path)
    check_refused(answer, 400, 404, 422)
    assert "root:" not in answer.text


@pytest.mark.parametrize(
    "name",
    [
        "../x.csv",
        "..",
        "/etc/passwd",
        "a/b.csv",
        "a\\b.csv",
        ".hidden",
        "a\r\nSet-Cookie: x=y",
        'a"; filename="b.exe',
        "a\0.csv",
        "CON:x",
        "~root",
        "$(id)",
        "漢" * 100,
        "-rf" + "\x1b[2J",
    ],
)
def test_an_upload_is_called_like_a_file_and_like_nothing_else(client: Client, live: Live, name: str) -> None:
    check_refused(client.request("POST", "/api/uploads", params={"name": name}, content=b"1"), 422)
    assert not any((live.output / "uploads").glob("*/*"))


@pytest.mark.parametrize(
    "name", ['we"ird; filename=x.exe', "é ü 漢字", "a\r\nSet-Cookie: a=b", "a'b%22c", "<script>alert(1)<", "-" * 200]
)
def test_the_name_of_a_file_is_no_other_header(client: Client, live: Live, name: str) -> None:
    written = write_text("csv", live.output / f"{name}.csv", "1")
    number = live.store.add_export(1, written.path, written.file_format, written.sha256)
    answer = client.get(f"/api/exports/{client.get('/api/datasets/1/exports').json()[-1]['id']}/file")
    assert number is None or answer.status_code == 200
    told = answer.headers["content-disposition"]
    assert told.startswith("attachment; filename")
    assert told.isascii()
    assert told.isprintable()
    assert re.fullmatch(r"attachment; filename(=\"[^\"\\]+\"|\*=utf-8''[\w.%~'()*!-]+)", told)
    assert "set-cookie" not in answer.headers
    assert answer.headers["content-type"] == "application/octet-stream"
    assert "sandbox" in answer.headers["content-security-policy"]


@pytest.mark.parametrize(
    "path", ["/", "/queue", "/api/me", "/api/datasets", "/api/nothing", "/assets/x.js", "/health", "/api/openapi.json"]
)
@pytest.mark.parametrize("known", [True, False])
def test_every_answer_keeps_browsers_careful(client: Client, live: Live, path: str, known: bool) -> None:
    answer = (client if known else Client(live)).get(path)
    policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["cross-origin-opener-policy"] == "same-origin"
    assert "cache-control" in answer.headers
    assert "server" not in answer.headers
    assert "access-control-allow-origin" not in answer.headers


def test_a_token_opens_nothing_in_an_address_and_is_in_no_log(live: Live, client: Client) -> None:
    token = create_token(live.store, "root", "lost")[0]
    for name in ("token", "access_token", "api_key"):
        check_refused(Client(live).get("/api/me", params={name: token}), 401)
    check_refused(Client(live).get("/api/me", headers={"Cookie": f"goniometer={token}"}), 401)
    for path in ("/api/datasets/1/fits", "/api/nothing"):
        answer = client.request("POST", path, params={"token": token, "x": "y"}, json={"model": token})
        assert token not in answer.headers.get("location", "")
    told = "".join(entry.about + entry.action for entry in entries(live.store, limit=50))
    assert "a token" in told
    assert token not in told
    assert '"x": "y"' in told.replace('":"', '": "')


def test_a_campaign_names_no_device_of_the_machine(client: Client) -> None:
    for sample in (
        {"name": "a", "material": "file:/dev/zero"},
        {"name": "a", "material": "file:../bench.db"},
        {"name": "a", "material": "file:/proc/self/environ"},
    ):
        check_refused(client.post("/api/campaigns/validate", {"name": "x", "samples": [sample]}), 422)
    for more in (
        {"reference": {"certificate": "/etc/passwd"}},
        {"reference": {"certificate": "/dev/zero"}},
        {"resolution": {"scene": "/dev/zero"}},
        {"resolution": {"scene": "../../etc/passwd"}},
    ):
        asked = {"name": "x", "samples": [{"name": "a", "material": "sample-1"}], **more}
        answer = client.post("/api/campaigns/validate", asked)
        check_refused(answer, 422)
        assert "root:" not in answer.text


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("served")) as running:
        yield running


def spoken(service: Served, *parts: bytes, pause: float = 0.0, longest: float = 30.0) -> tuple[bytes, float]:
    """What comes back for octets that are sent one part after another until the service ends it, and after how long."""
    address = service.url.removeprefix("http://").split(":")
    began = time.monotonic()
    answer = b""
    with socket.create_connection((address[0], int(address[1])), timeout=longest) as connection:
        try:
            for part in parts:
                connection.sendall(part)
                time.sleep(pause)
            while data := connection.recv(1 << 16):
                answer += data
        except (ConnectionError, BrokenPipeError):
            pass
    return answer, time.monotonic() - began


def as_root(service: Served, line: bytes, *headers: bytes) -> bytes:
    """The head of a request of who may everything."""
    host = service.url.removeprefix("http://").encode()
    token = service.client.headers["Authorization"].encode()
    return b"\r\n".join([line, b"Host: " + host, b"Authorization: " + token, *headers, b"", b""])


def test_who_says_nothing_or_a_byte_at_a_time_is_not_waited_for(
    service: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "HEAD_TIME", 0.5)
    assert spoken(service)[0] == b""
    answer, seconds = spoken(service, *(bytes([c]) for c in b"GET / HTTP/1.1\r\nX: " + 200 * b"x"), pause=0.05)
    assert answer == b""
    assert seconds < 20
    monkeypatch.setattr(patience, "HEAD_TIME", 3.0)  # the second request of a connection, too
    answer, _ = spoken(service, as_root(service, b"GET /health HTTP/1.1"), b"GET / HT")
    assert answer.startswith(b"HTTP/1.1 200")


def test_a_head_without_end_is_not_kept(service: Served) -> None:
    for endless in (b"x", b"X: y\r\n", b"X: " + 100 * b"y" + b"\r\n"):
        answer, _ = spoken(service, b"GET / HTTP/1.1\r\n", *[endless * (100_000 // len(endless))] * 5)
        assert answer in {b""} or answer.startswith(b"HTTP/1.1 400")
    assert service.client.get("/health").status_code == 200


def test_a_body_that_does_not_come_is_not_waited_for(service: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "BODY_TIME", 0.5)
    length = b"Content-Length: 100"
    for path in (b"/api/campaigns/validate", b"/api/uploads?name=a.csv", b"/api/login", b"/api/queue"):
        head = as_root(service, b"POST " + path + b" HTTP/1.1", length, b"Content-Type: application/json")
        answer, seconds = spoken(service, head, b"{")
        status, _, body = answer.partition(b"\r\n\r\n")
        assert status.startswith(b"HTTP/1.1 408"), (path, status)
        assert json.loads(body)["type"] == "urn:goniometer:request-timeout"
        assert seconds < 20
    assert not any((service.live.output / "uploads").glob("*/*"))


def test_who_is_refused_does_not_keep_the_connection_by_sending_on(
    service: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "BODY_TIME", 0.5)
    host = service.url.removeprefix("http://").encode()
    head = b"POST /api/queue HTTP/1.1\r\nHost: " + host + b"\r\nContent-Length: 1000000\r\n\r\n"
    answer, seconds = spoken(service, head, *[b"x"] * 100, pause=0.05)
    assert seconds < 20
    assert answer == b"" or answer.startswith(b"HTTP/1.1 401")


@pytest.mark.parametrize(
    "request_",
    [
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\nConnection: close\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET http://example.org/ HTTP/1.1\r\nHost: example.org\r\nConnection: close\r\n\r\n",
        b"POST /api/login HTTP/1.1\r\nHost: %s\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"POST /api/login HTTP/1.1\r\nHost: %s\r\nContent-Length: -5\r\n\r\n",
        b"POST /api/login HTTP/1.1\r\nHost: %s\r\nTransfer-Encoding: chunked\r\n\r\nfffffffffffffffff\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: %s\r\nCookie: goniometer=\xff\xfe\r\nConnection: close\r\n\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: %s\r\nAuthorization: Bearer \xff\xfe\r\nConnection: close\r\n\r\n",
        b"GET /api/events HTTP/1.1\r\nHost: %s\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
        b"GET /assets/../../../../etc/passwd HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n",
        b"GET /assets/..%2f..%2f..%2fetc%2fpasswd HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n",
        b"CONNECT 127.0.0.1:22 HTTP/1.1\r\nHost: %s\r\n\r\n",
        b"TRACE / HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n",
    ],
)
def test_what_is_no_request_of_ours_is_refused(service: Served, request_: bytes) -> None:
    host = service.url.removeprefix("http://").encode()
    answer, _ = spoken(service, request_.replace(b"%s", host))
    assert re.match(rb"HTTP/1.1 (400|401|403|404|405|421|422) ", answer) or answer == b""
    assert service.client.get("/health").status_code == 200


def test_a_chunk_after_the_body_is_no_header(service: Served) -> None:
    """A trailer may not become what an endpoint takes for who asks."""
    host = service.url.removeprefix("http://").encode()
    token = service.client.headers["Authorization"].encode()
    head = (
        b"POST /api/campaigns/validate HTTP/1.1\r\nHost: "
        + host
        + b"\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    answer, _ = spoken(service, head + b"0\r\nAuthorization: " + token + b"\r\nConnection: close\r\n\r\n", longest=10)
    assert answer.startswith(b"HTTP/1.1 401")
