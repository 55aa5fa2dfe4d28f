"""Guessing passwords leads nowhere, and nobody can keep somebody else out by guessing."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from api.access.throttle import count_try, forgive
from api.errors import TooManyFailures
from goniometer.storage.service_tables import logins
from goniometer.storage.store import Store

Clock = Callable[[float], None]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


@pytest.fixture
def wait(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Let seconds pass."""
    present = [1.8e9]
    monkeypatch.setattr(time, "time", lambda: present[0])

    def pass_by(seconds: float) -> None:
        present[0] += seconds

    return pass_by


def guesses(store: Store, wait: Clock, seconds: float, names: list[str], addresses: list[str]) -> int:
    """Passwords that somebody gets to try in `seconds` who tries as often as they can."""
    count, passed = 0, 0.0
    while passed < seconds:
        soonest = seconds
        for name in names:
            for address in addresses:
                try:
                    count_try(store, name, address)
                    count, soonest = count + 1, 0.0
                except TooManyFailures as error:
                    soonest = min(soonest, error.seconds)
        wait(soonest)
        passed += soonest
    return count


def must_wait(store: Store, name: str, address: str) -> float:
    """Seconds that a login must wait, 0 if none; it is not counted against who logs in."""
    try:
        count_try(store, name, address)
    except TooManyFailures as error:
        return error.seconds
    forgive(store, name, address)
    return 0.0


def test_mistyping_a_few_times_costs_nothing(store: Store, wait: Clock) -> None:
    for _ in range(5):
        count_try(store, "anna", "192.0.2.1")
    assert must_wait(store, "anna", "192.0.2.1") == pytest.approx(1.0)
    wait(1.0)
    assert must_wait(store, "anna", "192.0.2.1") == 0.0
    for _ in range(5):
        count_try(store, "anna", "192.0.2.1")  # who came in may mistype again


def test_who_guesses_gets_few_tries_from_one_address_from_many_and_for_many_names(store: Store, wait: Clock) -> None:
    assert guesses(store, wait, 600, ["anna"], ["192.0.2.1"]) < 25
    wait(7200)
    assert guesses(store, wait, 600, [f"user{i}" for i in range(10)], ["192.0.2.1"]) < 45
    wait(7200)
    assert guesses(store, wait, 300, ["anna"], [f"198.51.100.{i}" for i in range(10)]) < 45


def test_who_commonly_logs_in_somewhere_is_not_kept_out_by_who_guesses_elsewhere(store: Store, wait: Clock) -> None:
    count_try(store, "anna", "192.0.2.1")
    forgive(store, "anna", "192.0.2.1")
    wait(20 * 24 * 3600)
    guesses(store, wait, 120, ["bert", "carl", "root", "admin"], ["192.0.2.1"])
    guesses(store, wait, 100, ["anna"], [f"198.51.100.{i}" for i in range(10)])
    assert must_wait(store, "anna", "192.0.2.1") == 0.0
    wait(-1.0)
    assert must_wait(store, "anna", "203.0.113.9") > 0.0


def test_even_at_the_bench_itself_nobody_is_kept_out_for_longer_than_a_minute(store: Store, wait: Clock) -> None:
    guesses(store, wait, 900, ["anna"], ["127.0.0.1"])
    count_try(store, "anna", "127.0.0.1")
    assert 0.0 < must_wait(store, "anna", "127.0.0.1") <= 60.0
    wait(60.0)
    assert must_wait(store, "anna", "127.0.0.1") == 0.0


def test_a_try_that_comes_too_early_makes_the_wait_no_longer(store: Store, wait: Clock) -> None:
    for _ in range(5):
        count_try(store, "anna", "192.0.2.1")
    for _ in range(50):
        assert must_wait(store, "anna", "192.0.2.1") == pytest.approx(1.0)
    wait(1.0)
    assert must_wait(store, "anna", "192.0.2.1") == 0.0


def test_a_restart_forgives_nothing(either: Store, wait: Clock, database: Path | str) -> None:
    for _ in range(5):
        count_try(either, "anna", "192.0.2.1")
    again = Store.open(database)
    assert must_wait(again, "anna", "192.0.2.1") > 0.0
    again.close()


def test_many_tries_at_once_are_no_way_around(either: Store) -> None:
    def attempt(_: int) -> bool:
        try:
            count_try(either, "anna", "192.0.2.1")
        except TooManyFailures:
            return False
        return True

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(attempt, range(60))) <= 8  # five, and one for each second that this may take


def test_names_that_nobody_has_do_not_stay_in_the_database(store: Store, wait: Clock) -> None:
    guesses(store, wait, 10, [f"{i}" * 500 for i in range(40)], ["192.0.2.1"])
    assert len(store.rows(logins.select())) < 30
    wait(3601)
    count_try(store, "anna", "192.0.2.2")
    assert [row.name for row in store.rows(logins.select())] == ["anna"]


def test_a_household_of_ipv6_addresses_counts_as_one(store: Store, wait: Clock) -> None:
    for i in range(5):
        count_try(store, "anna", f"2001:db8::{i}")
    assert must_wait(store, "anna", "2001:db8::ffff") > 0.0
    assert must_wait(store, "anna", "2001:db8:0:1::1") == 0.0
