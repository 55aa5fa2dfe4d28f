"""What a browser, a script, and a page of another site get from the service."""

import asyncio
import json
import socket
import sqlite3
from collections.abc import AsyncIterator, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from argon2 import PasswordHasher

from api.access import accounts
from api.access.accounts import add_user
from api.access.audit import entries, verify
from api.access.tokens import create_token, first_token, revoke_token
from api.web import events
from api.web.access import Access, check_listen
from api.web.live import Live, open_live
from goniometer.errors import ConfigurationError
from tests.api.conftest import Cli
from tests.api.service_client import Client

PASSWORD = "correct horse battery staple"
SECURE = Access(loopback=False, secure=True, hosts=frozenset({"bench.example.org"}))


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    with open_live(tmp_path / "bench.db", tmp_path) as opened:
        add_user(opened.store, "root", "admin", None)
        yield opened


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hashes that take no time; tests/api/test_accounts.py looks at the real ones."""
    quickly = partial(PasswordHasher, time_cost=1, memory_cost=8, parallelism=1)
    monkeypatch.setattr(accounts, "PasswordHasher", quickly)


@pytest.fixture
def browser(live: Live) -> Client:
    """Somebody who has logged in as anna, operator."""
    add_user(live.store, "anna", "operator", PASSWORD)
    client = Client(live)
    assert client.login("anna", PASSWORD).status_code == 200
    return client


def bearer(live: Live, name: str = "root") -> dict[str, str]:
    return {"Authorization": f"Bearer {create_token(live.store, name, 'test')[0]}"}


def logged(live: Live) -> list[tuple[str, str, str, dict[str, Any]]]:
    """What the log tells, oldest first."""
    return [(e.who, e.via, e.action, json.loads(e.about)) for e in reversed(entries(live.store, limit=200))]


def problem(response: Any, status: int) -> str:
    """The detail of a problem, which must have this status."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    return str(response.json()["detail"])


@pytest.mark.parametrize(("access", "name"), [(None, "goniometer"), (SECURE, "__Host-goniometer")])
def test_no_page_can_read_the_cookie_and_no_other_site_can_send_it(live: Live, access: Access, name: str) -> None:
    token = create_token(live.store, "root", "page")[0]
    client = Client(live, access) if access else Client(live)
    response = client.post("/api/login", {"token": token})
    key, *attributes = response.headers["set-cookie"].split("; ")
    told = {each.lower() for each in attributes}
    assert key.startswith(f"{name}=")
    assert {"httponly", "samesite=strict", "path=/"} <= told
    assert ("secure" in told) is (access is not None)
    assert not any(each.startswith("domain") for each in told)
    assert response.headers["cache-control"] == "no-store"
    assert response.json()["csrf"] not in response.headers["set-cookie"]
    assert client.get("/api/me").json()["name"] == "root"
    assert token not in response.text


def test_a_session_changes_something_only_with_its_own_csrf_token(live: Live, browser: Client) -> None:
    right = browser.headers.pop("X-CSRF-Token")
    other = Client(live)
    other.login("anna", PASSWORD)
    for wrong in (
        {},
        {"X-CSRF-Token": ""},
        {"X-CSRF-Token": "ä".encode()},
        {"X-CSRF-Token": right[:-1]},
        other.headers,
    ):
        assert "X-CSRF-Token" in problem(browser.post("/api/tokens", {"label": "x"}, headers=wrong), 403)
    assert browser.get("/api/tokens").json()["items"] == []
    assert browser.post("/api/tokens", {"label": "x"}, headers={"X-CSRF-Token": right}).status_code == 201
    assert browser.get("/api/me").json()["csrf"] == right


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:8001", "http://127.0.0.1"])
def test_a_page_of_another_site_can_neither_change_something_nor_log_in(
    live: Live, browser: Client, origin: str
) -> None:
    headers = {"Origin": origin}
    problem(browser.post("/api/tokens", {"label": "x"}, headers=headers), 403)
    problem(browser.post("/api/login", {"name": "anna", "password": PASSWORD}, headers=headers), 403)
    assert browser.post("/api/tokens", {"label": "x"}, headers={"Origin": "http://127.0.0.1:8000"}).status_code == 201


