"""The pre-scan is judged by lobes whose place is known and by integrals worked out by hand."""

import numpy as np
import pytest

from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import predict_values
from goniometer.plans.plan import Measured, interpolation, next_points, reached
from goniometer.plans.plan_spec import PlanSpec, segments
from goniometer.plans.sweep import Swept, searched, summits, unexplained

SPEC = PlanSpec((30.0,), tolerance=0.005, colour_tolerance=None)
NARROW = 1.5
"""Full width at half maximum, degrees."""


def sheet(place, height):
    """A diffuse sheet with one narrow lobe, and its cos f in two bands."""

    def brdf(theta_in, theta_out):
        lobe = height * np.exp(-4 * np.log(2) * ((theta_out - place) / NARROW) ** 2)
        return (0.05 + lobe)[:, None] * np.array([1.0, 1.1])

    return brdf


def intervals(parts, step):
    """Of theta_out, degrees, one after the other; a part's last one ends with it."""
    return [(a, min(a + step, high)) for low, high in parts for a in np.arange(low, high, step).tolist()]


def averaged(brdf, theta_in, interval):
    """[bands] of a function [points, bands] of theta_in and theta_out, averaged over an interval of theta_out."""
    low, high = interval
    count = max(int(np.ceil((high - low) / 0.1)), 1)
    at = low + (np.arange(count) + 0.5) * (high - low) / count
    return brdf(np.full(count, theta_in), at).mean(axis=0)


def swept(brdf, random):
    readings = []
    for start, stop in intervals(segments(SPEC, 30.0), 2.0):
        value = averaged(brdf, 30.0, (start, stop))
        noise = np.hypot(0.003 * value, 1e-4)
        readings.append(Swept(30.0, start, stop, value + noise * random.normal(size=2), noise))
    return readings


def sampled(brdf, readings, random):
    measured = []
    while batch := next_points(SPEC, measured, readings):
        value = brdf(np.array([g.theta_in for g in batch]), np.array([g.theta_out for g in batch]))
        value = value * (1 + 0.001 * random.normal(size=value.shape))
        measured += [Measured(g, v, 0.001 * v) for g, v in zip(batch, value, strict=True)]
    return measured


@pytest.mark.parametrize("place", [-71.3, -49.1, 8.7, 52.6, 77.7])
@pytest.mark.parametrize("height", [0.02, 1.0, 50.0])
def test_no_lobe_hides_from_the_pre_scan(place, height):
    random = np.random.default_rng(abs(round(place * height)))
    brdf = sheet(place, height)
    measured = sampled(brdf, swept(brdf, random), random)
    found, _ = predict_values(interpolation(SPEC, measured), np.array([30.0]), np.array([place]))
    assert found[0, 0] - 0.05 == pytest.approx(height, rel=0.4)


def test_without_a_lobe_the_pre_scan_asks_for_nothing():
    random = np.random.default_rng(1)
    brdf = sheet(0.0, 0.0)
    readings = swept(brdf, random)
    measured = sampled(brdf, [], random)
    assert unexplained(interpolation(SPEC, measured), readings, [p.geometry for p in measured]) == []
    assert len(sampled(brdf, readings, random)) <= len(measured) + 4
    assert reached(SPEC, measured, readings).stopped is not None


def test_a_reading_is_the_average_over_its_interval():
    def square(theta_in, theta_out):
        return np.stack([theta_out**2, theta_in], axis=1)

    assert averaged(square, 30.0, (1.0, 3.0)) == pytest.approx([26 / 6, 30.0], rel=1e-3)


def test_the_search_splits_the_largest_gap_and_ends_at_the_smallest_step():
    reading = Swept(30.0, 10.0, 12.0, np.zeros(1), np.zeros(1))
    assert searched(reading, np.array([]), 0.2) == Geometry(30.0, 11.0)
    assert searched(reading, np.array([9.0, 11.0, 11.4]), 0.2) == Geometry(30.0, 10.5)
    assert searched(reading, np.arange(10.0, 12.1, 0.3), 0.2) is None


def test_what_stands_above_its_neighbours_is_examined_until_three_points_lie_in_it():
    readings = [
        Swept(30.0, 2.0 * i, 2.0 * i + 2, np.full(2, value), np.full(2, 0.01))
        for i, value in enumerate([1.0, 1.01, 1.0, 1.2, 1.0, 2.0, 3.0])
    ]
    assert summits(readings, []) == [readings[3]]
    assert summits(readings[::-1], [Geometry(30.0, 6.5), Geometry(30.0, 7.0)]) == [readings[3]]
    assert summits(readings, [Geometry(30.0, x) for x in (6.5, 7.0, 7.5)]) == []


@pytest.mark.parametrize(("read", "complained"), [(0.5, False), (2.0, True)])
def test_a_saturated_reading_says_how_bright_it_is_at_least(read, complained):
    random = np.random.default_rng(1)
    measured = sampled(sheet(0.0, 0.0), [], random)
    process = interpolation(SPEC, measured)
    value = np.array([0.05, 0.055]) * read
    for saturated in (True, False):
        reading = Swept(30.0, 20.0, 22.0, value, 0.001 * value, saturated=saturated)
        assert bool(unexplained(process, [reading], [])) is (complained or not saturated)
