"""Expected times are judged by sums worked out by hand and by drawing."""

from itertools import pairwise

import numpy as np
import pytest

from goniometer.campaign import Integration
from goniometer.duration import DEAD_TIME, Expected, expected, point_time
from goniometer.exposure import PROBE_FRACTION
from goniometer.geometry import Geometry
from goniometer.route import Motion, StageMotion, travel

MOTION = Motion(StageMotion(10.0, 20.0, settling=0.5), StageMotion(10.0, 20.0, settling=0.5))
PATH = [Geometry(10.0, float(x)) for x in range(0, 60, 10)]
POLICY = Integration(minimum=0.1, maximum=10.0)


def test_before_anything_is_measured_a_sample_may_be_bright_or_dark():
    told = expected(PATH, MOTION, POLICY, scans=2)
    fixed = travel(PATH, MOTION).seconds + 6 * (DEAD_TIME + 10.0 * PROBE_FRACTION)
    drawn = np.exp(np.random.default_rng(0).uniform(np.log(0.1), np.log(10.0), 200_000))
    assert told.seconds == pytest.approx(fixed + 12 * drawn.mean(), rel=0.01)
    assert told.low == pytest.approx(fixed + 12 * 0.1)
    assert told.high == pytest.approx(fixed + 12 * (drawn.mean() + 2 * drawn.std()), rel=0.01)


def test_afterwards_it_is_as_the_measured_points_were():
    integration = [1.0, 1.2, 0.8, 1.0, 1.1, 0.9]
    moves = [MOTION.seconds(a, b) for a, b in pairwise(PATH)]
    seconds = [9.0, *(m + t + 0.7 for m, t in zip(moves, integration[1:], strict=True))]
    seconds[3] += 60  # a fault was recovered from
    known = point_time(seconds, integration, PATH, MOTION)
    assert known.dead == pytest.approx(0.7)
    told = expected(PATH, MOTION, POLICY, scans=1, known=known)
    assert told.seconds == pytest.approx(sum(moves) + 6 * 0.7 + 6 * 1.0)
    assert told.low < told.seconds < told.high
    assert told.high - told.low < 0.2 * told.seconds


def test_one_integration_time_leaves_no_doubt():
    told = expected(PATH, MOTION, Integration(minimum=2.0, maximum=2.0), scans=1)
    assert told.low == told.seconds == told.high


def test_parts_that_are_long_for_one_reason_are_long_together():
    assert Expected(10.0, 5.0, 20.0) + Expected(1.0, 0.5, 2.0) == Expected(11.0, 5.5, 22.0)
