"""The SMC100 driver moves a stage over a serial line and survives what lines and stages do."""

import asyncio
import contextlib
import sys
from collections.abc import Awaitable, Callable, Iterator

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

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
from drivers.smc100 import SMC100
from simulators.clock import SimulatedClock
from simulators.faults import Fault, FaultScript, Kind
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

    def befall(self, script: str, seed: int = 0) -> None:
        """Let faults befall the requests from now on."""
        self.simulator.script = FaultScript.parse(script, seed)

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
        asked = bench.simulator.script.requests
        with pytest.raises(DeviceRefused, match=r"sample stage.*-5° to 90°"):
            await stage.move_to(angle)
        assert bench.simulator.script.requests == asked

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
    bench.befall("from 1 lose-reply")
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
        bench.befall("from 1 lose-reply")
        with pytest.raises(DeviceTimeout, match="no whole reply"):
            await stage.position()
        bench.befall("at 1 delay 0.35 s")
        with pytest.raises(DeviceTimeout):
            await stage.state()
        assert await stage.move_to(3.0) == 3.0

    bench.run(scenario)


def test_noise_on_the_line_is_no_angle(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("from 1 garbage")
        with pytest.raises(ProtocolError, match="is no answer to"):
            await stage.position()

    bench.run(scenario)


def test_replies_that_come_byte_by_byte_are_put_together(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("from 1 split")
        assert await stage.move_to(7.5) == 7.5

    bench.run(scenario)


def test_a_following_error_stops_the_move_with_its_name_and_homing_clears_it(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("at 4 jam")
        with pytest.raises(DeviceFault, match="following error"):
            await stage.move_to(80.0)
        assert (await stage.state()).phase is StagePhase.FAULT
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_a_stage_that_crawls_is_given_up_in_bounded_time(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.slow()
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="still moving"):
            await stage.move_to(80.0)
        assert bench.clock.now() - begin < 20

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
def test_a_real_tty_works_and_its_unplugging_is_noticed_and_mended(bench: Bench) -> None:
    stage = SMC100("sample stage", bench.simulator.start_pty(), bench.clock, timeout=0.3)

    async def scenario() -> None:
        await stage.open()
        await stage.home()
        assert await stage.move_to(20.0) == 20.0
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected):
            await stage.position()
        await stage.close()
        with pytest.raises(DeviceNotFound):
            await stage.open()
        bench.simulator.start_pty()
        await stage.open()
        assert await stage.move_to(10.0) == 10.0
        await stage.close()

    asyncio.run(scenario())


LINE_FAULTS = [
    "lose-request",
    "lose-reply",
    "delay 0.13 s",
    "duplicate",
    "corrupt",
    "truncate",
    "garbage",
    "split",
    "merge",
    "foreign",
    "unplug 0.05 s",
    "stall 0.13 s",
]
DEVICE_FAULTS = ["refuse", "restart", "jam", "drift", "slow"]


class NightBench(Bench):
    """A bench on a line that closes at once (pyserial sleeps when it closes a socket), where there is one."""

    def __init__(self) -> None:
        super().__init__()
        if sys.platform != "win32":
            self.stage = SMC100("sample stage", self.simulator.start_pty(), self.clock, timeout=0.05)

    async def reopen(self) -> None:
        """What an operator does after an error: close, and open again until the line is back."""
        await self.stage.close()
        await self.clock.sleep(60.0)
        for _ in range(100):
            try:
                await self.stage.open()
                return
            except DriverError:
                await asyncio.sleep(0.01)
        raise AssertionError("the stage cannot be opened again")


@pytest.fixture
def night_bench() -> Iterator[NightBench]:
    bench = NightBench()
    yield bench
    bench.simulator.close()


@pytest.mark.parametrize("fault", LINE_FAULTS)
def test_a_move_on_a_bad_line_arrives_or_says_why_and_the_next_works(night_bench: NightBench, fault: str) -> None:
    bench = night_bench

    async def scenario(stage: SMC100) -> None:
        for number in range(1, 10):
            target = 40.0 if number % 2 else 10.0
            bench.befall(f"at {number} {fault}", seed=number)
            try:
                assert await stage.move_to(target) == target
                assert bench.axis.position() == target
            except DriverError:
                bench.befall("")
                await bench.reopen()
            bench.befall("")
            assert await stage.move_to(20.0) == 20.0
            assert bench.axis.position() == 20.0

    bench.run(scenario)


@pytest.mark.parametrize("fault", LINE_FAULTS)
@pytest.mark.slow
def test_opening_and_homing_on_a_bad_line_work_or_say_why(night_bench: NightBench, fault: str) -> None:
    bench = night_bench

    async def scenario(stage: SMC100) -> None:
        for number in range(1, 31):
            await stage.close()
            bench.simulator.restart()
            bench.befall(f"at {number} {fault}", seed=number)
            try:
                await stage.open()
                await stage.home()
            except DriverError:
                bench.befall("")
                await bench.reopen()
                await stage.home()
            bench.befall("")
            assert (stage.velocity, stage.acceleration) == (20.0, 40.0)
            assert (await stage.state()).phase is StagePhase.READY
            assert bench.axis.position() == 0.0

    bench.run(scenario)


@pytest.mark.slow
# without shrinking, which would wait for thousands of real timeouts
@settings(max_examples=10, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    st.lists(
        st.builds(
            lambda at, every, fault: f"from {at} every {every} {fault}",
            st.integers(1, 30),
            st.integers(5, 60),
            st.sampled_from(LINE_FAULTS + DEVICE_FAULTS),
        ),
        min_size=1,
        max_size=5,
    ),
    st.integers(0, 1000),
)
def test_no_night_of_faults_leaves_a_wrong_angle_or_a_dead_stage(script: list[str], seed: int) -> None:
    bench = NightBench()

    async def scenario(stage: SMC100) -> None:
        bench.befall("\n".join(script), seed)
        for target in (30.0, 5.0, 60.0, 0.0):
            try:
                reached = await stage.move_to(target)
            except DriverError:
                # what an operator would try, on a line that is still bad
                with contextlib.suppress(DriverError):
                    await stage.close()
                    await stage.open()
                    await stage.home()
            else:
                assert reached == pytest.approx(target, abs=0.002)
                assert bench.axis.position() == pytest.approx(target, abs=0.002)
        bench.befall("")
        bench.simulator.drift(0.0)
        bench.simulator.slow(1.0)
        bench.simulator.restart()
        await bench.reopen()
        await stage.home()
        assert await stage.move_to(20.0) == 20.0
        assert bench.axis.position() == 20.0

    try:
        bench.run(scenario)
    finally:
        bench.simulator.close()


def test_a_velocity_that_was_misread_is_never_taken_for_the_stages_own(night_bench: NightBench) -> None:
    bench = night_bench

    async def scenario(stage: SMC100) -> None:
        for seed in range(40):
            await stage.close()
            bench.befall(f"at {4 + seed % 4} corrupt", seed)  # VA? and AC?, each asked twice
            try:
                await stage.open()
            except ProtocolError:
                await bench.reopen()
            assert (stage.velocity, stage.acceleration) == (20.0, 40.0)

    bench.run(scenario)


def test_a_velocity_that_did_not_get_through_is_noticed(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("at 1 lose-request")
        with pytest.raises(ProtocolError, match=r"told to move at 5°/s and reads back 20°/s"):
            await stage.set_velocity(5.0)
        assert stage.velocity == 20.0
        await stage.set_velocity(5.0)
        assert stage.velocity == 5.0

    bench.run(scenario)


def test_the_velocity_outlives_homing_and_a_power_cycle(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        await stage.set_velocity(5.0)
        for interrupt in (lambda: None, bench.simulator.restart):
            interrupt()
            await stage.home()
            begin = bench.clock.now()
            await stage.move_to(10.0)
            # 10 degrees at 5 degrees/s with ramps at 40 degrees/s^2
            assert bench.clock.now() - begin == pytest.approx(10 / 5 + 5 / 40, abs=0.1)

    bench.run(scenario)


@pytest.mark.parametrize("fault", ["lose-request", "refuse"])
def test_a_stop_that_is_lost_or_refused_at_first_stops_all_the_same(bench: Bench, fault: str) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.axis.move(80.0)
        bench.clock.advance_to(bench.clock.now() + 1.0)
        bench.befall(f"at 1 {fault}")
        await stage.stop()
        bench.clock.advance_to(bench.clock.now() + 60.0)
        assert bench.axis.position() < 40.0

    bench.run(scenario)


def test_a_stop_overtakes_a_question_whose_answer_does_not_come(bench: Bench) -> None:
    bench.stage = SMC100("sample stage", bench.url, bench.clock, timeout=0.5)

    async def scenario(stage: SMC100) -> None:
        bench.axis.move(80.0)
        bench.clock.advance_to(bench.clock.now() + 1.0)
        bench.befall("at 1 lose-reply")
        reading = asyncio.create_task(stage.position())
        while bench.simulator.script.requests < 1:  # noqa: ASYNC110 - it is another thread that counts
            await asyncio.sleep(0.001)
        stopping = asyncio.create_task(stage.stop())
        while bench.simulator.script.requests < 2:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
        assert not reading.done()
        bench.clock.advance_to(bench.clock.now() + 60.0)
        assert bench.axis.position() < 40.0
        await stopping
        assert await reading == pytest.approx(bench.axis.position(), abs=1e-4)

    bench.run(scenario)


def test_a_power_cycle_is_noticed_at_every_point_of_a_move(night_bench: NightBench) -> None:
    bench = night_bench

    async def scenario(stage: SMC100) -> None:
        for number in range(1, 8):
            await stage.move_to(5.0)
            bench.befall(f"at {number} restart")
            with pytest.raises((DeviceRefused, DeviceFault, ProtocolError)):
                await stage.move_to(40.0)
            assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
            with pytest.raises(DeviceRefused, match="home it first"):
                await stage.move_to(40.0)
            await stage.home()

    bench.run(scenario)


def test_an_encoder_that_has_drifted_and_a_command_that_is_refused_are_reported(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("at 1 refuse")
        with pytest.raises(DeviceRefused, match=r"PA30.*not allowed"):
            await stage.move_to(30.0)
        bench.befall("at 4 drift")
        with pytest.raises(DeviceFault, match=r"rest at 30\.500° instead of 30\.000°"):
            await stage.move_to(30.0)

    bench.run(scenario)


def test_a_command_that_a_stop_overtakes_never_reaches_the_device(bench: Bench) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.script = FaultScript([Fault(Kind.LOSE_REPLY, 1)])
        # the question before the move waits for its lost answer in the device's thread, and the move behind it
        waiting = [asyncio.create_task(stage.position()), asyncio.create_task(stage._begin_move(80.0))]
        await asyncio.sleep(0.03)
        await stage.stop()
        with pytest.raises(DeviceRefused, match="was stopped before"):
            await waiting[1]
        await waiting[0]
        assert not bench.axis.moving()
        assert (await stage.move_to(10.0)) == 10.0

    bench.run(scenario)
