"""The K10CR1 driver moves a mount over a serial line without checksums and survives what lines and mounts do."""

import asyncio
import logging
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator

import pytest
import thorlabs_apt_protocol as thorlabs

from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    DriverError,
    ProtocolError,
)
from drivers.interfaces import RotationStage, StagePhase
from drivers.k10cr1 import ACCELERATION_UNITS, COUNTS_PER_DEGREE, K10CR1, VELOCITY_UNITS
from drivers.stage import Mounting
from simulators.clock import SimulatedClock
from simulators.faults import FaultScript
from simulators.k10cr1 import SimulatedK10CR1
from simulators.motion import Axis

STEP = 1 / COUNTS_PER_DEGREE
"""Degrees."""


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
    """A simulated mount, and the driver connected to it."""

    def __init__(self) -> None:
        self.clock = HeldClock()
        self.axis = Axis(self.clock, start=12.0, velocity=10, acceleration=10, limits=(-10, 100))
        self.simulator = SimulatedK10CR1(self.axis, serial_number=55123456)
        self.url = self.simulator.start()
        self.stage = K10CR1("sample stage", self.url, self.clock, timeout=0.1)

    def befall(self, script: str, seed: int = 0) -> None:
        """Let faults befall the requests from now on."""
        self.simulator.script = FaultScript.parse(script, seed)

    def run(self, scenario: Callable[[K10CR1], Awaitable[None]], *, homed: bool = True) -> None:
        async def whole() -> None:
            await self.stage.open()
            if homed:
                await self.stage.home()
            try:
                await scenario(self.stage)
            finally:
                await self.stage.close()

        asyncio.run(whole())


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.simulator.close()


def test_its_units_are_the_published_ones() -> None:
    units = [COUNTS_PER_DEGREE, VELOCITY_UNITS, ACCELERATION_UNITS]
    assert units == pytest.approx([136533.33333333, 7329109.333, 1502.0], rel=3e-5)


def test_it_is_a_rotation_stage_with_a_name_for_the_operator(bench: Bench) -> None:
    stage: RotationStage = bench.stage
    assert stage.limits == (-5.0, 90.0)

    async def scenario(stage: K10CR1) -> None:
        assert await stage.identity() == "Thorlabs K10CR1 55123456 firmware 1.0.2"

    bench.run(scenario)


