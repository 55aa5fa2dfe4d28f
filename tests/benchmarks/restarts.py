"""A service that is killed and started again, time after time, while campaigns are ordered.

    python -m tests.benchmarks.restarts [--restarts N] [--seed S]

Every life of the service answers on the same database, is asked to queue campaigns, one after the other, and gets
SIGKILL at a random moment meanwhile, with the process of its bench. What it said it had queued must stand in the queue
of every later life, once and as it was ordered, and the log of who did what must be whole, with a row for each life.
"""

import argparse
import importlib
import json
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx

from api.access import audit
from api.access.tokens import create_token, ensure_first_user
from api.web.serve import Listen, serve
from goniometer.storage.database import Database
from goniometer.storage.store import Store
from goniometer.upkeep.integrity import check
from tests.api.nursery import HEAVY
from tests.benchmarks.figures import tell
from tests.benchmarks.kills import live, opened
from tests.served import TINY

LONGEST = 1.0
"""Seconds that a life lasts at most, once the service has confirmed something."""
PATIENCE = 120.0
"""Seconds after which a service that does not answer is called stuck."""


def start(file: Path) -> int:
    """Serve in a child with a session of its own; returns its number."""
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        out = os.open(file.with_name("service.log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(out, 1)
        os.dup2(out, 2)
        sys.modules["__main__"] = ModuleType("__main__")  # the process of the bench loads what it needs, and not this
        serve(file, file.parent / "results", None, Listen(port=0), mounts_by_itself=True)
        code = 0
    finally:
        os._exit(code)


def urls(file: Path) -> list[str]:
    """Where every life of the service answered, as the log tells."""
    with opened(file) as connection:
        found = connection.execute("SELECT about FROM log WHERE who = 'service' AND action = 'start' ORDER BY sequence")
        return [str(json.loads(about)["url"]) for (about,) in found]


def wait(condition: Callable[[], Any], child: int) -> Any:
    """What `condition` finds, once that is something; raises where the child ends before, or nothing comes."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        if os.waitpid(child, os.WNOHANG)[0] or time.monotonic() > end:
            raise RuntimeError("the service did not start; see service.log")
        time.sleep(0.01)
    return found


def order(client: httpx.Client, life: int, then: Callable[[], None]) -> list[dict[str, Any]]:
    """Queue campaigns until the service is gone; `then` is called once it has confirmed the first. Returns those."""
    confirmed: list[dict[str, Any]] = []
    with suppress(httpx.TransportError):
        while True:
            campaign = TINY | {"name": f"Life {life}, campaign {len(confirmed)}"}
            answer = client.post("/api/queue", json={"campaign": campaign})
            answer.raise_for_status()
            confirmed.append(answer.json())
            if len(confirmed) == 1:
                then()
    return confirmed


def missing(file: Path, confirmed: list[dict[str, Any]]) -> list[str]:
    """Entries that were confirmed in an earlier life and are not in the queue as they were, or more than once."""
    with opened(file) as connection:
        queued = connection.execute("SELECT id, name, who, phase FROM queue").fetchall()
    names = [name for _, name, _, _ in queued]
    return [
        f"what was confirmed as entry {entry['id']} is not in the queue as it was"
        for entry in confirmed
        if names.count(entry["campaign"]) != 1 or (entry["id"], entry["campaign"], entry["who"], "idle") not in queued
    ]


def prepared(file: Path) -> str:
    """A new database with a user, and their token."""

    def work(say: Callable[[str], None]) -> None:
        store = Store.open(file)
        ensure_first_user(store)
        say(create_token(store, "local", "restarts")[0])
        store.close()

    _, (token,) = live(work, None)
    return token


def main() -> None:
    """Restart, and tell what came of it; exit with 1 where anything was lost."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--restarts", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for heavy in HEAVY:  # once, and not in every life
        importlib.import_module(heavy)
    chance = random.Random(asked.seed)
    confirmed: list[dict[str, Any]] = []
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "goniometer.db"
        headers = {"Authorization": f"Bearer {prepared(file)}"}
        for life in range(asked.restarts):
            child = start(file)
            killer = threading.Timer(chance.uniform(0.0, LONGEST), os.killpg, (child, signal.SIGKILL))
            try:
                wait(partial(lambda lives: len(urls(file)) > lives, life), child)
                with httpx.Client(
                    base_url=urls(file)[-1], headers=headers, timeout=PATIENCE, trust_env=False
                ) as client:
                    wait(partial(_answers, client), child)
                    faults += missing(file, confirmed)
                    confirmed += order(client, life, killer.start)
                killer.join()
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
        faults += missing(file, confirmed)
        database = Database.as_it_is(file)
        faults += check(database).faults
        verdict = audit.verify(database)
        faults += [] if verdict.fault is None else [verdict.fault]
        database.close()
        lives = len(urls(file))
    if lives != asked.restarts:
        faults.append(f"the log tells of {lives} lives of {asked.restarts}")
    print(*faults, sep="\n")
    tell("kills and restarts", lives, aim=f">= {asked.restarts}")
    tell("campaigns that it confirmed as queued", len(confirmed), aim="> 0")
    tell("rows of the log of who did what", verdict.rows)
    tell("lost, doubled or changed", len(faults), aim="= 0")
    sys.exit(1 if faults else 0)


def _answers(client: httpx.Client) -> bool:
    try:
        return client.get("/health").status_code < 500
    except httpx.TransportError:
        return False


if __name__ == "__main__":
    main()
