"""What becomes of a scan when another program locks the database for longer than anybody waits."""

import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.served import TINY, served, wait_for

LOCK = """
import sqlite3, sys, time
connection = sqlite3.connect(sys.argv[1], isolation_level=None, timeout=60)
connection.execute("BEGIN IMMEDIATE")
print("locked", flush=True)
time.sleep(20)
"""
"""A program that writes nothing and lets nobody else write."""


@pytest.mark.slow
def test_a_scan_goes_on_where_it_stood_after_the_database_was_locked_for_twenty_seconds(tmp_path: Path) -> None:
    with served(tmp_path, mounts_by_itself=True) as service:
        wait_for(lambda: service.state()["driver"])
        number = service.ordered(TINY)
        before = wait_for(lambda: service.entry(number)["points_done"])
        locking = subprocess.Popen([sys.executable, "-c", LOCK, tmp_path / "goniometer.db"], stdout=subprocess.PIPE)
        assert locking.stdout is not None
        assert locking.stdout.readline() == b"locked\n"
        answered = 0
        while locking.poll() is None:  # who watches is answered all the while
            for path in ("/api/instrument", "/api/queue", "/api/scans"):
                assert service.client.get(path).status_code == 200
            answered += 1
            time.sleep(0.1)  # as somebody who watches asks, and not as fast as a machine can
        assert answered
        wait_for(lambda: (service.state()["driver"] or {}).get("here"))

        def ended() -> str | None:
            entry = service.entry(number)
            if entry["phase"] == "idle" or entry["outcome"] == "failed":
                assert entry["reason"], "nobody is left without a reason"
                assert service.client.post(f"/api/queue/{number}/start").status_code == 200
            return str(entry["outcome"]) if entry["outcome"] == "completed" else None

        wait_for(ended)
        assert service.entry(number)["points_done"] > before
    with sqlite3.connect(tmp_path / "goniometer.db") as database:
        counted = "SELECT count(*), count(DISTINCT scan_id || '/' || number) FROM points WHERE status = 'done'"
        done, different = database.execute(counted).fetchone()
        assert done == different == database.execute("SELECT count(*) FROM points").fetchone()[0]
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()
