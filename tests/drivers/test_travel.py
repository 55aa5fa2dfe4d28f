"""A motion is given the time it needs, and no more."""

import asyncio

import pytest

from drivers.errors import DeviceFault, DeviceRefused, DeviceTimeout
from drivers.interfaces import StagePhase, StageState
from drivers.travel import check_arrival, check_limits, travel_time, wait_for_rest
from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis


@pytest.mark.parametrize("distance", [0.01, 4.99, 5.0, 5.01, 60.0, -60.0])
def test_the_expected_time_is_the_time_that_a_motor_takes(distance: float) -> None:
    clock = SimulatedClock()
    axis = Axis(clock, velocity=10, acceleration=20, limits=(-90, 90))
    axis.move(distance)
    expected = travel_time(distance, 10, 20)
    clock.advance_to(expected - 1e-6)
    assert axis.moving()
    clock.advance_to(expected + 1e-6)
    assert not axis.moving()


@pytest.mark.parametrize("angle", [-5.001, 90.001, float("nan"), float("inf")])
def test_an_angle_outside_the_limits_is_refused_with_the_limits(angle: float) -> None:
    with pytest.raises(DeviceRefused, match=r"sample stage.*-5° to 90°"):
        check_limits("sample stage", angle, (-5.0, 90.0))


def test_a_stage_that_stopped_short_is_noticed() -> None:
    check_arrival("sample stage", 30.0, 30.09)
    with pytest.raises(DeviceFault, match=r"29\.800° instead of 30\.000°"):
        check_arrival("sample stage", 30.0, 29.8)


def test_a_motion_that_never_ends_is_given_up() -> None:
    clock = SimulatedClock()

    async def ask() -> StageState:
        return StageState(StagePhase.MOVING, 1.0)

    with pytest.raises(DeviceTimeout, match="still moving"):
        asyncio.run(wait_for_rest("stage", clock, ask, expected=4.0, at_most=11.0))
    assert clock.now() == pytest.approx(11, abs=2)


def test_time_that_other_tasks_let_pass_is_no_timeout() -> None:
    clock = SimulatedClock()
    axis = Axis(clock, velocity=10, acceleration=20, limits=(-90, 90))
    axis.move(45.0)

    async def ask() -> StageState:
        state = StageState(StagePhase.MOVING if axis.moving() else StagePhase.READY, axis.position())
        clock.advance_to(1000.0)
        return state

    state = asyncio.run(wait_for_rest("stage", clock, ask, expected=0.0, at_most=10.0))
    assert state.position == 45.0
