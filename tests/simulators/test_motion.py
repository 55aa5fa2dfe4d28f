"""A simulated axis moves as a motor does."""

import numpy as np
import pytest

from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis


def make_axis(clock: SimulatedClock, **changes: object) -> Axis:
    settings = {"velocity": 10.0, "acceleration": 20.0, "limits": (-90.0, 180.0)} | changes
    return Axis(clock, **settings)


def test_a_long_move_takes_the_time_of_a_trapezoid() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock)
    axis.move(45.0)
    # ramps of 0.5 s over 2.5 degrees each, and 40 degrees at 10 degrees/s between them
    clock.advance_to(0.5)
    assert axis.position() == pytest.approx(2.5)
    clock.advance_to(4.5)
    assert axis.position() == pytest.approx(42.5)
    clock.advance_to(4.999)
    assert axis.moving()
    clock.advance_to(5.0)
    assert not axis.moving()
    assert axis.position() == 45.0


def test_a_short_move_never_reaches_full_speed() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock, start=3.0)
    axis.move(2.8)
    # 0.2 degrees = 2 * (20 / 2) t^2
    clock.advance_to(0.1)
    assert axis.position() == pytest.approx(2.9)
    clock.advance_to(0.200001)
    assert not axis.moving()
    assert axis.position() == 2.8


def test_a_stop_brakes_and_does_not_jump() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock)
    axis.move(45.0)
    clock.advance_to(2.0)
    at_stop = axis.position()
    axis.stop()
    assert axis.position() == pytest.approx(at_stop)
    clock.advance_to(10.0)
    assert axis.position() == pytest.approx(at_stop + 10**2 / (2 * 20))
    assert not axis.moving()


def test_position_and_speed_never_jump_when_a_motion_is_replaced() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock)
    axis.move(45.0)
    times = np.arange(0, 12, 0.01)
    positions = []
    for moment in times:
        clock.advance_to(float(moment))
        if moment == times[200]:
            axis.move(-10.0)
        positions.append(axis.position())
    speeds = np.diff(positions) / 0.01
    assert np.abs(speeds).max() <= 10 + 1e-9
    assert np.abs(np.diff(speeds) / 0.01).max() <= 20 + 1e-6
    assert positions[-1] == -10.0


def test_the_stage_stands_off_its_read_back_by_the_positioning_error() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock, positioning_error=lambda target: 0.01 * target)
    axis.move(30.0)
    clock.advance_to(60.0)
    assert axis.position() == 30.0
    assert axis.true_positions(np.array([clock.now()])) == pytest.approx([30.3])


def test_it_is_known_where_the_stage_was_at_any_moment_of_its_motion() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock, positioning_error=lambda target: 0.01 * target)
    clock.advance_to(3.0)
    axis.move(45.0)
    clock.advance_to(9.0)
    # ramps of 0.5 s over 2.5 degrees each, and 40 degrees at 10 degrees/s between them
    seen = axis.true_positions(np.array([1.0, 3.0, 3.5, 5.5, 7.5, 8.0, 9.0]))
    assert seen - 0.45 == pytest.approx([0, 0, 2.5, 22.5, 42.5, 45, 45])


def test_homing_ends_at_zero_and_is_told_apart_from_a_move() -> None:
    clock = SimulatedClock()
    axis = make_axis(clock, start=20.0)
    axis.home()
    assert axis.homing()
    clock.advance_to(60.0)
    assert not axis.homing()
    assert axis.position() == 0.0
    axis.move(5.0)
    assert axis.moving()
    assert not axis.homing()


def test_an_axis_cannot_leave_its_mechanics() -> None:
    with pytest.raises(ValueError, match="-90° to 180°"):
        make_axis(SimulatedClock()).move(181.0)
