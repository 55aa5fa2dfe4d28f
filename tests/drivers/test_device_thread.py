"""Blocking calls of a device neither interleave nor get lost."""

import asyncio
import threading
import time

import pytest

from drivers.device_thread import DeviceThread


def test_a_cancelled_call_runs_to_its_end_before_the_next_begins() -> None:
    events: list[str] = []
    started, released = threading.Event(), threading.Event()

    def slow() -> None:
        events.append("slow begins")
        started.set()
        released.wait()
        events.append("slow ends")

    async def scenario() -> None:
        thread = DeviceThread("device")
        call = asyncio.create_task(thread.run(slow))
        await asyncio.to_thread(started.wait)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        following = asyncio.create_task(thread.run(events.append, "next"))
        await asyncio.sleep(0.01)
        assert events == ["slow begins"]
        released.set()
        await following
        await thread.finish(lambda: events.append("closed"))

    asyncio.run(scenario())
    assert events == ["slow begins", "slow ends", "next", "closed"]


def test_a_call_that_was_cancelled_while_it_waited_is_never_made() -> None:
    events: list[str] = []

    async def scenario() -> None:
        thread, released = DeviceThread("device"), threading.Event()
        first = asyncio.create_task(thread.run(released.wait))
        second = asyncio.create_task(thread.run(events.append, "moved"))
        await asyncio.sleep(0.01)
        second.cancel()
        with pytest.raises(asyncio.CancelledError):
            await second
        released.set()
        await first
        await thread.finish(lambda: None)

    asyncio.run(scenario())
    assert events == []


def test_the_event_loop_goes_on_while_a_device_blocks() -> None:
    async def scenario() -> bool:
        thread, released = DeviceThread("device"), threading.Event()
        call = asyncio.create_task(thread.run(released.wait, 60))
        for _ in range(4):
            await asyncio.sleep(0.001)
            assert not call.done()
        released.set()
        await thread.finish(lambda: None)
        return await call

    assert asyncio.run(scenario())


def test_a_finished_thread_starts_again_when_the_device_is_reopened() -> None:
    async def scenario() -> tuple[str, str]:
        thread = DeviceThread("device")
        await thread.finish(lambda: None)
        first = await thread.run(lambda: threading.current_thread().name)
        await thread.finish(lambda: None)
        return first, await thread.run(lambda: threading.current_thread().name)

    first, second = asyncio.run(scenario())
    assert first.startswith("device")
    assert second.startswith("device")


def test_a_device_is_let_go_also_when_who_closes_it_gives_up() -> None:
    events: list[str] = []

    async def scenario() -> None:
        thread, released = DeviceThread("device"), threading.Event()
        call = asyncio.create_task(thread.run(released.wait))
        await asyncio.sleep(0.01)
        closing = asyncio.create_task(thread.finish(lambda: events.append("closed")))
        await asyncio.sleep(0.01)
        closing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await closing
        released.set()
        await call
        await thread.finish(lambda: None)

    asyncio.run(scenario())
    assert events == ["closed"]


def test_two_may_close_a_device_at_once() -> None:
    events: list[str] = []

    async def scenario() -> None:
        thread = DeviceThread("device")
        call = asyncio.create_task(thread.run(time.sleep, 0.02))
        await asyncio.sleep(0.01)
        await asyncio.gather(*(thread.finish(lambda: events.append("closed")) for _ in range(2)))
        await call

    asyncio.run(scenario())
    assert events == ["closed", "closed"]
