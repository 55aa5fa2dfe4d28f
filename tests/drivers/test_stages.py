"""What an operator may expect of any rotation stage, on each family, over its own wire."""

import asyncio
import logging
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

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
from drivers.k10cr1 import COUNTS_PER_DEGREE
from drivers.stage import Mounting, Stage
from tests.stage_bench import FAMILIES, HAS_TERMINALS, NAME, Bench, until


@dataclass(frozen=True)
class Facts:
    """What differs between the families in what follows."""

    velocity: float
    """As it is when nobody has set another, degrees/s."""
    acceleration: float
    """Degrees/s^2."""
    identity: str
    silent: str
    """What is said when nobody answers."""
    refused: str
    """What is said when the device refuses to move."""
    jammed: str
    """What is said when the motor is blocked."""
    limits: tuple[float, float] = (-5.0, 90.0)
    step: float = 1e-9
    """Degrees to which an angle is exact."""
    scaled_speed: float = 1.0
    """By how much it becomes faster on the bench where it reads half a degree for each degree there."""
    power_cycled: str = r"home it|and then 0\.000° at rest"
    """What is said when it was switched off and on in a move."""
    moments: range = range(1, 10)
    """The requests at which a move is disturbed; further apart where it consists of many."""
    unharmed: int = 0
    """How many of the last requests of a move come after all that matters has been read."""


AZ = Facts(
    velocity=30.0,
    acceleration=60.0,
    identity="Oriental Motor",
    silent="no AZ driver",
    refused="it cannot do that in its present state",
    jammed="excessive position deviation",
    limits=(-90.0, 175.0),
    moments=range(1, 12, 4),
)
FACTS = {
    "SMC100": Facts(
        velocity=20.0,
        acceleration=40.0,
        identity="SMC100",
        silent="no SMC100 with address 1 answers",
        refused=r"PA30.*not allowed",
        jammed="following error",
        power_cycled=r"home it|came to rest at 0\.000°|and then 0\.000° at rest",
        scaled_speed=2.0,  # it is asked how fast it turns, and nobody tells it
    ),
    "OWIS PS": Facts(
        velocity=10.0,
        acceleration=20.0,
        identity="OWIS PS90-V1.0-simulated, axis 2",
        silent="no OWIS PS controller answers",
        refused=r"PSET2=30000 and keeps 0.*'09'",
        jammed="it was switched off after a motion error",
        moments=range(1, 30, 14),
        power_cycled=r"home it|did not take|and then 0\.000° at rest",
        unharmed=1,
    ),
    "K10CR1": Facts(
        velocity=10.0,
        acceleration=10.0,
        identity="Thorlabs K10CR1",
        silent="no K10CR1 answers",
        refused="refused message 0x0453: refused by a fault script",
        jammed="motion error",
        step=1 / COUNTS_PER_DEGREE,
    ),
    "AZ on TCP": AZ,
    "AZ on RTU": AZ,
}
IMPATIENT = 0.2
"""Real seconds that the drivers wait where the line is bad."""
PATIENT = 0.5
"""Where few requests are befallen."""
LASTS = 0.1
"""Real seconds of a fault that lasts."""
LINE_FAULTS = (
    *("lose-request", "lose-reply", "duplicate", "corrupt", "truncate", "garbage", "split", "merge", "foreign"),
    *(f"delay {LASTS} s", f"stall {LASTS} s", "unplug 0.02 s"),
)
FORGETFUL = ["SMC100", "OWIS PS", "K10CR1"]
"""Those that do not know their angle when they are switched on."""
WITH_ENCODER = ["SMC100", "OWIS PS", "AZ on TCP", "AZ on RTU"]
"""Those that notice when they stand elsewhere than their motor was sent."""
on = pytest.mark.parametrize


@pytest.fixture(params=[*FACTS])
def family(request: pytest.FixtureRequest) -> str:
    family: str = request.param
    return family


@pytest.fixture
def facts(family: str) -> Facts:
    return FACTS[family]


@pytest.fixture
def bench(family: str) -> Iterator[Bench[Any]]:
    bench = Bench(FAMILIES[family], timeout=PATIENT)
    yield bench
    bench.simulator.close()


def travel(distance: float, velocity: float, acceleration: float) -> float:
    """Seconds from rest to rest with a cruise between."""
    return distance / velocity + velocity / acceleration


def leaves_no_thread() -> bool:
    return not any(thread.name.startswith(NAME) for thread in threading.enumerate())


