"""The OWIS PS driver moves a stage over a line whose answers say nothing of themselves, and survives its faults."""

import asyncio
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from itertools import cycle

import pytest

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
from drivers.owis import OwisPS, ReferenceMode
from drivers.stage import DIRECTLY, Mounting
from simulators.clock import SimulatedClock
from simulators.faults import FaultScript, Kind
from simulators.motion import Axis
from simulators.owis import SimulatedOwisPS

COUNTS_PER_DEGREE = 1000.0
DEVICE_FAULTS = {Kind.REFUSE, Kind.RESTART, Kind.JAM, Kind.DRIFT, Kind.SLOW}
LINE_FAULTS = [kind for kind in Kind if kind not in DEVICE_FAULTS]


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
    """A simulated PS 90 with a stage on its second axis, and the driver connected to it."""

    def __init__(self) -> None:
        self.clock = HeldClock()
        self.axis = Axis(self.clock, start=12.0, velocity=5, acceleration=5, limits=(-20, 100))
        others = [Axis(self.clock, velocity=5, acceleration=5, limits=(-20, 100)) for _ in range(2)]
        self.simulator = SimulatedOwisPS(
            [others[0], self.axis, others[1]], self.clock, counts_per_degree=COUNTS_PER_DEGREE
        )
        self.url = self.simulator.start()
        self.stage = self.driver()

    def driver(self, *, mounting: Mounting = DIRECTLY, timeout: float = 0.1, axis: int = 2) -> OwisPS:
        return OwisPS(
            "sample stage",
            self.url,
            self.clock,
            axis=axis,
            counts_per_degree=COUNTS_PER_DEGREE,
            velocity=20.0,
            acceleration=40.0,
            mounting=mounting,
            timeout=timeout,
        )

    def strike(self, text: str, seed: int = 0) -> None:
        self.simulator.script = FaultScript.parse(text, seed)

    def run(self, scenario: Callable[[OwisPS], Awaitable[None]], *, homed: bool = True) -> None:
        async def whole() -> None:
            await self.stage.open()
            try:
                if homed:
                    await self.stage.home()
                await scenario(self.stage)
            finally:
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
    async def scenario(stage: OwisPS) -> None:
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == 60.0
        # 60 degrees at 20 degrees/s with ramps at 40 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 20 + 20 / 40, abs=0.1)
        assert bench.axis.position() == 60.0
        assert (await stage.state()).phase is StagePhase.READY
        assert await stage.identity() == "OWIS PS90-V1.0-simulated, axis 2"
        await stage.set_velocity(5.0)
        begin = bench.clock.now()
        assert await stage.move_to(0.0) == 0.0
        assert bench.clock.now() - begin == pytest.approx(60 / 5 + 5 / 40, abs=0.1)

    bench.run(scenario)


def test_a_ps10_is_the_same_with_one_axis() -> None:
    clock = SimulatedClock()
    axis = Axis(clock, start=3.0, velocity=5, acceleration=5, limits=(-20, 100))
    simulator = SimulatedOwisPS([axis], clock, counts_per_degree=200)

    async def scenario() -> None:
        stage = OwisPS("stage", simulator.start(), clock, counts_per_degree=200, timeout=0.1)
        await stage.open()
        await stage.home()
        assert await stage.move_to(33.335) == 33.335
        await stage.close()

    try:
        asyncio.run(scenario())
    finally:
        simulator.close()


def test_zero_direction_and_scale_of_the_mounting_hold(bench: Bench) -> None:
    bench.stage = bench.driver(mounting=Mounting(zero=50.0, direction=-1, scale=2.0))

    async def scenario(stage: OwisPS) -> None:
        begin = bench.clock.now()
        assert await stage.move_to(10.0) == 10.0
        assert bench.axis.position() == 50 - 2 * 10
        # from 25 to 10 degrees on the bench at 20 degrees/s with ramps at 40 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(15 / 20 + 20 / 40, abs=0.1)
        with pytest.raises(DeviceRefused, match="outside its limits"):
            await stage.move_to(-6.0)

    bench.run(scenario)


