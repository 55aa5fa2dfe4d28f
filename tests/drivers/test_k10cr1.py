"""What is special about a K10CR1: messages without checksums, steps without an encoder, and how it wakes up."""

import asyncio
from collections.abc import Iterator

import pytest
import thorlabs_apt_protocol as thorlabs

from drivers.errors import DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.k10cr1 import ACCELERATION_UNITS, COUNTS_PER_DEGREE, K10CR1, VELOCITY_UNITS
from simulators.devices.k10cr1 import SimulatedK10CR1
from tests.stage_bench import Bench, Family

STEP = 1 / COUNTS_PER_DEGREE
"""Degrees."""


@pytest.fixture
def bench() -> Iterator[Bench[K10CR1]]:
    family = Family(lambda axis, clock: SimulatedK10CR1(axis, serial_number=55123456), K10CR1)
    bench = Bench(family, velocity=10.0, acceleration=10.0)
    yield bench
    bench.simulator.close()


def test_its_units_are_the_published_ones() -> None:
    units = [COUNTS_PER_DEGREE, VELOCITY_UNITS, ACCELERATION_UNITS]
    assert units == pytest.approx([136533.33333333, 7329109.333, 1502.0], rel=3e-5)


def test_homing_ends_although_the_mount_woke_up_with_a_velocity_of_hours(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        begin = bench.clock.now()
        await stage.home()
        assert bench.clock.now() - begin < 10
        assert await stage.position() == 0.0
        assert bench.axis.position() == 0.0

    bench.run(scenario, homed=False)


def test_it_goes_straight_to_its_target_because_backlash_is_taken_up_elsewhere(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        for restarted in (False, True):
            if restarted:
                bench.simulator.restart()
                await stage.home()
            await stage.move_to(20.0)
            begin = bench.clock.now()
            assert await stage.move_to(10.0) == pytest.approx(10.0, abs=STEP)
            assert bench.clock.now() - begin == pytest.approx(2.0, abs=0.1)  # 2 sqrt(10 / 10), and no way back

    bench.run(scenario)


def test_homing_twice_searches_the_mark_twice(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.drift(0.5)  # steps lost, and not known
        assert await stage.position() == pytest.approx(0.5, abs=STEP)
        await stage.home()
        assert await stage.move_to(20.0) == pytest.approx(20.0, abs=STEP)
        assert bench.axis.position() == pytest.approx(20.0, abs=STEP)

    bench.run(scenario)


def test_homing_that_never_began_is_not_taken_for_done(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        await stage.move_to(20.0)
        # 1-2 status; velocity, backlash: 3-6, 7-10 set and read back; 11-12 homing, 13-16 set and read back
        bench.befall("at 17 lose-request")
        with pytest.raises(DeviceTimeout, match="did not begin"):
            await stage.home()
        assert bench.axis.position() == pytest.approx(20.0, abs=STEP)

    bench.run(scenario, bench.driver(timeout=1.0))


def test_a_velocity_is_set_and_one_that_the_mount_does_not_take_is_refused(bench: Bench[K10CR1]) -> None:
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


def test_the_wrong_mount_is_not_driven(bench: Bench[K10CR1]) -> None:
    with pytest.raises(ProtocolError, match="55123456 instead of 55999999"):
        asyncio.run(bench.driver(serial_number=55999999).open())


def test_the_mount_tells_the_operator_which_one_it_is(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        assert await stage.identity() == "Thorlabs K10CR1 55123456 firmware 1.0.2"

    bench.run(scenario)


@pytest.mark.parametrize(
    "fault", ["lose-reply", "duplicate", "corrupt", "truncate", "garbage", "split", "merge", "foreign", "delay 0.35 s"]
)
def test_one_bad_reply_in_a_while_costs_no_point_and_puts_the_mount_nowhere_else(
    bench: Bench[K10CR1], fault: str
) -> None:
    async def scenario(stage: K10CR1) -> None:
        for seed, first in enumerate((1, 2, 4, 7)):
            bench.befall(f"from {first} every 9 {fault}", seed)
            for target in (10.0, 40.0, 3.0):
                assert await stage.move_to(target) == pytest.approx(target, abs=STEP)
                assert bench.axis.position() == pytest.approx(target, abs=STEP)

    bench.run(scenario, bench.driver(timeout=0.3))


@pytest.mark.parametrize(
    "fault", ["lose-request", "lose-reply", "corrupt", "truncate", "garbage", "merge", "foreign", "stall 0.15 s"]
)
def test_a_line_on_which_half_is_bad_gives_a_right_angle_or_an_error_and_works_when_it_is_good_again(
    bench: Bench[K10CR1], fault: str
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
        await asyncio.sleep(0.15)
        assert await stage.move_to(25.0) == pytest.approx(25.0, abs=STEP)

    bench.run(scenario, bench.driver(timeout=0.05))


def test_readings_that_never_agree_are_no_angle(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("from 1 drift")
        with pytest.raises(ProtocolError, match="something else each time"):
            await stage.position()

    bench.run(scenario)


def test_a_move_that_is_lost_on_the_way_is_not_sent_again_and_not_taken_for_an_arrival(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.befall("at 5 lose-request")  # after two readings of the position and two of the state
        with pytest.raises(DeviceTimeout, match="did not begin to move"):
            await stage.move_to(30.0)
        assert bench.axis.position() == 0.0
        assert await stage.move_to(30.0) == pytest.approx(30.0, abs=STEP)

    bench.run(scenario, bench.driver(timeout=1.0))


def test_homing_stops_what_is_under_way_first(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        under_way = bench.clock.hold()
        move = asyncio.create_task(stage.move_to(80.0))
        await under_way.wait()
        move.cancel()
        bench.clock.released.set()
        await stage.home()
        assert await stage.position() == 0.0

    bench.run(scenario)


def test_what_the_mount_sends_unasked_is_passed_over(bench: Bench[K10CR1]) -> None:
    async def scenario(stage: K10CR1) -> None:
        bench.simulator.answer(thorlabs.hw_start_updatemsgs(0x50, 0x01))
        assert await stage.move_to(12.0) == pytest.approx(12.0, abs=STEP)
        assert "55123456" in await stage.identity()

    bench.run(scenario)