@pytest.mark.parametrize(
    ("host", "access", "answers"),
    [
        ("evil.example", None, False),
        ("evil.example:8000", None, False),
        ("localhost.evil.example", None, False),
        ("127.0.0.1.evil.example", None, False),
        ("", None, False),
        ("bench.example.org", None, False),
        ("bench.example.org", SECURE, True),
        ("Bench.Example.org:443", SECURE, True),
        ("evil.example", SECURE, False),
        ("localhost:8000", None, True),
        ("127.0.0.1:1", None, True),
        ("[::1]:8000", None, True),
    ],
)
def test_a_name_of_another_site_that_leads_here_is_not_answered(
    live: Live, host: str, access: Access, answers: bool
) -> None:
    client = Client(live, access) if access else Client(live)
    response = client.get("/api/about", headers=bearer(live) | {"Host": host})
    if answers:
        assert response.status_code == 200
    else:
        problem(response, 421)


def test_who_brings_a_wrong_token_is_not_let_in_by_their_cookie(browser: Client) -> None:
    for value in ("Bearer gonio_x", "Bearer ", "Basic YTpi", "", "Bearer ä".encode()):
        response = browser.get("/api/me", headers={"Authorization": value})
        problem(response, 401)
        assert response.headers["www-authenticate"] == "Bearer"


def test_logging_out_ends_the_session_and_not_only_the_cookie(live: Live, browser: Client) -> None:
    stolen = dict(browser.cookies)
    assert browser.post("/api/logout").status_code == 204
    assert dict(browser.cookies) == {}
    browser.cookies.update(stolen)
    problem(browser.get("/api/me"), 401)


def test_a_login_ends_the_session_that_the_browser_had(live: Live, browser: Client) -> None:
    before = dict(browser.cookies)
    browser.login("anna", PASSWORD)
    assert dict(browser.cookies) != before
    browser.cookies.clear()
    browser.cookies.update(before)
    problem(browser.get("/api/me"), 401)


def test_another_password_needs_the_old_one_and_ends_all_sessions(live: Live, browser: Client) -> None:
    other = Client(live)
    other.login("anna", PASSWORD)
    new = "another one, longer"
    problem(browser.post("/api/me/password", {"current_password": "wrong", "password": new}), 403)
    assert other.get("/api/me").status_code == 200
    assert browser.post("/api/me/password", {"current_password": PASSWORD, "password": new}).status_code == 204
    problem(browser.get("/api/me"), 401)
    problem(other.get("/api/me"), 401)
    problem(other.login("anna", PASSWORD), 401)
    assert other.login("anna", new).status_code == 200


def test_who_is_logged_in_elsewhere_sees_it_and_ends_it(live: Live, browser: Client) -> None:
    other = Client(live)
    other.login("anna", PASSWORD)
    add_user(live.store, "otto", "admin", PASSWORD)
    stranger = Client(live)
    stranger.login("otto", PASSWORD)
    there, here = other.get("/api/me/sessions").json()
    assert (there["this"], here["this"]) == (True, False)
    assert other.cookies["goniometer"] not in other.get("/api/me/sessions").text
    problem(stranger.request("DELETE", f"/api/me/sessions/{here['id']}"), 404)
    assert browser.get("/api/me").status_code == 200
    assert other.request("DELETE", f"/api/me/sessions/{here['id']}").status_code == 204
    problem(browser.get("/api/me"), 401)
    assert [each["id"] for each in other.get("/api/me/sessions").json()] == [there["id"]]


def test_nobody_learns_which_names_there_are(live: Live, browser: Client) -> None:
    add_user(live.store, "gone", "viewer", PASSWORD)
    Client(live).request("PATCH", "/api/users/gone", json={"disabled": True}, headers=bearer(live))
    told = {
        problem(browser.post("/api/login", {"name": name, "password": password}), 401)
        for name, password in (("anna", "wrong"), ("nobody", "wrong"), ("gone", PASSWORD), ("root", ""))
    }
    assert len(told) == 1


def test_a_token_made_with_a_token_may_no_more_and_holds_no_longer(live: Live) -> None:
    made = Client(live).post("/api/tokens", {"label": "short", "role": "operator", "days": 1}, headers=bearer(live))
    assert made.status_code == 201
    child = {"Authorization": f"Bearer {made.json()['token']}"}
    client = Client(live)
    problem(client.post("/api/tokens", {"label": "more", "role": "admin"}, headers=child), 403)
    grandchild = client.post("/api/tokens", {"label": "longer", "days": 300}, headers=child).json()
    assert grandchild["role"] == "operator"
    assert grandchild["expires"] == made.json()["expires"]
    for_ever = client.post("/api/tokens", {"label": "for ever"}, headers=child).json()
    assert for_ever["expires"] == made.json()["expires"]
    first = client.get("/api/tokens", headers=child).json()["items"][0]
    assert first["role"] == "admin"
    problem(client.request("DELETE", f"/api/tokens/{first['id']}", headers=child), 403)
    problem(client.get("/api/tokens?everybody=true", headers=child), 403)


