"""The log of who did what: that nobody can make it say something else unnoticed."""

import hashlib
import json
import multiprocessing
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError

from api.access.audit import FIRST, entries, head, record, verify
from goniometer.errors import StoreError
from goniometer.storage.store import Store
from tests.databases import fresh_database, outside


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "bench.db"


@pytest.fixture
def store(file: Path) -> Iterator[Store]:
    opened = Store.open(file)
    yield opened
    opened.close()


def fill(store: Store, count: int = 5) -> None:
    for number in range(count):
        record(store, "anna", "POST /api/instrument/jog", {"theta_in": 0.1 + number, "sample": "Größe µm"}, "session")


def tamper(file: Path, *statements: str) -> None:
    """Change the log as somebody who has the file and knows how it is protected."""
    with sqlite3.connect(file) as connection:
        for name in ("log_no_update", "log_no_delete"):
            connection.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            connection.execute(statement)
    connection.close()


def test_who_reads_only_the_description_of_the_chain_computes_the_same_hashes(store: Store, file: Path) -> None:
    fill(store)
    with sqlite3.connect(file) as connection:
        connection.row_factory = sqlite3.Row
        rows = [dict(row) for row in connection.execute("SELECT * FROM log ORDER BY sequence")]
    connection.close()
    previous = "0" * 64
    for number, row in enumerate(rows, 1):
        told = row.pop("hash")
        assert row["sequence"] == number
        assert row["previous"] == previous
        text = json.dumps(row, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        assert told == hashlib.sha256(text.encode("ascii")).hexdigest()
        previous = told
    assert len(rows) == 5
    assert head(store) == previous
    verdict = verify(store)
    assert (verdict.rows, verdict.head, verdict.fault) == (5, previous, None)


def test_an_empty_log_is_whole(store: Store) -> None:
    verdict = verify(store, FIRST)
    assert (verdict.rows, verdict.head, verdict.fault) == (0, FIRST, None)


@pytest.mark.parametrize("statement", ["UPDATE log SET who = 'bert' WHERE sequence = 2", "DELETE FROM log"])
def test_the_database_itself_refuses_to_change_the_log(either: Store, database: Path | str, statement: str) -> None:
    fill(either)
    with pytest.raises(IntegrityError, match="only ever added"), outside(database) as connection:
        connection.execute(text(statement))
    assert verify(either).fault is None


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        (["UPDATE log SET who = 'bert' WHERE sequence = 3"], "Row 3 .* changed"),
        (["UPDATE log SET time = time || ' ' WHERE sequence = 5"], "Row 5 .* changed"),
        (["UPDATE log SET about = replace(about, '0.1', '0.2') WHERE sequence = 1"], "Row 1 .* changed"),
        (["DELETE FROM log WHERE sequence = 1"], "Row 1 .* missing"),
        (["DELETE FROM log WHERE sequence = 3"], "Row 3 .* missing"),
        (
            ["DELETE FROM log WHERE sequence = 3", "UPDATE log SET sequence = sequence - 1 WHERE sequence > 3"],
            "Row 3 .* does not follow",
        ),
        (["UPDATE log SET sequence = 9 WHERE sequence = 5"], "Row 5 .* missing"),
        (["DELETE FROM log WHERE sequence > 3"], "Rows 4 to 5 .* cut off"),
        (["DELETE FROM log"], "Rows 1 to 5 .* cut off"),
    ],
)
def test_a_changed_removed_or_cut_row_is_found(store: Store, file: Path, statements: list[str], words: str) -> None:
    fill(store)
    tamper(file, *statements)
    fault = verify(store).fault
    assert fault is not None
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(fault)


def test_a_row_that_was_changed_on_a_server_is_found(postgresql: str) -> None:
    with fresh_database(postgresql) as database:
        store = Store.open(database)
        fill(store)
        with outside(database) as connection:
            connection.execute(text("ALTER TABLE log DISABLE TRIGGER ALL"))
            connection.execute(text("UPDATE log SET who = 'bert' WHERE sequence = 2"))
        assert "Row 2 of the log was changed" in str(verify(store).fault)
        store.close()


def test_a_row_that_somebody_slipped_in_is_found_although_its_own_hash_is_right(store: Store, file: Path) -> None:
    fill(store)
    at_three = entries(store, before=4, limit=1)[0]
    forged = {
        "sequence": 3, "time": at_three.time, "who": "bert", "via": "cli", "action": "run", "about": "{}",
        "previous": at_three.previous,
    }  # fmt: skip
    text = json.dumps(forged, sort_keys=True, separators=(",", ":"))
    row = (*forged.values(), hashlib.sha256(text.encode()).hexdigest())
    make_room = "UPDATE log SET sequence = sequence + 100 WHERE sequence >= 3"
    close_up = "UPDATE log SET sequence = sequence - 99 WHERE sequence > 100"
    tamper(file, make_room, f"INSERT INTO log VALUES {row!r}", close_up)
    assert "Row 4 of the log does not follow" in str(verify(store).fault)


def test_a_hash_that_was_noted_elsewhere_tells_of_a_tail_that_was_cut_off_with_care(store: Store, file: Path) -> None:
    fill(store)
    noted = head(store)
    fill(store, 2)
    assert verify(store, noted).fault is None
    tamper(file, "DELETE FROM log WHERE sequence > 3", "UPDATE sqlite_sequence SET seq = 3 WHERE name = 'log'")
    assert verify(store).fault is None  # nothing in the file tells of it any more
    assert noted in str(verify(store, noted).fault)
    fill(store, 4)
    assert noted in str(verify(store, noted).fault)


def _write(database: Path | str, who: str, count: int) -> None:
    store = Store.open(database)
    for number in range(count):
        record(store, who, "count", {"number": number})
    store.close()


def test_two_processes_that_write_at_once_keep_one_chain(either: Store, database: Path | str) -> None:
    writers = [
        multiprocessing.get_context("fork").Process(target=_write, args=(database, who, 30))
        for who in ("worker", "web")
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    verdict = verify(either)
    assert (verdict.rows, verdict.fault) == (60, None)
    for who in ("worker", "web"):
        mine = [json.loads(entry.about)["number"] for entry in reversed(entries(either, limit=100)) if entry.who == who]
        assert mine == list(range(30))


def test_secrets_do_not_enter_the_log_and_odd_values_do_not_stop_it(store: Store) -> None:
    odd = {
        "password": "hunter2hunter2", "new_password": "hunter2hunter2", "deep": [{"Token": "hunter2"}],
        "nan": float("nan"), "surrogate": "\ud800", "path": Path("x"), "none": None,
    }  # fmt: skip
    entry = record(store, "anna", "try", odd, "token")
    about = json.loads(entry.about)
    assert "hunter2" not in entry.about
    assert about == {
        "password": "***", "new_password": "***", "deep": [{"Token": "***"}], "nan": "nan", "surrogate": "\ud800",
        "path": "x", "none": None,
    }  # fmt: skip
    assert entries(store) == [entry]
    assert verify(store).fault is None


def test_a_row_of_unknown_origin_is_refused(store: Store) -> None:
    with pytest.raises(StoreError):
        record(store, "anna", "try", {}, "telepathy")
    assert entries(store) == []
