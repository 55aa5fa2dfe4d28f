"""A real server on the simulated bench, in a thread of the test, and a client that may do everything."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import uvicorn

from api.access.tokens import create_token, ensure_first_user
from api.web.app import make_app
from api.web.live import Live, open_live
from api.web.patience import Patient

PATIENCE = 400.0
"""Seconds after which what should have happened is called stuck; fits give way to all else, and so to other tests."""

LONG: dict[str, Any] = {
    "name": "Long",
    "samples": [{"name": "Sample 1", "material": "sample-1"}, {"name": "Mirror", "material": "mirror"}],
    "incident": {"start": 10, "stop": 80, "step": 10},
    "resolution": {"mode": "uniform", "step": 1},
    "reference": {"step": 5, "scans": 1},
    "stray_light": False,
    "monitor": None,
}
"""A campaign that is under way for as long as any test needs it."""

TINY: dict[str, Any] = LONG | {
    "name": "Tiny",
    "samples": [{"name": "Sample 1", "material": "sample-1"}],
    "incident": [30, 60],
    "outgoing": {"start": -40, "stop": 60},
    "resolution": {"mode": "uniform", "step": 20},
    "reference": {"step": 30, "scans": 1},
}
"""One that is measured in a few seconds."""


@dataclass(frozen=True)
class Served:
    """A service that answers."""

    live: Live
    url: str
    client: httpx.Client

    def state(self) -> dict[str, Any]:
        """Of the bench."""
        answer: dict[str, Any] = self.client.get("/api/instrument").json()
        return answer

    def entry(self, number: int) -> dict[str, Any]:
        """Of the queue."""
        answer: dict[str, Any] = self.client.get(f"/api/queue/{number}").json()
        return answer

    def ordered(self, campaign: dict[str, Any], **changes: Any) -> int:
        """The entry of a campaign that was appended and started."""
        added = self.client.post("/api/queue", json={"campaign": campaign | changes})
        assert added.status_code == 201, added.text
        number = int(added.json()["id"])
        assert self.client.post(f"/api/queue/{number}/start").status_code == 200
        return number

    def refused(self, path: str, **options: Any) -> str:
        """Why a POST is refused as not possible now."""
        answer = self.client.post(path, **options)
        assert answer.status_code == 409, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        return str(answer.json()["detail"])


@contextmanager
def served(folder: Path, database: Path | str | None = None, **options: Any) -> Iterator[Served]:
    """A service on the database of `folder`, or on another; it is parked and gone when the context ends."""
    listener = socket.create_server(("127.0.0.1", 0))
    url = f"http://127.0.0.1:{listener.getsockname()[1]}"
    with open_live(database or folder / "goniometer.db", folder / "results", url=url, **options) as live:
        ensure_first_user(live.store)
        token = create_token(live.store, "local", "test")[0]
        config = uvicorn.Config(
            make_app(live), http=Patient, ws="none", log_config=None, access_log=False, timeout_graceful_shutdown=3
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listener],))
        thread.start()
        headers = {"Authorization": f"Bearer {token}"}
        try:
            with httpx.Client(base_url=url, headers=headers, timeout=PATIENCE, trust_env=False) as client:
                service = Served(live, url, client)
                wait_for(lambda: server.started and live.worker.lives)
                yield service
        finally:
            live.events.close()
            server.should_exit = True
            thread.join()


def wait_for(condition: Callable[[], Any]) -> Any:
    """What `condition` finds, once that is something; fails when it does not in time."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.05)
    return found