def test_a_stage_that_was_not_homed_says_so_and_does_not_move(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 12.0

    bench.run(scenario, homed=False)


def test_a_counter_that_was_never_zeroed_is_no_reference(bench: Bench) -> None:
    """Somebody else initialised the axis, but did not search for the reference."""

    async def scenario(stage: OwisPS) -> None:
        bench.simulator.answer(b"INIT2")
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED

    bench.run(scenario, homed=False)


def test_homing_at_the_mark_still_searches_it(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.home()
        await stage.home()
        assert await stage.position() == 0.0

    bench.run(scenario)


def test_a_way_of_referencing_that_leaves_the_counter_is_not_accepted() -> None:
    with pytest.raises(ValueError, match="2 is not a valid ReferenceMode"):
        ReferenceMode(2)


@pytest.mark.parametrize("angle", [-5.1, 90.1, float("nan")])
def test_nothing_is_sent_for_an_angle_outside_the_limits(bench: Bench, angle: float) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.strike("")
        with pytest.raises(DeviceRefused, match=r"sample stage.*-5° to 90°"):
            await stage.move_to(angle)
        assert bench.simulator.script.requests == 0

    bench.run(scenario)


def test_a_power_cycle_in_mid_move_loses_the_reference_and_homing_restores_the_speed(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.simulator.restart()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match=r"not referenced.*home it"):
            await move
        with pytest.raises(DeviceRefused, match=r"not referenced.*home it"):
            await stage.move_to(10.0)
        await stage.home()
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == 60.0
        assert bench.clock.now() - begin == pytest.approx(60 / 20 + 20 / 40, abs=0.1)

    bench.run(scenario)


def test_a_jam_stops_the_move_with_its_name_and_homing_clears_it(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.simulator.jam()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="motion error"):
            await move
        state = await stage.state()
        assert (state.phase, state.message) == (StagePhase.FAULT, "it was switched off after a motion error")
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_a_refused_command_is_refused_in_the_controllers_words(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.refuse()
        with pytest.raises(DeviceRefused, match=r"PSET2=30000 and keeps 0.*'09'"):
            await stage.move_to(30.0)
        bench.simulator.refuse()
        with pytest.raises(DeviceRefused, match=r"PVEL2=7000 and keeps 20000.*'09'"):
            await stage.set_velocity(7.0)
        assert stage.velocity == 20.0
        assert await stage.move_to(30.0) == 30.0

    bench.run(scenario)


@pytest.mark.parametrize("command", ["INIT", "REF", "PSET", "PGO", "PVEL"])
def test_a_command_that_never_arrives_is_an_error_and_not_a_success(bench: Bench, command: str) -> None:
    """Commands have no reply, so that only what the controller shows afterwards can tell."""

    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(20.0)
        answer = bench.simulator.answer
        lost: list[bytes] = []

        def forgetful(request: bytes) -> bytes:
            if request.startswith(command.encode()) and not lost:
                lost.append(request)
                return b""
            return answer(request)

        bench.simulator.answer = forgetful  # type: ignore[method-assign]
        if command == "INIT":
            bench.simulator.jam()
        deeds: dict[str, Callable[[], Awaitable[object]]] = {
            "PVEL": lambda: stage.set_velocity(3.0),
            "PSET": lambda: stage.move_to(50.0),
            "PGO": lambda: stage.move_to(50.0),
        }
        with pytest.raises((DeviceRefused, DeviceFault), match="sample stage"):
            await deeds.get(command, stage.home)()
        assert lost
        if command in {"PSET", "PGO"}:
            assert bench.axis.position() == 20.0

    bench.run(scenario)


def test_relative_positions_that_somebody_left_behind_do_not_send_the_stage_elsewhere(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(20.0)
        bench.simulator.answer(b"RELAT2")
        assert await stage.move_to(30.0) == 30.0

    bench.run(scenario)


def test_replies_of_ok_to_commands_do_no_harm(bench: Bench) -> None:
    bench.simulator.answer(b"TERM=2")

    async def scenario(stage: OwisPS) -> None:
        assert await stage.move_to(30.0) == 30.0
        await stage.set_velocity(4.0)
        assert await stage.move_to(0.0) == 0.0

    bench.run(scenario)


def test_a_stage_on_its_limit_switch_is_freed_by_homing(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        stage.limits = (-5.0, 200.0)
        with pytest.raises(DeviceFault, match="limit switch, high limit switch"):
            await stage.move_to(150.0)
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_motor_off_is_said_and_homing_switches_it_on(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.answer(b"MOFF2")
        assert (await stage.state()).phase is StagePhase.DISABLED
        with pytest.raises(DeviceRefused, match="disabled; home it first"):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


@pytest.mark.parametrize("reply", [b"16\r", b"00001\r"])
def test_an_error_of_the_power_stage_is_named_in_either_dialect(bench: Bench, reply: bytes) -> None:
    async def scenario(stage: OwisPS) -> None:
        answer = bench.simulator.answer
        bench.simulator.answer = (  # type: ignore[method-assign]
            lambda request: reply if request == b"?ESTAT2" else answer(request)
        )
        state = await stage.state()
        assert (state.phase, state.message) == (StagePhase.FAULT, "power stage error")
        with pytest.raises(DeviceRefused, match="power stage error"):
            await stage.move_to(10.0)

    bench.run(scenario)


def test_an_encoder_that_drifts_away_is_noticed(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.drift()
        with pytest.raises(DeviceFault, match="instead of 30"):
            await stage.move_to(30.0)

    bench.run(scenario)


def test_a_stage_that_crawls_is_given_up_in_bounded_time(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.slow(100.0)
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="still moving"):
            await stage.move_to(80.0)
        assert bench.clock.now() - begin < 20

    bench.run(scenario)


def test_a_move_can_be_cancelled_and_stopped_where_it_is(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
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


def test_a_stop_overtakes_a_question_that_waits_for_its_answer(bench: Bench) -> None:
    bench.stage = bench.driver(timeout=1.0)

    async def scenario(stage: OwisPS) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.strike("at 1 lose-request")
        question = asyncio.create_task(stage.position())
        await asyncio.sleep(0.1)  # it waits now
        stopping = asyncio.create_task(stage.stop())
        await asyncio.sleep(0.1)
        assert not question.done()
        await bench.clock.sleep(5.0)
        assert not bench.axis.moving()
        assert bench.axis.position() < 80.0
        await asyncio.gather(question, stopping)
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario)


def test_a_stop_that_is_lost_once_still_stops(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.strike("at 1 lose-request")
        await stage.stop()
        await asyncio.sleep(0)
        bench.clock.advance_to(bench.clock.now() + 5.0)
        assert bench.axis.position() < 80.0
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario)


def test_a_stopped_search_is_no_reference(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(80.0)
        under_way = bench.clock.hold()
        homing = asyncio.create_task(stage.home())
        await under_way.wait()
        await stage.stop()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="not referenced"):
            await homing

    bench.run(scenario)


def test_an_absent_device_is_named_with_its_address(bench: Bench) -> None:
    bench.simulator.close()
    port = bench.url.rpartition(":")[2]
    with pytest.raises(DeviceNotFound, match=rf"sample stage.*{port}.*check its power"):
        asyncio.run(bench.stage.open())


def test_a_line_on_which_nobody_answers_is_not_found_and_leaves_no_thread(bench: Bench) -> None:
    bench.strike("from 1 lose-request")
    with pytest.raises(DeviceNotFound, match="no OWIS PS controller answers"):
        asyncio.run(bench.stage.open())
    deadline = time.monotonic() + 5.0
    while any(thread.name.startswith("sample stage") for thread in threading.enumerate()):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_an_axis_that_the_controller_does_not_have_is_not_found(bench: Bench) -> None:
    with pytest.raises(DeviceNotFound, match="no axis 4; it has 3"):
        asyncio.run(bench.driver(axis=4).open())


def test_another_instrument_is_not_taken_for_a_controller(bench: Bench) -> None:
    bench.simulator.answer = lambda request: b"12345\r"  # type: ignore[method-assign]
    with pytest.raises(ProtocolError, match="is no answer to"):
        asyncio.run(bench.stage.open())


def test_unplugging_is_noticed_and_the_stage_works_again_after_reopening(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        with pytest.raises(DeviceDisconnected):
            await stage.stop()
        await stage.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await stage.position()
        bench.simulator.start()
        await stage.open()
        assert await stage.move_to(5.0) == 5.0

    bench.run(scenario)


def fault(kind: Kind, when: str) -> str:
    seconds = {Kind.DELAY: " 0.08 s", Kind.STALL: " 0.08 s", Kind.UNPLUG: " 0.02 s"}.get(kind, "")
    return f"{when} {kind}{seconds}"


@pytest.mark.parametrize("kind", LINE_FAULTS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_bad_line_makes_no_wrong_angle(bench: Bench, kind: Kind, seed: int) -> None:
    """Whatever befalls the line, a position is right or an error; a move ends at its target or as an error."""
    bench.stage = bench.driver(timeout=0.05)

    async def scenario(stage: OwisPS) -> None:
        right = 0
        for round_ in range(3):
            target = 10.0 + 7.0 * round_
            bench.strike(fault(kind, f"from {1 + 7 * round_ + seed} every {23 + seed}"), seed=31 * seed + round_)
            try:
                # what is not known for sure is an error, but what is given is right
                assert await stage.move_to(target) == target
                assert bench.axis.position() == target
                assert await stage.position() == target
                right += 1
            except DriverError:
                bench.strike("")
                await stage.close()
                await asyncio.sleep(0.03)
                await stage.open()
                await stage.home()
        assert right or kind in {Kind.LOSE_REQUEST, Kind.STALL, Kind.UNPLUG}

    bench.run(scenario)


@pytest.mark.parametrize("kind", LINE_FAULTS)
def test_one_fault_at_any_request_of_a_reading_is_survived(bench: Bench, kind: Kind) -> None:
    bench.stage = bench.driver(timeout=0.05)

    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        for at in range(1, 9, 4 if kind is Kind.UNPLUG else 1):
            bench.strike(fault(kind, f"at {at}"), seed=at)
            if kind is Kind.UNPLUG:
                with pytest.raises(DeviceDisconnected):
                    await stage.position()
                await stage.close()
                await asyncio.sleep(0.03)
                await stage.open()
            else:
                assert await stage.position() == 33.0

    bench.run(scenario)


def test_a_reply_to_an_earlier_question_is_never_a_position(bench: Bench) -> None:
    """Every reply comes again before the next one, so that a client that counts lines would be off by one."""

    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        await stage.set_velocity(5.0)
        bench.strike("from 1 duplicate")
        for target in (34.0, 35.0):
            assert await stage.move_to(target) == target
        bench.strike("every 2 foreign", seed=3)
        for _ in range(10):
            try:
                assert await stage.position() == 35.0
            except ProtocolError:
                continue

    bench.run(scenario)


def test_an_encoder_that_trembles_is_read_to_its_tremor(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        answer, trembling = bench.simulator.answer, cycle([33001, 32999, 33000])
        bench.simulator.answer = (  # type: ignore[method-assign]
            lambda request: b"%d\r" % next(trembling) if request == b"?CNT2" else answer(request)
        )
        assert await stage.position() == pytest.approx(33.0, abs=0.001)

    bench.run(scenario)


def test_two_that_ask_at_once_get_their_own_answers(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        positions = await asyncio.gather(*(stage.position() for _ in range(5)))
        states = await asyncio.gather(*(stage.state() for _ in range(5)))
        assert set(positions) == {33.0}
        assert {state.phase for state in states} == {StagePhase.READY}

    bench.run(scenario)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_real_tty_works_and_its_unplugging_is_noticed(bench: Bench) -> None:
    bench.url = bench.simulator.start_pty()
    bench.stage = bench.driver(timeout=0.3)

    async def scenario(stage: OwisPS) -> None:
        assert await stage.move_to(20.0) == 20.0
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected):
            await stage.position()

    bench.run(scenario)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_both_stages_of_a_bench_may_hang_on_one_controller(bench: Bench) -> None:
    bench.url = bench.simulator.start_pty()
    sample, detector = bench.driver(timeout=0.2), bench.driver(axis=3, timeout=0.2)

    async def scenario() -> None:
        # two openings of one terminal would take each other's replies, so it is opened exclusively, and only once
        await asyncio.gather(sample.open(), detector.open())
        await asyncio.gather(sample.home(), detector.home())
        bench.strike("every 41 lose-reply\nevery 59 foreign")
        for angle in (10.0, 20.0, 30.0):
            assert await asyncio.gather(sample.move_to(angle), detector.move_to(2 * angle)) == [angle, 2 * angle]
        bench.strike("")
        # the one that leaves takes nothing from the other
        await sample.close()
        assert await detector.move_to(5.0) == 5.0
        with pytest.raises(DeviceDisconnected, match="not open"):
            await sample.position()
        await sample.open()
        bench.simulator.unplug()
        for stage in (sample, detector):
            with pytest.raises(DeviceDisconnected):
                await stage.position()
        bench.simulator.start_pty()
        for stage in (sample, detector):
            await stage.close()
            await stage.open()
        assert await asyncio.gather(sample.move_to(40.0), detector.move_to(7.0)) == [40.0, 7.0]
        await sample.close()
        await detector.close()

    before = threading.active_count()
    asyncio.run(scenario())
    assert threading.active_count() <= before


def test_a_line_cannot_have_two_baud_rates(bench: Bench) -> None:
    async def scenario(stage: OwisPS) -> None:
        other = OwisPS("other", bench.url, bench.clock, counts_per_degree=1.0, baudrate=19200)
        with pytest.raises(DeviceNotFound, match="9600 Bd"):
            await other.open()
        assert await stage.move_to(3.0) == 3.0

    bench.run(scenario)
