"""What is special about an AZ driver: Modbus on three kinds of line, an absolute encoder, alarms."""

import asyncio
import gc
import os
import socket
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    ProtocolError,
)
from drivers.interfaces import StagePhase
from drivers.oriental_az import OrientalAZ
from simulators.devices.clock import SimulatedClock
from tests.stage_bench import FAMILIES, Bench, opened, until

LINES = ["tcp", "rtu", "terminal"]
on_one_line = pytest.mark.parametrize("line", ["tcp"])
"""For what has nothing to do with the line."""
FAMILY = {"tcp": "AZ on TCP", "rtu": "AZ on RTU", "terminal": "AZ on RTU"}


class AZBench(Bench[OrientalAZ]):
    """A simulated stage on one kind of line, and the driver connected to it."""

    def __init__(self, line: str) -> None:
        if line == "terminal":
            pytest.importorskip("termios")
        super().__init__(
            FAMILIES[FAMILY[line]],
            start=-12.0,
            velocity=1.0,
            acceleration=1.0,
            limits=(-95.0, 180.0),
            socket=line != "terminal",
        )
        self.targets: list[float] = []
        """Where the axis has been sent."""
        self.once_moving: Callable[[], None] = lambda: None
        """Called as soon as the axis moves."""
        move = self.axis.move

        def noted_move(target: float) -> None:
            self.targets.append(target)
            move(target)
            self.once_moving()

        self.axis.move = noted_move

    def run(
        self,
        scenario: Callable[[OrientalAZ], Awaitable[None]],
        stage: OrientalAZ | None = None,
        *,
        homed: bool = False,  # it knows its angle all the same
    ) -> None:
        super().run(scenario, stage, homed=homed)

    async def asked(self, requests: int) -> None:
        """Wait until the present script has seen so many requests."""
        await until(lambda: self.simulator.script.requests >= requests)


@pytest.fixture(params=LINES)
def line(request: pytest.FixtureRequest) -> str:
    line: str = request.param
    return line


@pytest.fixture
def bench(line: str) -> Iterator[AZBench]:
    bench = AZBench(line)
    yield bench
    bench.simulator.close()


