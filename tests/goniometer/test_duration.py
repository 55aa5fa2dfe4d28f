"""Expected times are judged by sums worked out by hand and by drawing."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from goniometer.bench.route import Motion, StageMotion, travel
from goniometer.campaigns.campaign import Campaign, Integration, Monitor, Sample
from goniometer.geometry import Geometry
from goniometer.scans import duration
from goniometer.scans.duration import (
    DARKS,
    DEAD_TIME,
    STRAY_SCANS,
    Foreseen,
    Visit,
    besides,
    dead_time,
    expected,
    latest,
    remaining,
    unknown_darks,
    visits,
)
from goniometer.scans.exposure import PROBE_FRACTION
from goniometer.storage.records import Expected, ExposureTime, Point

MOTION = Motion(StageMotion(10.0, 20.0, settling=0.5), StageMotion(10.0, 20.0, settling=0.5))
PATH = [Geometry(10.0, float(x)) for x in range(0, 60, 10)]
POLICY = Integration(minimum=0.1, maximum=10.0, scans=2)


def test_before_anything_is_measured_a_sample_may_be_bright_or_dark():
    told = expected(PATH, MOTION, POLICY)
    fixed = travel(PATH, MOTION).seconds + 6 * (DEAD_TIME + 10.0 * PROBE_FRACTION)
    drawn = np.exp(np.random.default_rng(0).uniform(np.log(0.1), np.log(10.0), 200_000))
    drawn[::2] = 10.0  # too dim for the longest time
    assert told.seconds == pytest.approx(fixed + 12 * drawn.mean(), rel=0.01)
    assert told.low == pytest.approx(fixed + 12 * 0.1)
    assert told.high == pytest.approx(fixed + 12 * 10.0)
    assert expected(PATH, MOTION, POLICY, dead_time=2.5).low == pytest.approx(told.low + 6 * (2.5 - DEAD_TIME))


def test_a_wanted_ratio_may_take_all_the_time_that_it_is_given():
    wanted = POLICY.model_copy(update={"signal_to_noise": 100.0, "time_limit": 40.0, "exposures": 3})
    fixed = travel(PATH, MOTION).seconds + 6 * (DEAD_TIME + 10.0 * PROBE_FRACTION)
    assert expected(PATH, MOTION, wanted).high == pytest.approx(fixed + 6 * (40.0 + 2 * 10.0))


def test_one_integration_time_leaves_no_doubt():
    told = expected(PATH, MOTION, Integration(minimum=2.0, maximum=2.0))
    assert told.low == told.seconds == told.high


def test_parts_that_are_long_for_one_reason_are_long_together():
    assert Expected(10.0, 5.0, 20.0) + Expected(1.0, 0.5, 2.0) == Expected(11.0, 5.5, 22.0)


def test_looks_at_the_lamp_stray_light_and_darks_are_counted():
    campaign = Campaign(
        name="A",
        samples=(Sample(name="A", material="mirror"),),
        monitor=Monitor(every=100.0),
        integration=Integration(maximum=4.0),
    )
    detour = 2 * MOTION.detector.seconds(0.0, 45.0) + 2 * 0.5
    look = Expected(2.0, 1.0, 4.0)
    told = besides(campaign, MOTION, 3, Expected(450.0, 0.0, 1000.0), 4.0, look, Expected(10.0, 0.0, 100.0))
    facing = 3 * (STRAY_SCANS * 4.0 + detour)
    assert told.seconds == pytest.approx(facing + (1 + (450 + facing + 10) / 100) * (2.0 + detour) + 10.0)
    assert told.low == pytest.approx(facing + (1 + facing // 100) * (1.0 + detour))
    assert told.high == pytest.approx(facing + (1 + (1100 + facing) // 100 + 1) * (4.0 + detour) + 100.0)
    nothing = campaign.model_copy(update={"monitor": None, "stray_light": False})
    assert besides(nothing, MOTION, 3, told, 4.0, look, Expected(1.0, 1.0, 1.0)) == Expected(1.0, 1.0, 1.0)
    # of 4 s, 2 s, 1 s, ... down to 8 ms
    assert unknown_darks(nothing).high == pytest.approx(DARKS * (sum(4.0 / 2**i for i in range(9)) + 0.008))


def stored(
    seconds: Sequence[float],
    *,
    attempts: int = 1,
    session: str = "a",
    besides: Sequence[Sequence[tuple[Geometry | None, float]]] = (),
    start: int = 0,
) -> tuple[list[Point], list[ExposureTime]]:
    """Points of `PATH` with one light exposure of 1 s each, and before some of them others: kind by geometry."""
    points, exposures = [], []
    for i, (geometry, taken) in enumerate(zip(PATH[start:], seconds, strict=False), start=start):
        for place, time in besides[i] if i < len(besides) else ():
            kind = "dark" if place is None else "monitor"
            exposures.append(ExposureTime(len(exposures) + 1, kind, None, place, session, time))
        points.append(Point(i + 1, 1, i, geometry, geometry, "done", attempts, "", taken, None))
        exposures.append(ExposureTime(len(exposures) + 1, "light", i + 1, geometry, session, 0.25))
        exposures.append(ExposureTime(len(exposures) + 1, "light", i + 1, geometry, session, 0.75))
    return points, exposures


def test_what_a_point_takes_beyond_its_moves_and_integration_is_dead_time_and_monitors_and_darks_are_not():
    moves = [MOTION.seconds(a, b) for a, b in pairwise(PATH)]
    there = Geometry(30.0, 30.0)
    detour = MOTION.seconds(PATH[1], there) + MOTION.seconds(there, PATH[2])
    seconds = [99.0, moves[0] + 1 + 0.7, detour + 5.0 + 20.0 + 1 + 0.9]
    found = visits(*stored(seconds, besides=[[], [], [(None, 20.0), (there, 5.0)]]), MOTION)
    assert [v.geometry for v in found] == PATH[1:3]
    assert [v.exposure for v in found] == [1.0, 1.0]
    assert [v.dead for v in found] == pytest.approx([0.7, 0.9])


def test_nothing_is_learnt_from_a_point_after_a_fault_a_restart_or_a_sweep():
    seconds = [1 + 0.7 + m for m in [0.0, *(MOTION.seconds(a, b) for a, b in pairwise(PATH))]]
    assert len(visits(*stored(seconds), MOTION)) == 5
    assert visits(*stored(seconds, attempts=2), MOTION) == []
    points, exposures = stored(seconds, besides=[[], [], [(PATH[2], 1.0)]])
    swept = [replace(e, kind="sweep") if e.kind == "monitor" else e for e in exposures]
    assert [v.geometry for v in visits(points, swept, MOTION)] == [PATH[1], *PATH[3:]]
    first, second = stored(seconds[:3]), stored(seconds[3:], session="b", start=3)
    assert len(visits(first[0] + second[0], first[1] + second[1], MOTION)) == 2 + 2


def test_the_latest_visits_are_the_same_without_the_exposures_of_older_ones(monkeypatch):
    monkeypatch.setattr(duration, "LATEST", 3)
    seconds = [1 + 0.1 * i + m for i, m in enumerate([0.0, *(MOTION.seconds(a, b) for a, b in pairwise(PATH))])]
    points, exposures = stored(seconds, besides=[[], [(PATH[3], 1.0)], [], [], [(None, 2.0)], []])
    found = latest(exposures)
    assert {each.point_id for each in found} == {None, 3, 4, 5, 6}
    assert visits(points, found, MOTION) == visits(points, exposures, MOTION)[-3:]
    assert latest(exposures[:7]) == exposures[:7]


def test_points_to_come_are_like_those_near_them_and_as_uncertain_as_neighbours_are():
    seen = [Visit(Geometry(t, t + x), 1.0 if abs(x) < 5 else 9.0, 0.5) for t in (0.0, 40.0) for x in (-20, -1, 1, 20)]
    assert dead_time(seen) == pytest.approx(0.5)
    batch = [Geometry(40.0, 40.0), Geometry(40.0, 80.0), Geometry(60.0, 60.5), Geometry(60.0, 85.0)]
    legs = [3.0, 5.0, 7.0, 9.0]
    told = remaining(seen, batch, legs, 3, Foreseen(13, 11, 15), 8)
    assert told.seconds == pytest.approx((5 + 7 + 9) + (9 + 1 + 9) + 3 * 0.5 + 2 * (6.0 + 0.5 + 5.0))
    assert told.low < told.seconds < told.high
    sure = [Visit(v.geometry, 2.0, 0.5) for v in seen]
    told = remaining(sure, batch, legs, 3, Foreseen(11, 11, 11), 8)
    assert told.low == told.seconds == told.high == pytest.approx(21.0 + 3 * 2.5)
