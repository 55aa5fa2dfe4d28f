"""The SMC100 driver moves a stage over a serial line and survives what lines and stages do."""

import asyncio
import os
import select
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator

import pytest

from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    ProtocolError,
)
from drivers.interfaces import RotationStage, StagePhase
from drivers.smc100 import SMC100
from simulators.clock import SimulatedClock
from simulators.motion import Axis
from simulators.smc100 import SimulatedSMC100


class HeldClock(SimulatedClock):
    """A clock on which the next wait lasts until the test lets go, so that it can act in the middle of a move."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: asyncio.Event | None = None
        self.released = asyncio.Event()

    def hold(self) -> asyncio.Event:
        """Hold the next wait and return the event that tells when it has begun."""
        self.waiting, self.released = asyncio.Event(), asyncio.Event()
        return self.waiting

    async def sleep(self, seconds: float) -> None:
        if self.waiting is not None:
            waiting, self.waiting = self.waiting, None
            self.advance_to(self.now() + seconds / 2)
            waiting.set()
            await self.released.wait()
        await super().sleep(seconds)


class Bench:
    """A simulated stage, and the driver connected to it."""

    def __init__(self) -> None:
        self.clock = HeldClock()
        self.axis = Axis(self.clock, start=12.0, velocity=20, acceleration=40, limits=(-10, 100))
        self.simulator = SimulatedSMC100(self.axis)
        self.url = self.simulator.start()
        self.stage = SMC100("sample stage", self.url, self.clock, timeout=0.1)

    def run(self, scenario: Callable[[SMC100], Awaitable[None]], *, homed: bool = True) -> None:
        async def whole() -> None:
            await self.stage.open()
            if homed:
                await self.stage.home()
            await scenario(self.stage)
            await self.stage.close()

        asyncio.run(whole())


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.simulator.close()


def test_it_is_a_rotation_stage(bench: Bench) -> None:
    stage: RotationStage = bench.stage
    assert stage.limits == (-5.0, 90.0)


def test_a_move_ends_where_it_should_and_takes_its_time(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        assert (await stage.state()).phase is StagePhase.READY
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == 60.0
        # 60 degrees at 20 degrees/s with ramps at 40 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 20 + 20 / 40, abs=0.1)
        assert bench.axis.position() == 60.0
        assert await stage.position() == 60.0
        assert (await stage.state()).phase is StagePhase.READY
        assert "SMC100" in await stage.identity()

    bench.run(scenario)


def test_a_stage_that_was_not_homed_says_so_and_does_not_move(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 12.0

    bench.run(scenario, homed=False)


def test_homing_twice_searches_the_mark_twice(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        await stage.move_to(45.0)
        await stage.home()
        assert await stage.position() == 0.0
        assert (await stage.state()).phase is StagePhase.READY

    bench.run(scenario)


@pytest.mark.parametrize("angle", [-5.1, 90.1, float("nan")])
def test_nothing_is_sent_for_an_angle_outside_the_limits(bench: Bench, angle: float) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.wire.silent = True  # a single byte sent would now end in a timeout
        with pytest.raises(DeviceRefused, match=r"sample stage.*-5° to 90°"):
            await stage.move_to(angle)

    bench.run(scenario)


def test_the_controllers_own_limits_are_reported_in_words(bench: Bench) -> None:
    bench.stage.limits = (-5.0, 120.0)

    async def scenario(stage: SMC100) -> None:
        with pytest.raises(DeviceRefused, match=r"PA110.*out of its own limits"):
            await stage.move_to(110.0)

    bench.run(scenario)


def test_an_absent_device_is_named_with_its_address(bench: Bench) -> None:
    bench.simulator.close()
    port = bench.url.rpartition(":")[2]
    with pytest.raises(DeviceNotFound, match=rf"sample stage.*{port}.*check its power"):
        asyncio.run(bench.stage.open())


def test_an_address_that_pyserial_does_not_know_is_not_found(bench: Bench) -> None:
    with pytest.raises(DeviceNotFound, match="nonsense://x"):
        asyncio.run(SMC100("sample stage", "nonsense://x", bench.clock).open())


def test_a_line_on_which_nobody_answers_is_not_found(bench: Bench) -> None:
    bench.simulator.wire.silent = True
    with pytest.raises(DeviceNotFound, match="address 1"):
        asyncio.run(bench.stage.open())


def test_unplugging_is_noticed_and_the_stage_works_again_after_reopening(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        await stage.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await stage.position()
        bench.simulator.start()
        await stage.open()
        assert await stage.move_to(5.0) == 5.0

    bench.run(scenario)


def test_a_silent_device_is_a_timeout_and_its_late_reply_is_not_taken_for_the_next(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.wire.silent = True
        with pytest.raises(DeviceTimeout, match="no whole reply"):
            await stage.position()
        bench.simulator.wire.silent = False
        bench.simulator.wire.late = 0.15
        with pytest.raises(DeviceTimeout):
            await stage.state()
        bench.simulator.wire.late = 0.0
        assert await stage.position() == 0.0

    bench.run(scenario)


def test_noise_on_the_line_is_no_angle(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.wire.corrupt = True
        with pytest.raises(ProtocolError, match="is no answer to"):
            await stage.position()

    bench.run(scenario)


def test_replies_that_come_byte_by_byte_are_put_together(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.wire.split = True
        assert await stage.move_to(7.5) == 7.5

    bench.run(scenario)


def test_a_following_error_stops_the_move_with_its_name_and_homing_clears_it(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.fail_beyond(3.0, 0x20)
        with pytest.raises(DeviceFault, match="following error"):
            await stage.move_to(80.0)
        assert (await stage.state()).phase is StagePhase.FAULT
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_a_stage_that_crawls_is_given_up_in_bounded_time(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.axis.velocity = 0.1
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="still moving"):
            await stage.move_to(80.0)
        assert bench.clock.now() - begin < 15

    bench.run(scenario)


def test_a_move_can_be_cancelled_and_stopped_where_it_is(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        assert bench.axis.moving()
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        await stage.stop()
        await bench.clock.sleep(5.0)
        state = await stage.state()
        assert state.phase is StagePhase.READY
        assert state.position < 80.0
        await stage.stop()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_a_stop_from_elsewhere_is_not_taken_for_an_arrival(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        await stage.stop()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_real_tty_works_and_its_unplugging_is_noticed(bench: Bench) -> None:
    ours, theirs = os.openpty()

    unplugged = threading.Event()

    def serve() -> None:
        while not unplugged.is_set():
            if select.select([ours], [], [], 0.01)[0]:
                os.write(ours, bench.simulator._receive(os.read(ours, 1024)))

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    stage = SMC100("sample stage", os.ttyname(theirs), bench.clock, timeout=0.3)

    async def scenario() -> None:
        await stage.open()
        await stage.home()
        assert await stage.move_to(20.0) == 20.0
        unplugged.set()
        server.join()
        os.close(ours)
        with pytest.raises(DeviceDisconnected):
            await stage.position()
        await stage.close()
        os.close(theirs)

    asyncio.run(scenario())