def test_nobody_touches_the_tokens_of_others(live: Live, browser: Client) -> None:
    bearer(live)
    assert browser.get("/api/tokens").json()["items"] == []
    problem(browser.request("DELETE", "/api/tokens/1"), 404)
    everybody = Client(live).get("/api/tokens?everybody=true", headers=bearer(live)).json()["items"]
    assert {each["user"] for each in everybody} == {"root"}


def test_the_log_tells_who_did_what_and_no_secret(live: Live, browser: Client) -> None:
    root = bearer(live)
    client = Client(live)
    client.post("/api/users", {"name": "bert", "role": "viewer", "password": "secret-of-bert"}, headers=root)
    client.post("/api/users", {"name": "carl", "role": "viewer", "pasword": "secret-misspelt"}, headers=root)
    client.request("PATCH", "/api/users/bert", json={"role": "operator", "password": "secret-again"}, headers=root)
    client.post("/api/login", {"name": "bert", "password": "secret-wrong"})
    client.post("/api/login", {"name": "secret-typed-as-name", "password": "x"})
    browser.post("/api/me/password", {"current_password": "secret-current", "password": "secret-next"})
    token = browser.post("/api/tokens", {"label": "night"}).json()["token"]
    client.post("/api/queue/7/start?why=%C3%BC", headers=root)
    client.post("/api/instrument/jog", headers=root, json={"theta_out": 12.5, "nonsense": True})
    found = logged(live)
    assert [(who, via, action, about["status"]) for who, via, action, about in found] == [
        ("anna", "session", "POST /api/login", 200),
        ("root", "token", "POST /api/users", 201),
        ("root", "token", "POST /api/users", 422),
        ("root", "token", "PATCH /api/users/{name}", 200),
        ("nobody", "nobody", "POST /api/login", 401),
        ("nobody", "nobody", "POST /api/login", 401),
        ("anna", "session", "POST /api/me/password", 403),
        ("anna", "session", "POST /api/tokens", 201),
        ("root", "token", "POST /api/queue/{number}/start", found[8][3]["status"]),
        ("root", "token", "POST /api/instrument/jog", 422),
    ]
    abouts = [about for *_, about in found]
    assert abouts[1]["user"] == "bert"
    assert {key: abouts[3][key] for key in ("path", "role", "new_password")} == {
        "path": "/api/users/bert",
        "role": "operator",
        "new_password": "***",
    }
    assert abouts[4]["login"] == "bert"
    assert abouts[5]["login"] == "an unknown name"
    assert (abouts[8]["path"], abouts[8]["query"]) == ("/api/queue/7/start", {"why": "ü"})
    assert abouts[9]["body"] == {"theta_out": 12.5, "nonsense": True}
    everything = json.dumps(found)
    for secret in ("secret", token, browser.headers["X-CSRF-Token"], *dict(browser.cookies).values(), PASSWORD):
        assert secret not in everything.replace("no secret", "")
    assert verify(live.store).fault is None


def test_what_nobody_known_asks_for_does_not_fill_the_log(live: Live) -> None:
    client = Client(live)
    for _ in range(3):
        problem(client.post("/api/users", {"name": "x", "role": "admin"}), 401)
        problem(client.post("/api/users", {"name": "x"}, headers={"Authorization": "Bearer x"}), 401)
        problem(client.post("/api/nowhere"), 401)
    assert logged(live) == []


def test_a_large_body_is_read_only_of_who_may_send_it_and_where_files_are_taken(live: Live, browser: Client) -> None:
    large = b"x" * (5 << 20)
    sent = 0

    async def body() -> AsyncIterator[bytes]:
        nonlocal sent
        for i in range(5):
            sent += 1
            yield large[i << 20 : (i + 1) << 20]

    stranger = Client(live)
    problem(stranger.request("POST", "/api/uploads?name=x.csv", content=body()), 401)
    assert sent <= 1
    problem(browser.request("POST", "/api/campaigns/validate", content=large), 413)
    problem(browser.request("POST", "/api/login", content=large), 413)
    assert browser.request("POST", "/api/uploads?name=x.csv", content=large).json()["size"] == len(large)