# what it does


def test_it_is_a_rotation_stage(bench: Bench[Any], facts: Facts) -> None:
    stage: RotationStage = bench.stage
    assert stage.limits == facts.limits


def test_a_move_ends_where_it_should_and_takes_its_time(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        assert (await stage.state()).phase is StagePhase.READY
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == pytest.approx(60.0, abs=facts.step)
        assert bench.clock.now() - begin == pytest.approx(travel(60, facts.velocity, facts.acceleration), abs=0.1)
        assert bench.axis.position() == pytest.approx(60.0, abs=facts.step)
        assert await stage.position() == pytest.approx(60.0, abs=facts.step)
        assert (await stage.state()).phase is StagePhase.READY
        assert facts.identity in await stage.identity()

    bench.run(scenario)


def test_a_stage_tells_where_it_is_while_it_moves(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.move_to(10.0)
        await stage.set_velocity(4.0)
        begin = bench.clock.now()
        seconds = await stage.begin_move(50.0)
        assert bench.clock.now() == begin, "it does not wait"
        assert seconds == pytest.approx(travel(40, 4, facts.acceleration))
        for _ in range(4):
            await bench.clock.sleep(2.0)
            # constant acceleration up to 4 degrees/s, and then that
            expected = 10 + 4 * (bench.clock.now() - begin) - 4**2 / (2 * facts.acceleration)
            assert await stage.position() == pytest.approx(expected, abs=0.01)
            state = await stage.state()
            assert state.phase == StagePhase.MOVING
            assert state.position == pytest.approx(expected, abs=0.01)
        assert await stage.arrive(50.0, seconds - 8) == pytest.approx(50.0, abs=facts.step)
        assert bench.clock.now() - begin == pytest.approx(seconds, abs=0.2)
        with pytest.raises(DeviceRefused, match="outside its limits"):
            await stage.begin_move(facts.limits[1] + 1)

    bench.run(scenario)


def test_the_velocity_outlives_homing_and_a_power_cycle(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.set_velocity(5.0)
        for interrupt in (lambda: None, bench.simulator.restart):
            interrupt()
            await stage.home()
            begin = bench.clock.now()
            await stage.move_to(10.0)
            assert bench.clock.now() - begin == pytest.approx(travel(10, 5, facts.acceleration), abs=0.1)

    bench.run(scenario)


def test_zero_direction_and_scale_of_the_mounting_hold(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        assert await stage.position() == pytest.approx(40.0, abs=facts.step)
        velocity, acceleration = facts.velocity * facts.scaled_speed, facts.acceleration * facts.scaled_speed
        begin = bench.clock.now()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=facts.step)
        assert bench.clock.now() - begin == pytest.approx(travel(30, velocity, acceleration), abs=0.1)
        assert bench.axis.position() == pytest.approx(20 - 10 / 2, abs=facts.step)
        assert (stage.velocity, bench.axis.velocity) == pytest.approx((velocity, velocity / 2), rel=1e-5)
        with pytest.raises(DeviceRefused, match="outside its limits"):
            await stage.move_to(facts.limits[0] - 1.0)

    bench.run(scenario, bench.driver(mounting=Mounting(zero=20.0, direction=-1, scale=0.5)))


def test_homing_twice_finds_the_mark_twice(bench: Bench[Any]) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.move_to(45.0)
        for _ in range(2):
            await stage.home()
            assert await stage.position() == 0.0
            assert bench.axis.position() == 0.0
            assert (await stage.state()).phase is StagePhase.READY

    bench.run(scenario)


@on("family", FORGETFUL)
def test_a_stage_that_was_not_homed_says_so_and_does_not_move(bench: Bench[Any]) -> None:
    async def scenario(stage: Stage) -> None:
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 12.0

    bench.run(scenario, homed=False)


def test_nothing_is_sent_for_an_angle_outside_the_limits(bench: Bench[Any], facts: Facts) -> None:
    low, high = facts.limits

    async def scenario(stage: Stage) -> None:
        bench.befall("")
        for angle in (low - 0.1, high + 0.1, float("nan")):
            with pytest.raises(DeviceRefused, match=rf"{NAME}.*{low:g}° to {high:g}°"):
                await stage.move_to(angle)
        assert bench.simulator.script.requests == 0

    bench.run(scenario)


def test_two_that_ask_at_once_get_their_own_answers(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.move_to(33.0)
        positions = await asyncio.gather(*(stage.position() for _ in range(5)))
        states = await asyncio.gather(*(stage.state() for _ in range(5)))
        assert positions == pytest.approx([33.0] * 5, abs=facts.step)
        assert {state.phase for state in states} == {StagePhase.READY}

    bench.run(scenario)


# whether it is there


@on("socket", [False, True])
def test_an_absent_device_is_named_with_its_address_and_leaves_no_thread(family: str, socket: bool) -> None:
    bench = Bench(FAMILIES[family], socket=socket)
    bench.simulator.close()
    with pytest.raises(DeviceNotFound, match=rf"{NAME}.*{re.escape(bench.url)}.*check"):
        asyncio.run(bench.stage.open())
    asyncio.run(until(leaves_no_thread))


@on("fault", ["lose-request", "lose-reply"])
def test_a_line_on_which_nobody_answers_is_not_found_and_leaves_no_thread(
    bench: Bench[Any], facts: Facts, fault: str
) -> None:
    bench.befall(f"from 1 {fault}")
    with pytest.raises(DeviceNotFound, match=facts.silent):
        asyncio.run(bench.driver(timeout=IMPATIENT).open())
    asyncio.run(until(leaves_no_thread))


@on("socket", [False, True])
def test_unplugging_is_noticed_and_the_stage_works_again_after_reopening(
    family: str, facts: Facts, socket: bool
) -> None:
    if not socket and (FAMILIES[family].terminal is None or not HAS_TERMINALS):
        pytest.skip("no terminal")
    bench = Bench(FAMILIES[family], socket=socket)

    async def scenario(stage: Stage) -> None:
        assert await stage.move_to(20.0) == pytest.approx(20.0, abs=facts.step)
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.stop()
        await stage.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await stage.position()
        with pytest.raises(DeviceNotFound):
            await stage.open()
        bench.plug_in()
        await stage.open()
        assert await stage.move_to(5.0) == pytest.approx(5.0, abs=facts.step)

    try:
        bench.run(scenario)
    finally:
        bench.simulator.close()


# what the device does


def test_a_refused_move_is_told_with_the_devices_own_words(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        bench.simulator.refuse()
        with pytest.raises(DeviceRefused, match=rf"{NAME}.*{facts.refused}"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 0.0
        assert await stage.move_to(30.0) == pytest.approx(30.0, abs=facts.step)

    bench.run(scenario)


def test_a_jam_stops_the_move_with_its_name_and_homing_clears_it(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.simulator.jam()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match=facts.jammed):
            await move
        state = await stage.state()
        assert state.phase is StagePhase.FAULT
        assert facts.jammed in state.message
        with pytest.raises((DeviceRefused, DeviceFault)):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=facts.step)

    bench.run(scenario)


@on("family", FORGETFUL)
def test_a_power_cycle_in_mid_move_loses_the_reference_and_homing_restores_the_speed(
    bench: Bench[Any], facts: Facts
) -> None:
    async def scenario(stage: Stage) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.simulator.restart()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match=r"not referenced.*home it"):
            await move
        with pytest.raises(DeviceRefused, match="home it first"):
            await stage.move_to(10.0)
        await stage.home()
        begin = bench.clock.now()
        assert await stage.move_to(60.0) == pytest.approx(60.0, abs=facts.step)
        assert bench.clock.now() - begin == pytest.approx(travel(60, facts.velocity, facts.acceleration), abs=0.1)

    bench.run(scenario)


@on("family", FORGETFUL)
def test_a_power_cycle_at_any_moment_of_a_move_is_noticed_and_homing_mends_it(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        bench.befall("")
        await stage.move_to(30.0)
        last = bench.simulator.script.requests - facts.unharmed
        for number in range(1, last + 1, max(last // 8, 1)):
            await stage.move_to(5.0)
            bench.befall(f"at {number} restart")
            with pytest.raises((DeviceFault, DeviceRefused, ProtocolError), match=facts.power_cycled):
                await stage.move_to(30.0)
            await bench.clock.sleep(2.0)
            assert not bench.axis.moving()
            assert (await stage.state()).phase is StagePhase.NOT_REFERENCED
            with pytest.raises(DeviceRefused, match="home it first"):
                await stage.move_to(30.0)
            await stage.home()
            assert await stage.move_to(30.0) == pytest.approx(30.0, abs=facts.step)
            assert bench.axis.position() == pytest.approx(30.0, abs=facts.step)

    bench.run(scenario, bench.driver(timeout=2.0))  # one that asks again counts its requests otherwise


@on("family", WITH_ENCODER)
@on("mid_move", [False, True])
def test_an_encoder_that_drifts_away_is_noticed(bench: Bench[Any], mid_move: bool) -> None:
    async def scenario(stage: Stage) -> None:
        if mid_move:
            under_way = bench.clock.hold()
            move = asyncio.create_task(stage.move_to(30.0))
            await under_way.wait()
            bench.simulator.drift()
            bench.clock.released.set()
        else:
            bench.simulator.drift()
            move = asyncio.create_task(stage.move_to(30.0))
        with pytest.raises(DeviceFault, match=r"rest at 30\.500° instead of 30\.000°"):
            await move

    bench.run(scenario)


def test_a_stage_that_crawls_is_given_up_in_bounded_time(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        bench.simulator.slow()
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="still moving"):
            await stage.move_to(80.0)
        assert bench.clock.now() - begin < 2 * travel(80, facts.velocity, facts.acceleration) + 10
        with pytest.raises(DeviceRefused, match="moving"):
            await stage.move_to(10.0)

    bench.run(scenario)


# stopping


@on(
    ("family", "fault"),
    [
        (family, fault)
        for family in FACTS
        for fault in ("", "at 1 lose-request", "at 1 refuse")
        if (family, fault) != ("K10CR1", "at 1 refuse")  # it never refuses a stop
    ],
)
def test_a_move_can_be_cancelled_and_stopped_where_it_is_even_if_the_first_stop_is_lost(
    bench: Bench[Any], facts: Facts, fault: str
) -> None:
    async def scenario(stage: Stage) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        assert bench.axis.moving()
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        bench.befall(fault)
        await stage.stop()
        await bench.clock.sleep(5.0)
        state = await stage.state()
        assert state.phase is StagePhase.READY
        assert 0.0 < state.position < 45.0
        assert state.position == pytest.approx(bench.axis.position(), abs=0.01), "it braked and lost no steps"
        await stage.stop()
        assert await stage.move_to(10.0) == pytest.approx(10.0, abs=facts.step)

    bench.run(scenario)


def test_a_stop_from_elsewhere_is_not_taken_for_an_arrival(bench: Bench[Any]) -> None:
    async def scenario(stage: Stage) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        assert (await stage.state()).phase is StagePhase.MOVING
        await stage.stop()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario)


def test_two_who_stop_at_once_both_do(bench: Bench[Any]) -> None:
    async def scenario(stage: RotationStage) -> None:
        async def stop(later: float) -> None:
            await asyncio.sleep(later)
            await stage.stop()

        await stage.begin_move(80.0)
        # each meets the one before at another place
        await asyncio.gather(*(stop(later) for later in (0.0, 0.0, 0.001, 0.002, 0.004)))
        await bench.clock.sleep(5.0)
        assert (await stage.state()).phase is StagePhase.READY
        assert bench.axis.position() < 45.0

    bench.run(scenario)


def test_a_stop_overtakes_a_question_whose_answer_does_not_come(bench: Bench[Any]) -> None:
    async def scenario(stage: Stage) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        bench.befall("at 1 lose-reply")
        question = asyncio.create_task(stage.position())
        await until(lambda: bench.simulator.script.requests >= 1)
        stopping = asyncio.create_task(stage.stop())
        await until(lambda: bench.axis._target < 80.0)
        assert not question.done()
        await bench.clock.sleep(5.0)
        assert not bench.axis.moving()
        assert bench.axis.position() < 45.0
        await stopping
        assert await question == pytest.approx(bench.axis.position(), abs=0.01)
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="instead of 80"):
            await move

    bench.run(scenario, bench.driver(timeout=0.3))


# the line


def test_a_silent_device_is_a_timeout_and_its_late_reply_is_not_taken_for_the_next(
    bench: Bench[Any], facts: Facts
) -> None:
    async def scenario(stage: Stage) -> None:
        bench.befall("from 1 lose-reply")
        with pytest.raises(DeviceTimeout, match="no whole"):
            await stage.position()
        bench.befall(f"at 1 delay {4 * PATIENT:.2f} s")  # after the third attempt
        with pytest.raises(DeviceTimeout):
            await stage.state()
        assert await stage.move_to(3.0) == pytest.approx(3.0, abs=facts.step)

    bench.run(scenario)


def test_a_question_that_is_asked_again_leaves_a_line_in_the_log(
    bench: Bench[Any], caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(stage: Stage) -> None:
        caplog.clear()
        bench.befall("at 1 lose-reply")
        assert await stage.position() == 0.0
        (record,) = (record for record in caplog.records if record.name.startswith("drivers."))
        assert record.levelno == logging.WARNING
        assert "attempt 2 of 3" in record.message

    bench.run(scenario, bench.driver(timeout=1.0))


def test_replies_that_come_byte_by_byte_are_put_together(bench: Bench[Any], facts: Facts) -> None:
    async def scenario(stage: Stage) -> None:
        bench.befall("from 1 split")
        assert await stage.move_to(7.5) == pytest.approx(7.5, abs=facts.step)

    bench.run(scenario)


BAD_LINES = [
    (family, fault)
    for family in FACTS
    for fault in LINE_FAULTS
    if (family, fault) != ("AZ on TCP", "corrupt")  # a network carries a checksum of its own below Modbus
]


@on(
    ("family", "fault"),
    [
        # those whose answers say what they answer are for who has the time
        pytest.param(family, fault, marks=() if family == "OWIS PS" else pytest.mark.slow)
        for family, fault in BAD_LINES
    ],
)
def test_one_fault_at_any_request_of_a_reading_is_survived(bench: Bench[Any], facts: Facts, fault: str) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.move_to(33.0)
        for number in range(1, 9):
            bench.befall(f"at {number} {fault}", seed=number)
            try:
                assert await stage.position() == pytest.approx(33.0, abs=facts.step)
            except DeviceDisconnected:
                assert fault.startswith("unplug")
                await bench.make_ready(stage)

    bench.run(scenario, bench.driver(timeout=IMPATIENT))


@on(
    ("family", "fault", "seed"),
    [
        # what is slow, and no worse than what the fault matrix does to these lines, is for who has the time
        pytest.param(family, fault, seed, marks=pytest.mark.slow if seed or family.startswith("AZ") else ())
        for family, fault in BAD_LINES
        for seed in range(3)
    ],
)
def test_a_move_on_a_bad_line_arrives_or_says_why_and_the_next_works(
    bench: Bench[Any], facts: Facts, fault: str, seed: int
) -> None:
    async def scenario(stage: Stage) -> None:
        right = 0
        for number in facts.moments:
            target = 40.0 if number % 2 else 10.0
            bench.befall(f"from {number} every {23 + seed} {fault}", seed=31 * seed + number)
            try:
                # what is not known for sure is an error, but what is given is right
                assert await stage.move_to(target) == pytest.approx(target, abs=facts.step)
                assert bench.axis.position() == pytest.approx(target, abs=facts.step)
                assert await stage.position() == pytest.approx(target, abs=facts.step)
                right += 1
            except DriverError:
                await bench.make_ready(stage)
            bench.befall("")
            assert await stage.move_to(20.0) == pytest.approx(20.0, abs=facts.step)
            assert bench.axis.position() == pytest.approx(20.0, abs=facts.step)
        assert right or fault.split(maxsplit=1)[0] in {"lose-request", "stall", "unplug"}

    bench.run(scenario, bench.driver(timeout=IMPATIENT))


@pytest.mark.slow
@on(("family", "fault"), BAD_LINES)
def test_opening_and_homing_on_a_bad_line_work_or_say_why(family: str, facts: Facts, fault: str) -> None:
    async def scenario(bench: Bench[Any], numbers: range) -> None:
        stage = bench.driver(timeout=IMPATIENT)
        for number in numbers:
            bench.simulator.restart()
            bench.befall(f"at {number} {fault}", seed=number)
            try:
                await stage.open()
                await stage.home()
            except DriverError:
                await bench.make_ready(stage)
                await stage.home()
            bench.befall("")
            assert (stage.velocity, stage.acceleration) == (facts.velocity, facts.acceleration)
            assert (await stage.state()).phase is StagePhase.READY
            assert bench.axis.position() == 0.0
            await stage.close()

    async def side_by_side() -> None:
        # most of the time a driver waits for a reply that does not come
        await asyncio.gather(*(scenario(bench, range(1 + i, 31, len(benches))) for i, bench in enumerate(benches)))

    benches = [Bench(FAMILIES[family]) for _ in range(3)]
    try:
        asyncio.run(side_by_side())
    finally:
        for bench in benches:
            bench.simulator.close()
