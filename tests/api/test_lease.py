"""One service drives the bench, and the queue does what it is told: two handles on one database stand for two."""

import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from api.bench import lease, queue
from api.bench.lease import Watcher, read_lease, release_lease, renew_lease, take_lease, take_up_stop
from api.errors import Conflict
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.errors import CampaignError, InputError, NotInStore, StoreBusy
from goniometer.storage.records import now
from goniometer.storage.store import Store


@pytest.fixture
def stores(database: Path | str) -> Iterator[tuple[Store, Store]]:
    """Two services on one database."""
    both = Store.open(database), Store.open(database)
    yield both
    for each in both:
        each.close()


@pytest.fixture
def benches(database: Path | str) -> Iterator[tuple[Store, Store]]:
    """Two services on one database, each with a bench of its own."""
    both = Store.open(database, "left"), Store.open(database, "right")
    yield both
    for each in both:
        each.close()


def campaign(name: str) -> Campaign:
    return Campaign(name=name, samples=(Sample(name="Sample 1", material="sample-1"),))


def test_two_services_that_want_the_bench_at_once_do_not_both_get_it(stores: tuple[Store, Store]) -> None:
    for _ in range(20):
        won = []
        before = read_lease(stores[0])
        both = threading.Barrier(2)

        def want(store: Store, name: str, won: list[object] = won, both: threading.Barrier = both) -> None:
            both.wait()
            won.append(take_lease(store, name, f"http://{name}", None))

        threads = [threading.Thread(target=want, args=each) for each in zip(stores, ("a", "b"), strict=True)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        (mine,) = [each for each in won if isinstance(each, lease.Lease)]
        assert mine.term == (0 if before is None else before.term) + 1
        release_lease(stores[0], mine)


def test_a_service_that_was_taken_for_dead_learns_it_with_its_next_sign_of_life(stores: tuple[Store, Store]) -> None:
    first = take_lease(stores[0], "a", "http://a", None)
    assert first is not None
    stale = read_lease(stores[1])
    assert renew_lease(stores[0], first) is not None
    assert take_lease(stores[1], "b", "http://b", stale) is None, "it has shown a sign of life meanwhile"
    second = take_lease(stores[1], "b", "http://b", read_lease(stores[1]))
    assert second is not None
    assert renew_lease(stores[0], first) is None
    release_lease(stores[0], first)  # changes nothing: it is not its own any more
    held = read_lease(stores[0])
    assert held is not None
    assert held.holder == "b"


def test_silence_is_measured_by_the_watchers_own_clock(
    stores: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: clock)
    held = take_lease(stores[0], "a", "http://a", None)
    assert held is not None
    watcher = Watcher()
    assert watcher.silent_for(held) == 0
    clock += 25
    assert watcher.silent_for(held) == 25
    renewed = renew_lease(stores[0], held)
    assert renewed is not None
    assert watcher.silent_for(renewed) == 0
    assert lease.GIVE_UP + lease.BEAT < lease.EXPIRY, "the holder must have let go before another may take over"


def test_a_stop_that_was_passed_on_is_taken_up_once(stores: tuple[Store, Store]) -> None:
    held = take_lease(stores[0], "a", "http://a", None)
    assert held is not None
    assert not take_up_stop(stores[0], held)
    lease.pass_on_stop(stores[1])
    assert take_up_stop(stores[0], held)
    assert not take_up_stop(stores[0], held)


def test_entries_run_in_the_order_in_which_they_stand_and_not_before_their_time(stores: tuple[Store, Store]) -> None:
    store, other = stores
    late = datetime.now(UTC) + timedelta(hours=1)
    first = queue.add_entry(store, campaign("first"), "anna", late)
    second, third = (queue.add_entry(store, campaign(name), "anna") for name in ("second", "third"))
    assert [first.phase, second.phase] == ["queued", "idle"]
    assert queue.next_entry(store) is None
    for each in (second, third):
        queue.start_entry(other, each.id)
    queue.move_entry(other, third.id, 1)
    assert [each.name for each in queue.entries(store)] == ["third", "first", "second"]
    runs = queue.next_entry(store)
    assert runs is not None
    assert (runs.name, runs.phase) == ("third", "running")
    with pytest.raises(Conflict, match="abort it first"):
        queue.remove_entry(other, third.id)
    queue.finish_entry(store, third.id, "failed", "The lamp went out.")
    again = queue.start_entry(other, third.id)
    assert (again.phase, again.outcome, again.position) == ("queued", None, 4)
    following = queue.next_entry(store)
    assert following is not None
    assert following.name == "second"


def test_after_a_restart_nothing_begins_that_was_started_before(stores: tuple[Store, Store]) -> None:
    store, _ = stores
    names = ("running", "before", "after")
    entries = {name: queue.add_entry(store, campaign(name), "anna").id for name in names}
    queue.start_entry(store, entries["running"])
    queue.start_entry(store, entries["before"])
    assert queue.next_entry(store) is not None
    time.sleep(0.01)  # moments are written down in milliseconds
    restarted = now()
    queue.start_entry(store, entries["after"])
    queue.interrupt(store, "It ended.")
    queue.hold(store, "Look first.", restarted)
    found = {each.name: (each.phase, each.reason) for each in queue.entries(store)}
    assert found == {"running": ("idle", "It ended."), "before": ("idle", "Look first."), "after": ("queued", "")}


def test_each_of_two_benches_is_driven_and_stopped_by_its_own_service(benches: tuple[Store, Store]) -> None:
    left, right = (take_lease(store, store.bench, f"http://{store.bench}", None) for store in benches)
    assert left is not None
    assert right is not None
    for store in benches:
        held = read_lease(store)
        assert held is not None
        assert held.holder == store.bench
    lease.pass_on_stop(benches[0])
    assert not take_up_stop(benches[1], right)
    assert take_up_stop(benches[0], left)
    release_lease(benches[0], left)
    assert renew_lease(benches[1], right) is not None
    freed = read_lease(benches[0])
    assert freed is not None
    assert freed.holder is None


def test_a_bench_takes_nothing_from_the_queue_of_another(benches: tuple[Store, Store]) -> None:
    left, right = benches
    first, second = (queue.add_entry(store, campaign(store.bench), "anna") for store in benches)
    assert (first.position, second.position) == (1, 1)
    queue.start_entry(left, first.id)
    assert queue.next_entry(right) is None
    queue.hold(right, "Look first.")
    queue.interrupt(right, "It ended.")
    runs = queue.next_entry(left)
    assert runs is not None
    assert (runs.name, runs.bench) == ("left", "left")
    queue.interrupt(right, "It ended.")
    assert [each.phase for each in queue.entries(left)] == ["running"]
    assert [each.name for each in queue.entries(right)] == ["right"]
    with pytest.raises(NotInStore, match="bench left"):
        queue.remove_entry(right, first.id)
    with pytest.raises(Conflict, match="of the bench left"):
        queue.add_entry(right, campaign("left"), "anna")


def test_two_benches_run_at_once_and_one_bench_does_not_run_twice(
    benches: tuple[Store, Store], database: Path | str
) -> None:
    left, right = benches
    again = Store.open(database, "left")
    with left.exclusive(), right.exclusive():
        with pytest.raises(StoreBusy, match="on the bench left"), again.exclusive():
            pass
        with pytest.raises(StoreBusy), again.exclusive(everywhere=True):
            pass
        assert again.in_use()
        assert again.in_use("right")
    assert not again.in_use("right")
    with again.exclusive(everywhere=True), pytest.raises(StoreBusy), right.exclusive():
        pass
    again.close()


def test_a_campaign_stays_on_its_bench_and_a_killed_run_there_is_not_ended_from_elsewhere(
    benches: tuple[Store, Store],
) -> None:
    left, right = benches
    number = left.add_campaign(campaign("shared"))
    scan = left.scans(number)[0].id
    left.set_phase(scan, "running")
    with pytest.raises(CampaignError, match="bench left"):
        right.add_campaign(campaign("shared"))
    right.end_stale_scans()
    assert right.scan(scan).phase == "running"
    assert right.benches() == {number: "left"}
    with left.exclusive():
        right.request(scan, "abort")
    left.end_stale_scans()
    assert right.scan(scan).outcome == "aborted"


def test_a_name_that_cannot_be_one_of_a_bench_is_refused(database: Path | str) -> None:
    with pytest.raises(InputError, match="lower-case"):
        Store.open(database, "../left")