@pytest.mark.parametrize(
    ("path", "asked"),
    [
        ("/api/uploads?name=../x.csv", None),
        ("/api/uploads?name=x%0Ay.csv", None),
        ("/api/tradeoff", {"kinds": ["models"], "sample": "file:/etc/passwd"}),
        ("/api/tradeoff", {"kinds": ["models"], "surface": "/etc/passwd"}),
        ("/api/queue", {"campaign": {"name": "x", "samples": [{"name": "A", "material": "file:/etc/passwd"}]}}),
        ("/api/queue", {"campaign": "name: x\nsamples: [{name: A, material: sample-1}]\n"
         "reference: {certificate: ../../../../../etc/passwd}"}),
    ],
)  # fmt: skip
def test_nobody_makes_the_service_read_or_write_other_files(
    live: Live, browser: Client, path: str, asked: object
) -> None:
    detail = problem(browser.post(path, asked), 422)
    assert "root:" not in detail


def test_the_log_shows_whether_it_is_whole_and_in_pages(live: Live, tmp_path: Path) -> None:
    root, client = bearer(live), Client(live)
    for _ in range(5):
        client.post("/api/tokens", {"label": "x"}, headers=root)
    first = client.get("/api/log?limit=3&verify=true", headers=root).json()
    assert [row["sequence"] for row in first["items"]] == [5, 4, 3]
    assert (first["verified"]["rows"], first["verified"]["fault"]) == (5, None)
    assert first["verified"]["head"] == first["items"][0]["hash"]
    second = client.get(f"/api/log?limit=3&after={first['next']}", headers=root).json()
    assert [row["sequence"] for row in second["items"]] == [2, 1]
    assert (second["next"], second["verified"]) == (None, None)
    with sqlite3.connect(tmp_path / "bench.db") as connection:
        connection.executescript("DROP TRIGGER log_no_update; UPDATE log SET who = 'x' WHERE sequence = 2")
    connection.close()
    assert "Row 2" in client.get("/api/log?verify=true", headers=root).json()["verified"]["fault"]


def test_who_is_kept_out_hears_no_more_of_what_happens(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "LOOK_AGAIN", 0.0)
    token, made = create_token(live.store, "root", "listens")

    async def listen() -> str:
        live.events.attach(asyncio.get_running_loop())
        transport = httpx.ASGITransport(Client(live).app)
        headers = {"Authorization": f"Bearer {token}"}
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost", headers=headers) as client:
            began, since = asyncio.Event(), live.events._since

            def noted(seen: int) -> Any:
                began.set()
                return since(seen)

            monkeypatch.setattr(live.events, "_since", noted)
            hearing = asyncio.create_task(client.get("/api/events"))
            await began.wait()
            for kind in ("progress", "alarm"):
                if kind == "alarm":
                    await asyncio.sleep(2.0)
                    revoke_token(live.store, made.id)
                live.events.publish(kind, "{}")
            return (await asyncio.wait_for(hearing, 30)).text

    heard = asyncio.run(listen())
    assert "event: progress" in heard
    assert "event: alarm" not in heard


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.8.8.8"])
def test_on_the_machine_itself_the_service_works_at_once(live: Live, host: str) -> None:
    assert check_listen(host, live.store) == Access(loopback=True, secure=False)


def test_a_proxy_on_the_machine_makes_others_come_in(live: Live) -> None:
    with pytest.raises(ConfigurationError, match="goniometer user add"):
        check_listen("127.0.0.1", live.store, behind_proxy=True)
    add_user(live.store, "anna", "operator", PASSWORD)
    assert check_listen("127.0.0.1", live.store, behind_proxy=True) == Access(loopback=False, secure=True)


def test_a_port_that_is_taken_is_refused_before_a_token_is_told(tmp_path: Path, cli: Cli) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = cli("serve", "--port", taken.getsockname()[1], cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "in use; name another, or end what listens there" in done.stderr


def test_no_address_and_no_token_are_told_of_a_service_without_its_certificate(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "lab.yaml").write_text("name: no certificate\n")
    done = cli("serve", "--port", 0, "--tls-cert", "lab.yaml", "--tls-key", "lab.yaml", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "--tls-cert lab.yaml --tls-key lab.yaml: " in done.stderr
    assert not (tmp_path / "goniometer.db").exists()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.0.2.1", "bench.example.org"])
def test_other_machines_are_let_in_only_where_somebody_can_log_in_unread(live: Live, host: str) -> None:
    first_token(live.store)
    for how in ({"tls": True}, {"behind_proxy": True}):
        with pytest.raises(ConfigurationError, match="goniometer user add"):
            check_listen(host, live.store, **how)
    add_user(live.store, "anna", "operator", PASSWORD)
    with pytest.raises(ConfigurationError, match="--tls-cert and --tls-key, or --behind-proxy"):
        check_listen(host, live.store)
    for how in ({"tls": True}, {"behind_proxy": True}):
        access = check_listen(host, live.store, hosts=("Bench.Example.org",), **how)
        assert access == SECURE