def test_a_move_ends_where_it_should_and_takes_its_time(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        assert (await stage.state()).phase is StagePhase.READY
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == pytest.approx(60.0, abs=STEP)
        # 60 degrees at 10 degrees/s with ramps at 10 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 10 + 10 / 10, abs=0.1)
        assert bench.axis.position() == pytest.approx(60.0, abs=STEP)
        assert await stage.position() == pytest.approx(60.0, abs=STEP)

    bench.run(scenario)


def test_a_mount_that_was_not_homed_says_so_and_does_not_move(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 12.0

    bench.run(scenario, homed=False)


def test_homing_ends_although_the_mount_woke_up_with_a_velocity_of_hours(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        begin = bench.clock.now()
        await stage.home()
        assert bench.clock.now() - begin < 10
        assert await stage.position() == 0.0
        assert bench.axis.position() == 0.0

    bench.run(scenario, homed=False)


def test_homing_twice_searches_the_mark_twice(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.drift(0.5)  # steps lost, and not known
        assert await stage.position() == pytest.approx(0.5, abs=STEP)
        await stage.home()
        assert await stage.move_to(20.0) == pytest.approx(20.0, abs=STEP)
        assert bench.axis.position() == pytest.approx(20.0, abs=STEP)

    bench.run(scenario)


def test_homing_that_never_began_is_not_taken_for_done(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        await stage.move_to(20.0)
        # 1-2 status, 3-4 velocity with its query, 5-6 velocity, 7-8 homing, 9-12 set and read back
        bench.befall("at 13 lose-request")
        with pytest.raises(DeviceTimeout, match="did not begin"):
            await stage.home()
        assert bench.axis.position() == pytest.approx(20.0, abs=STEP)

    bench.run(scenario)


@pytest.mark.parametrize("angle", [-5.1, 90.1, float("nan")])
def test_nothing_is_sent_for_an_angle_outside_the_limits(bench: Bench, angle: float) -> None:
    async def scenario(stage: K10CR1) -> None:
        asked = bench.simulator.script.requests
        with pytest.raises(DeviceRefused, match=r"sample stage.*-5° to 90°"):
            await stage.move_to(angle)
        assert bench.simulator.script.requests == asked

    bench.run(scenario)


def test_a_mount_turned_round_and_shifted_on_the_bench_moves_the_right_way(bench: Bench) -> None:
    mounting = Mounting(zero=50.0, direction=-1)
    bench.stage = K10CR1("sample stage", bench.url, bench.clock, mounting=mounting, timeout=0.1)

    async def scenario(stage: K10CR1) -> None:
        assert await stage.move_to(20.0) == pytest.approx(20.0, abs=STEP)
        assert bench.axis.position() == pytest.approx(30.0, abs=STEP)

    bench.run(scenario)


def test_a_velocity_is_set_and_one_that_the_mount_does_not_take_is_refused(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        await stage.set_velocity(2.0)
        begin = bench.clock.now()
        await stage.move_to(20.0)
        assert bench.clock.now() - begin == pytest.approx(20 / 2 + 2 / 10, abs=0.1)
        with pytest.raises(DeviceRefused, match="keeps"):
            await stage.set_velocity(30.0)
        assert stage.velocity == 2.0
        for velocity in (0.0, -1.0, float("nan")):
            with pytest.raises(DeviceRefused, match="more than 0"):
                await stage.set_velocity(velocity)

    bench.run(scenario)


def test_an_absent_mount_is_named_with_its_address_and_leaves_no_thread(bench: Bench) -> None:
    bench.simulator.close()
    port = bench.url.rpartition(":")[2]
    with pytest.raises(DeviceNotFound, match=rf"sample stage.*{port}.*check its power"):
        asyncio.run(bench.stage.open())
    for thread in threading.enumerate():
        if thread.name.startswith("sample stage"):
            thread.join(timeout=1.0)
            assert not thread.is_alive()


def test_a_line_on_which_nobody_answers_is_not_found(bench: Bench) -> None:
    bench.befall("from 1 lose-reply")
    with pytest.raises(DeviceNotFound, match="no K10CR1 answers"):
        asyncio.run(bench.stage.open())


def test_the_wrong_mount_is_not_driven(bench: Bench) -> None:
    stage = K10CR1("sample stage", bench.url, bench.clock, serial_number=55999999, timeout=0.1)
    with pytest.raises(ProtocolError, match="55123456 instead of 55999999"):
        asyncio.run(stage.open())


def test_unplugging_is_noticed_and_the_mount_works_again_after_reopening(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        await stage.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await stage.position()
        bench.simulator.start()
        await stage.open()
        assert await stage.move_to(5.0) == pytest.approx(5.0, abs=STEP)

    bench.run(scenario)


@pytest.mark.parametrize(
    "fault", ["lose-reply", "duplicate", "corrupt", "truncate", "garbage", "split", "merge", "foreign", "delay 0.12 s"]
)
def test_one_bad_reply_in_a_while_costs_no_point_and_puts_the_mount_nowhere_else(bench: Bench, fault: str) -> None:
    async def scenario(stage: K10CR1) -> None:
        for seed, first in enumerate((1, 2, 4, 7)):
            bench.befall(f"from {first} every 9 {fault}", seed)
            for target in (10.0, 40.0, 3.0):
                assert await stage.move_to(target) == pytest.approx(target, abs=STEP)
                assert bench.axis.position() == pytest.approx(target, abs=STEP)

    bench.run(scenario)


def test_a_question_that_is_asked_again_leaves_a_line_in_the_log(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(stage: K10CR1) -> None:
        caplog.clear()
        bench.befall("at 1 lose-reply")
        assert await stage.position() == 0.0
        (record,) = caplog.records
        assert record.levelno == logging.WARNING
        assert "attempt 2 of 3" in record.message

    bench.run(scenario)


@pytest.mark.parametrize(
    "fault", ["lose-request", "lose-reply", "corrupt", "truncate", "garbage", "merge", "foreign", "stall 0.3 s"]
)
def test_a_line_on_which_half_is_bad_gives_a_right_angle_or_an_error_and_works_when_it_is_good_again(
    bench: Bench, fault: str
) -> None:
    async def scenario(stage: K10CR1) -> None:
        for seed, target in enumerate((10.0, 40.0, 3.0)):
            bench.befall(f"every 2 {fault}", seed)
            try:
                assert await stage.move_to(target) == pytest.approx(target, abs=STEP)
                assert bench.axis.position() == pytest.approx(target, abs=STEP)
            except DriverError:
                bench.befall("")
                await bench.clock.sleep(10.0)  # it may be on its way
        bench.befall("")
        await asyncio.sleep(0.3)
        assert await stage.move_to(25.0) == pytest.approx(25.0, abs=STEP)

    bench.run(scenario)


def test_a_silent_mount_is_a_timeout_and_its_late_reply_is_not_taken_for_the_next(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("from 1 lose-reply")
        with pytest.raises(DeviceTimeout, match="no whole reply"):
            await stage.position()
        bench.befall("at 1 delay 0.4 s")
        with pytest.raises(DeviceTimeout):
            await stage.state()
        assert await stage.move_to(3.0) == pytest.approx(3.0, abs=STEP)

    bench.run(scenario)


def test_readings_that_never_agree_are_no_angle(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("from 1 drift")
        with pytest.raises(ProtocolError, match="something else each time"):
            await stage.position()

    bench.run(scenario)


def test_a_move_that_is_lost_on_the_way_is_not_sent_again_and_not_taken_for_an_arrival(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("at 5 lose-request")  # after two readings of the position and two of the state
        with pytest.raises(DeviceTimeout, match="did not begin to move"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 0.0
        assert await stage.move_to(30.0) == pytest.approx(30.0, abs=STEP)

    bench.run(scenario)


def test_a_refused_move_is_told_with_the_mounts_own_words(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("at 1 refuse")
        with pytest.raises(DeviceRefused, match="refused message 0x0453: refused by a fault script"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 0.0
        assert await stage.move_to(30.0) == pytest.approx(30.0, abs=STEP)

    bench.run(scenario)


def test_a_jam_stops_the_move_with_its_name_and_homing_clears_it(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("at 8 jam")
        with pytest.raises(DeviceFault, match="motion error"):
            await stage.move_to(80.0)
        assert (await stage.state()).phase is StagePhase.FAULT
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=STEP)

    bench.run(scenario)


@pytest.mark.parametrize("request_number", range(1, 12))
def test_a_power_cut_at_any_moment_of_a_move_is_noticed_and_homing_mends_it(bench: Bench, request_number: int) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall(f"at {request_number} restart")
        with pytest.raises((DeviceFault, DeviceRefused), match="home it"):
            await stage.move_to(30.0)
        await bench.clock.sleep(2.0)
        assert not bench.axis.moving()
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
        await stage.home()
        assert await stage.move_to(30.0) == pytest.approx(30.0, abs=STEP)
        assert bench.axis.position() == pytest.approx(30.0, abs=STEP)

    bench.run(scenario)


def test_a_mount_that_crawls_is_given_up_in_bounded_time(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.slow()
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="still moving"):
            await stage.move_to(80.0)
        assert bench.clock.now() - begin < 30
        with pytest.raises(DeviceRefused, match="stop it first"):
            await stage.move_to(10.0)

    bench.run(scenario)


@pytest.mark.parametrize("fault", ["", "at 1 lose-request"])
def test_a_move_can_be_cancelled_and_stopped_where_it_is_even_if_the_first_stop_is_lost(
    bench: Bench, fault: str
) -> None:
    async def scenario(stage: K10CR1) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        assert bench.axis.moving()
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        bench.befall(fault)
        await stage.stop()
        await bench.clock.sleep(2.0)
        state = await stage.state()
        assert state.phase is StagePhase.READY
        assert state.position < 40.0
        assert state.position == pytest.approx(bench.axis.position(), abs=STEP), "it braked and lost no steps"
        await stage.stop()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=STEP)

    bench.run(scenario)


def test_a_stop_overtakes_a_question_that_waits_for_its_answer(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.befall("at 1 lose-reply")
        question = asyncio.create_task(stage.position())
        await asyncio.sleep(0.03)
        assert not question.done()
        stop = asyncio.create_task(stage.stop())
        await asyncio.sleep(0.03)
        assert not question.done()
        await bench.clock.sleep(1.5)
        assert not bench.axis.moving()
        await asyncio.gather(question, stop)
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario)


def test_homing_stops_what_is_under_way_first(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        move.cancel()
        bench.clock.released.set()
        await stage.home()
        assert await stage.position() == 0.0

    bench.run(scenario)


def test_what_the_mount_sends_unasked_is_passed_over(bench: Bench) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.answer(thorlabs.hw_start_updatemsgs(0x50, 0x01))
        assert await stage.move_to(12.0) == pytest.approx(12.0, abs=STEP)
        assert "55123456" in await stage.identity()

    bench.run(scenario)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_real_tty_works_and_its_unplugging_is_noticed_and_mended(bench: Bench) -> None:
    stage = K10CR1("sample stage", bench.simulator.start_pty(), bench.clock, timeout=0.3)

    async def scenario() -> None:
        await stage.open()
        await stage.home()
        assert await stage.move_to(20.0) == pytest.approx(20.0, abs=STEP)
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected):
            await stage.position()
        await stage.close()
        with pytest.raises(DeviceNotFound):
            await stage.open()
        bench.simulator.start_pty()
        await stage.open()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=STEP)
        await stage.close()

    asyncio.run(scenario())