def test_moves_end_where_they_should_on_both_sides_of_zero_and_take_their_time(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        assert (await stage.state()).phase is StagePhase.READY
        assert await stage.position() == pytest.approx(-12.0)
        begin = bench.clock.now()
        assert await stage.move_to(-72.0) == pytest.approx(-72.0)
        # 60 degrees at 30 degrees/s with ramps at 60 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 30 + 30 / 60, abs=0.1)
        assert await stage.move_to(170.0) == pytest.approx(170.0)
        assert bench.axis.position() == pytest.approx(170.0)
        assert "Oriental Motor" in await stage.identity()

    bench.run(scenario)


@on_one_line
def test_a_velocity_that_is_set_is_the_one_of_the_next_motion(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        await stage.set_velocity(6.0)
        begin = bench.clock.now()
        await stage.move_to(48.0)
        # 60 degrees at 6 degrees/s with ramps at 60 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 6 + 6 / 60, abs=0.1)
        for beyond in (0.001, 1e9):
            with pytest.raises(DeviceRefused, match=r"sample stage.*ask for 0\.01°/s to 40000°/s"):
                await stage.set_velocity(beyond)
        assert stage.velocity == 6.0

    bench.run(scenario)


def test_a_host_that_does_not_exist_is_not_found() -> None:
    stage = OrientalAZ("detector stage", "tcp://no-such-host.invalid:502", SimulatedClock(), timeout=0.3)
    with pytest.raises(DeviceNotFound, match=r"no-such-host\.invalid:502"):
        asyncio.run(stage.open())


@pytest.mark.parametrize(
    "url", ["", "COM3", "tcp://host", "tcp://host:port", "tcp://host:99999", "rtu://", "ftp://h:1"]
)
def test_an_address_that_cannot_be_one_is_refused_before_anything_is_opened(url: str) -> None:
    with pytest.raises(ValueError, match=r"detector stage.*tcp://host:port"):
        OrientalAZ("detector stage", url, SimulatedClock())


@pytest.mark.parametrize("url", ["rtu:///no/such/port", "rtu+nonsense://x", "hwgrep://SER=no-such-adapter"])
def test_a_serial_port_that_does_not_exist_is_not_found(url: str) -> None:
    with pytest.raises(DeviceNotFound, match="detector stage"):
        asyncio.run(OrientalAZ("detector stage", url, SimulatedClock(), timeout=0.1).open())


@pytest.mark.parametrize("scheme", ["tcp", "rtu+socket"])
def test_something_that_does_not_answer_is_not_found(scheme: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"{scheme}://127.0.0.1:{server.getsockname()[1]}"
        stage = OrientalAZ("detector stage", url, SimulatedClock(), timeout=0.05)
        with pytest.raises(DeviceNotFound, match="no AZ driver"):
            asyncio.run(stage.open())


def test_a_wrong_unit_is_not_found(bench: AZBench) -> None:
    with pytest.raises(DeviceNotFound, match=r"unit 9.*the address and the unit"):
        asyncio.run(bench.driver(unit=9).open())


def test_unplugging_in_the_middle_of_a_reply_is_noticed(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.befall("at 1 unplug 0.05 s")
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        await opened(stage)
        assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario)


def test_opening_and_closing_leaves_nothing_behind(bench: AZBench) -> None:
    descriptors = Path("/proc/self/fd")
    if not descriptors.exists():
        pytest.skip("the system does not tell what is open")

    async def open_and_close() -> None:
        stage, wrong = bench.driver(), bench.driver(unit=9, timeout=0.02)
        for _ in range(2):
            await stage.open()
            await stage.open()
            await stage.close()
            await stage.close()
            with pytest.raises(DeviceNotFound):
                await wrong.open()
            opening = asyncio.create_task(stage.open())
            await asyncio.sleep(0.001)
            opening.cancel()
            await asyncio.gather(opening, return_exceptions=True)
            await stage.close()

    def count() -> int:
        gc.collect()
        return len(os.listdir(descriptors))

    asyncio.run(open_and_close())
    time.sleep(0.05)
    once = count()
    asyncio.run(open_and_close())
    deadline = time.monotonic() + 60
    while count() > once:  # the simulator closes its end in a thread of its own
        assert time.monotonic() < deadline
        time.sleep(0.01)


# the line


@pytest.mark.parametrize("fault", ["lose-request", "lose-reply", "stall 0.08 s", "truncate", "merge", "delay 0.5 s"])
def test_a_question_that_is_not_answered_is_asked_again_and_that_is_logged(
    bench: AZBench, caplog: pytest.LogCaptureFixture, fault: str
) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.befall(f"at 1 {fault}")
        assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario, bench.driver(timeout=0.3))
    assert "trying again (attempt 2 of 3)" in caplog.text


def test_a_device_that_stays_silent_is_a_timeout_and_answers_again_later(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        for _ in range(3):
            bench.befall("from 1 lose-request")
            with pytest.raises(DeviceTimeout, match="no whole answer"):
                await stage.position()
            await bench.asked(3)
            assert bench.simulator.script.requests == 3
        bench.befall("")
        assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario)


def test_a_position_of_the_past_is_never_taken_for_the_present_one(bench: AZBench) -> None:
    """Each time the stage stands elsewhere; the reply that tells where it stood before comes late, twice or again."""

    async def scenario(stage: OrientalAZ) -> None:
        for seed in range(3):
            for fault in ("foreign", "duplicate", "delay 0.4 s", "merge"):
                bench.befall(f"at 1 {fault}", seed)
                asking = asyncio.create_task(stage.position())
                await bench.asked(1)
                bench.axis.move(bench.axis.position() + 1.0)
                bench.clock.advance_to(bench.clock.now() + 10.0)
                await asking
                assert await stage.position() == pytest.approx(bench.axis.position())

    bench.run(scenario, bench.driver(timeout=0.3))


@pytest.mark.parametrize("line", ["rtu", "terminal"])
def test_a_reply_of_the_past_in_front_of_the_right_one_is_told_apart_without_a_number(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        for seed in range(20):
            await stage.position()
            bench.axis.move(bench.axis.position() + 1.0)
            bench.clock.advance_to(bench.clock.now() + 10.0)
            bench.befall("at 1 foreign" + (" \n at 1 split" if seed % 2 else ""), seed)
            assert await stage.position() == pytest.approx(bench.axis.position())

    bench.run(scenario, bench.driver(timeout=0.3))


# the stage


@pytest.mark.parametrize("fault", ["lose-reply", "duplicate", "foreign", "merge", "delay 0.12 s", "split"])
def test_a_motion_whose_reply_is_lost_or_late_is_made_once(bench: AZBench, fault: str) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        for request in range(1, 20, 3):
            bench.targets.clear()
            bench.befall(f"at {request} {fault}")
            target = 20.0 if request % 2 else 21.0
            assert await stage.move_to(target) == pytest.approx(target)
            assert bench.targets == [pytest.approx(target)]

    bench.run(scenario)


def test_a_motion_whose_request_is_lost_is_not_made_and_that_is_told(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        # the request that carries the motion: an echo goes with each question on a serial line
        number = 4 if bench.url.startswith("tcp") else 7
        bench.befall(f"at {number} lose-request")
        with pytest.raises(DeviceTimeout, match="no whole answer"):
            await stage.move_to(20.0)
        assert bench.targets == []
        assert await stage.move_to(20.0) == pytest.approx(20.0)

    bench.run(scenario, bench.driver(timeout=0.5))


def test_a_stage_that_was_switched_off_still_knows_its_angle(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        await stage.move_to(20.0)
        bench.simulator.restart()
        assert await stage.position() == pytest.approx(20.0)
        assert await stage.move_to(30.0) == pytest.approx(30.0)

    bench.run(scenario)


def test_a_stage_that_is_switched_off_in_a_move_does_not_pass_for_arrived(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.once_moving = bench.simulator.restart  # before it is first looked at
        with pytest.raises((DeviceFault, ProtocolError), match=r"came to rest|did not take"):
            await stage.move_to(20.0)

    bench.run(scenario)


def test_an_alarm_is_told_in_words_and_homing_resets_it(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.simulator.fail(0x30)
        assert (await stage.state()).message == "alarm 30: overload"
        with pytest.raises(DeviceFault, match="overload"):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == pytest.approx(10.0)

    bench.run(scenario)


@on_one_line
def test_an_alarm_in_the_middle_of_a_move_ends_it(bench: AZBench) -> None:
    bench.stage.limits = (-90.0, 190.0)

    async def scenario(stage: OrientalAZ) -> None:
        with pytest.raises(DeviceFault, match="software overtravel"):
            await stage.move_to(185.0)

    bench.run(scenario)


# stopping


def until_first_yield(coroutine: Coroutine[Any, Any, None]) -> Callable[[], Awaitable[None]]:
    """Run `coroutine` up to its first yield, and return what runs the rest."""
    waits_for = coroutine.send(None)

    async def rest() -> None:
        nonlocal waits_for
        try:
            while True:
                if waits_for is None:
                    await asyncio.sleep(0)
                else:
                    waits_for._asyncio_future_blocking = False
                    await asyncio.wait([waits_for])
                waits_for = coroutine.send(None)
        except StopIteration:
            return

    return rest


def brakes(bench: AZBench) -> bool:
    """Wait in real time, and with the event loop standing still, until the axis brakes."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if bench.axis._target < 80.0:
            return True
        time.sleep(0.001)
    return False


def test_a_stop_is_on_the_wire_before_anything_else_runs(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.axis.move(90.0)
        await bench.clock.sleep(5.0)
        rest = until_first_yield(stage.stop())
        assert brakes(bench)
        await rest()
        await bench.clock.sleep(5.0)
        assert (await stage.state()).phase is StagePhase.READY

    bench.run(scenario)


def test_a_stop_overtakes_a_question_that_waits_for_its_reply(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.axis.move(90.0)
        await bench.clock.sleep(5.0)
        bench.befall("at 1 delay 0.2 s")
        asking = asyncio.create_task(stage.position())
        await bench.asked(1)
        rest = until_first_yield(stage.stop())
        assert brakes(bench)
        await rest()
        await bench.clock.sleep(5.0)
        assert await asking < 80.0
        assert (await stage.state()).phase is StagePhase.READY

    bench.run(scenario, bench.driver(timeout=0.5))


def test_a_stop_during_a_stall_brakes_as_soon_as_the_device_listens_again(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.axis.move(90.0)
        await bench.clock.sleep(5.0)
        bench.befall("at 1 stall 0.15 s")
        asking = asyncio.create_task(stage.position())
        await bench.asked(1)
        begin = bench.clock.now()
        await stage.stop()
        assert brakes(bench)
        assert bench.clock.now() - begin < 0.1
        await asking

    bench.run(scenario)


@pytest.mark.parametrize("fault", ["lose-request", "lose-reply", "merge", "foreign", "refuse", "duplicate"])
def test_a_stop_is_made_sure_of_on_a_bad_line(bench: AZBench, fault: str) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.axis.move(90.0)
        await bench.clock.sleep(5.0)
        bench.befall(f"at 1 {fault}")
        await stage.stop()
        assert brakes(bench)
        await bench.clock.sleep(5.0)
        assert await stage.move_to(3.0) == pytest.approx(3.0)

    bench.run(scenario)


def test_a_cancelled_request_does_not_answer_the_next_one(bench: AZBench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        for yields in range(20):
            state = asyncio.create_task(stage.state())
            for _ in range(yields):
                await asyncio.sleep(0)
            state.cancel()
            assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario)
