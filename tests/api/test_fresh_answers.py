"""What the service answers from memory: never older than what has happened, and made once for all who ask."""

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from pydantic import BaseModel
from starlette.requests import Request

from api.access import callers
from api.access.accounts import add_user, set_disabled
from api.access.tokens import Caller, create_token, revoke_token
from api.bench import queue
from api.errors import Unauthorised
from api.web.answers import Answers
from api.web.live import Live, open_live
from goniometer.campaigns.campaign import Campaign
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.storage.store import Store
from simulators.materials.materials import PANEL_CERTIFICATE
from tests.api.service_client import Client
from tests.served import TINY


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    with open_live(tmp_path / "bench.db", tmp_path) as opened:
        add_user(opened.store, "root", "admin", None)
        yield opened


@pytest.fixture
def client(live: Live) -> Client:
    client = Client(live)
    client.headers["Authorization"] = f"Bearer {create_token(live.store, 'root', 'test')[0]}"
    return client


def test_what_another_process_has_written_is_in_the_very_next_answer(
    live: Live, client: Client, tmp_path: Path
) -> None:
    assert client.get("/api/scans").json()["items"] == []
    other = Store.open(tmp_path / "bench.db")
    other.add_campaign(Campaign.model_validate(TINY), certificate_csv(PANEL_CERTIFICATE))
    first = client.get("/api/scans").json()["items"][0]["id"]
    assert client.get(f"/api/scans/{first}/points").json()["items"] == []
    for number in range(3):
        other.explain(first, f"It waits for the {number}th time.")
        assert client.get("/api/scans").json()["items"][0]["reason"] == f"It waits for the {number}th time."
    for name in ("One", "Two"):
        queue.add_entry(other, Campaign.model_validate(TINY | {"name": name}), "root")
        assert client.get("/api/queue").json()["items"][-1]["campaign"] == name
    other.close()


def test_a_list_that_is_as_it_was_is_not_sent_again(live: Live, client: Client) -> None:
    for path in ("/api/instrument", "/api/queue", "/api/scans"):
        first = client.get(path)
        tag = {"If-None-Match": first.headers["etag"]}
        again = client.get(path, headers=tag)
        assert (again.status_code, again.content) == (304, b"")
        assert first.headers["cache-control"] == "private, no-cache"
    queue.add_entry(live.store, Campaign.model_validate(TINY), "root")
    tag = {"If-None-Match": client.get("/api/scans").headers["etag"]}
    assert client.get("/api/queue", headers=tag).json()["items"][0]["campaign"] == "Tiny"


def test_fifty_pages_that_ask_in_one_moment_cost_one_answer(live: Live) -> None:
    class Seen(BaseModel):
        count: int

    made, slowly = [], threading.Event()

    def make() -> Seen:
        slowly.wait(0.2)
        made.append(None)
        return Seen(count=len(made))

    def asks(query: bytes) -> Request:
        scope = {"type": "http", "path": "/list", "query_string": query, "headers": [(b"host", b"localhost")]}
        return Request(scope | {"server": ("localhost", 80), "scheme": "http"})

    async def crowd() -> set[bytes]:
        answers = Answers(live)
        told = await asyncio.gather(*(answers.of(asks(b"limit=5"), make) for _ in range(50)))
        assert len(made) == 1
        await answers.of(asks(b"limit=6"), make)
        return {bytes(each.body) for each in told}

    assert asyncio.run(crowd()) == {b'{"count":1}'}
    assert len(made) == 2, "another part of the list is another answer"


def test_a_token_that_is_revoked_opens_nothing_from_that_moment_on(live: Live, client: Client) -> None:
    text, made = create_token(live.store, "root", "for a while")
    given = {"Authorization": f"Bearer {text}"}
    other = Client(live)
    assert other.get("/api/about", headers=given).status_code == 200
    assert client.request("DELETE", f"/api/tokens/{made.id}").status_code == 204
    assert other.get("/api/about", headers=given).status_code == 401


def test_who_is_kept_out_by_another_process_is_out_within_a_second(
    live: Live, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moment = 0.0
    monkeypatch.setattr(callers, "monotonic", lambda: moment)
    add_user(live.store, "anna", "viewer", None)
    anna = {"Authorization": f"Bearer {create_token(live.store, 'anna', 'test')[0]}"}
    text, made = create_token(live.store, "root", "for a while")
    assert client.get("/api/about", headers=anna).status_code == 200
    assert client.get("/api/about", headers={"Authorization": f"Bearer {text}"}).status_code == 200
    other = Store.open(tmp_path / "bench.db")
    set_disabled(other, "anna", disabled=True)
    revoke_token(other, made.id)
    other.close()
    moment = 1.0
    assert client.get("/api/about", headers=anna).status_code == 401
    assert client.get("/api/about", headers={"Authorization": f"Bearer {text}"}).status_code == 401
    assert client.get("/api/about").status_code == 200


def test_a_change_while_it_is_asked_who_somebody_is_is_not_forgotten(live: Live) -> None:
    token, made = create_token(live.store, "root", "for a while")

    class Slow(callers.Callers):
        async def anew(self, shown: callers.Shown) -> Caller | None:
            found = await super().anew(shown)
            revoke_token(live.store, made.id)  # by another request, between the answer of the database and ours
            self.forget()
            return found

    async def ask() -> None:
        known = Slow(live.store)
        assert await known.of(("token", token)) is not None
        with pytest.raises(Unauthorised):
            await known.of(("token", token))

    asyncio.run(ask())


def test_a_crowd_of_listeners_is_told_the_same_in_the_same_order(live: Live) -> None:
    async def listen() -> list[str]:
        live.events.attach(asyncio.get_running_loop())

        async def one() -> str:
            text = ""
            async for told in live.events.subscribe():
                text += "".join(event.text for event in told)
                if text.endswith('{"n":299}'):
                    break
            return text

        listening = [asyncio.create_task(one()) for _ in range(20)]
        await asyncio.sleep(0)
        for n in range(300):
            live.events.publish("point", f'{{"n":{n}}}')
            if n % 30 == 0:
                await asyncio.sleep(0.02)
        return list(await asyncio.wait_for(asyncio.gather(*listening), 30))

    told = asyncio.run(listen())
    assert set(told) == {"".join(f'{{"n":{n}}}' for n in range(300))}


def test_a_stream_in_which_nothing_happens_shows_that_it_lives(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.events.HEARTBEAT", 0.05)

    async def listen() -> list[int]:
        live.events.attach(asyncio.get_running_loop())
        stream = live.events.subscribe()
        return [len(await asyncio.wait_for(anext(stream), 30)) for _ in range(4)]

    assert asyncio.run(listen()) == [0, 0, 0, 0]


def test_everybody_hears_that_the_service_ends(live: Live) -> None:
    async def listen() -> httpx.Response:
        live.events.attach(asyncio.get_running_loop())
        headers = {"Authorization": f"Bearer {create_token(live.store, 'root', 'listens')[0]}"}
        transport = httpx.ASGITransport(Client(live).app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost", headers=headers) as client:
            hearing = asyncio.create_task(client.get("/api/events"))
            await asyncio.sleep(0.3)
            live.events.close()
            return await asyncio.wait_for(hearing, 10)

    assert asyncio.run(listen()).status_code == 200
