"""Paths are judged by the best of all orders, and times by the trapezoid worked out by hand."""

from itertools import combinations, pairwise

import numpy as np
import pytest

from goniometer.bench.route import Motion, StageMotion, ordered, travel
from goniometer.geometry import Geometry

BENCH = Motion(StageMotion(20.0, 40.0, 0.0, 0.2), StageMotion(30.0, 60.0, 0.0, 0.2))
LOOSE = Motion(StageMotion(20.0, 40.0, 1.0, 0.2), StageMotion(30.0, 60.0, 1.0, 0.2))


def best_of_all(points, motion, start, sample_move=1000.0):
    """Seconds of the quickest path of those that move the sample stage least often (Held and Karp 1962)."""

    def seconds(a, b):
        return motion.seconds(a, b) + (sample_move if a.theta_in != b.theta_in else 0.0)

    cost = {(frozenset([i]), i): seconds(start, p) for i, p in enumerate(points)}
    for size in range(2, len(points) + 1):
        for chosen in map(frozenset, combinations(range(len(points)), size)):
            for last in chosen:
                before = chosen - {last}
                cost[chosen, last] = min(cost[before, k] + seconds(points[k], points[last]) for k in before)
    everything = frozenset(range(len(points)))
    return min(cost[everything, k] for k in everything) % (sample_move or np.inf)


@pytest.mark.parametrize("motion", [BENCH, LOOSE], ids=["without backlash", "with backlash"])
def test_a_batch_takes_at_most_a_tenth_longer_than_the_best_of_all_orders(motion):
    random = np.random.default_rng(4)
    for _ in range(12):
        angles = random.choice(np.arange(0, 81, 10.0), 3, replace=False)
        points = {Geometry(float(random.choice(angles)), round(float(random.uniform(-80, 80)), 1)) for _ in range(9)}
        start = Geometry(float(random.choice(angles)), 10.0)
        path = ordered(list(points), motion, start)
        assert sorted(path) == sorted(points)
        assert travel(path, motion, start).seconds <= 1.1 * best_of_all(sorted(points), motion, start)


def test_the_sample_stage_moves_once_for_each_incident_angle():
    random = np.random.default_rng(5)
    points = [Geometry(float(t), float(x)) for t in range(0, 81, 10) for x in random.uniform(-80, 80, 7)]
    path = ordered(points, LOOSE)
    assert travel(path, LOOSE).sample_moves == 8
    assert {a.theta_in for a in path[:7]} in ({0.0}, {80.0})


def test_without_backlash_every_other_incident_angle_is_swept_backwards():
    points = [Geometry(t, x) for t in (0.0, 10.0, 20.0) for x in (-60.0, -20.0, 30.0, 70.0)]
    path = ordered(points, BENCH)
    directions = [np.sign(path[i + 1].theta_out - path[i].theta_out) for i in (0, 4, 8)]
    assert directions[0] == -directions[1] == directions[2]


def test_with_backlash_long_sweeps_go_upwards_and_no_target_is_left_from_above():
    points = [Geometry(t, float(x)) for t in (0.0, 10.0, 20.0) for x in range(-80, 81, 4)]
    path = ordered(points, Motion(BENCH.sample, LOOSE.detector))
    assert all(b.theta_out > a.theta_out for a, b in pairwise(path) if a.theta_in == b.theta_in)


def test_a_move_lasts_as_long_as_its_trapezoid():
    stage = StageMotion(velocity=10.0, acceleration=5.0, backlash=0.0)
    assert stage.seconds(0.0, 100.0) == pytest.approx(10 + 2)  # 2 s up, 2 s down, 8 s at 10 degrees a second
    assert stage.seconds(100.0, 95.0) == pytest.approx(2.0)  # never reaches its speed: 2 sqrt(5 / 5)
    loose = StageMotion(10.0, 5.0, backlash=1.25)
    assert loose.seconds(0.0, 5.0) == pytest.approx(2.0)
    assert loose.seconds(5.0, 0.0) == pytest.approx(2 * np.sqrt(6.25 / 5) + 2 * np.sqrt(1.25 / 5))
    assert loose.degrees(5.0, 0.0) == pytest.approx(7.5)


def test_both_stages_move_at_once_and_the_arm_then_settles():
    a, b = Geometry(0.0, 20.0), Geometry(10.0, 40.0)
    slower = max(BENCH.sample.seconds(0, 10), BENCH.detector.seconds(20, 50))
    assert BENCH.seconds(a, b) == pytest.approx(slower + 0.2)
    assert BENCH.seconds(a, a) == 0.0
    only = Motion(StageMotion(20.0, 40.0, settling=3.0), BENCH.detector)
    assert only.seconds(a, Geometry(0.0, 25.0)) == pytest.approx(BENCH.detector.seconds(0, 5) + 0.2)
    assert only.seconds(a, b) == pytest.approx(slower + 3.0)  # the arm rests when the last swing has died down
    assert travel([b], BENCH, a).detector == pytest.approx(30.0)


def test_nothing_to_visit_is_an_empty_path():
    assert ordered([], BENCH) == []
    assert travel([], BENCH).seconds == 0
