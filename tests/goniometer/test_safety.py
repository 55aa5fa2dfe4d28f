"""Where the arm may go, judged by brute force: on a grid, and by letting the stages move out of step."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniometer.bench.safety import Forbidden, check_standing, safe_path
from goniometer.errors import ConfigurationError, GeometryError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import PlanSpec, reference_points
from goniometer.plans.reach import check_plan

LIMITS = ((0.0, 90.0), (-85.0, 170.0))
SPEC = PlanSpec((0.0, 30.0, 60.0))

angles = st.integers(-40, 40).map(float)
ranges = st.tuples(angles, angles).filter(lambda r: r[0] < r[1])
regions = st.lists(st.builds(Forbidden, ranges, ranges), max_size=4)
standings = st.tuples(angles, angles)


def inside(standing, region, margin=1e-9):
    """Whether the arm hits what the region stands for."""
    return all(
        low + margin < angle < high - margin
        for angle, (low, high) in zip(standing, (region.sample, region.detector), strict=True)
    )


def out_of_step(a, b, chance, steps=60):
    """Where the arm is on a move from `a` to `b` on which each stage advances as it likes."""
    progress = [0.0, 0.0]
    while min(progress) < 1:
        progress = [min(1.0, p + chance.random() ** 4 * 8 / steps) for p in progress]
        yield tuple(start + (end - start) * p for start, end, p in zip(a, b, progress, strict=True))


@settings(max_examples=300, deadline=None)
@given(standings, standings, regions, st.integers(0, 10**6))
def test_no_move_leads_through_a_forbidden_region_however_fast_each_stage_is(start, end, forbidden, seed):
    if any(inside(start, region) for region in forbidden):
        return
    try:
        path = safe_path(start, end, forbidden)
    except GeometryError:
        return
    assert path[-1] == end
    chance = random.Random(seed)
    for a, b in zip([start, *path], path, strict=False):
        for standing in out_of_step(a, b, chance):
            assert not any(inside(standing, region) for region in forbidden), (a, b, standing)


@given(standings, standings)
def test_without_regions_both_stages_move_at_once(start, end):
    assert safe_path(start, end, ()) == [end]


def test_the_arm_goes_around_a_region_one_stage_after_the_other_and_back_the_other_way():
    holder = Forbidden(sample=(20.0, 50.0), detector=(-30.0, 10.0))
    assert safe_path((0.0, 0.0), (60.0, 40.0), [holder]) == [(0.0, 40.0), (60.0, 40.0)]
    assert safe_path((60.0, 40.0), (0.0, 0.0), [holder]) == [(0.0, 40.0), (0.0, 0.0)]


def test_a_move_for_which_there_is_no_way_is_refused_and_says_what_is_in_the_way():
    source = Forbidden(sample=(-10.0, 95.0), detector=(-4.0, 4.0))
    with pytest.raises(GeometryError, match=r"the forbidden region .* the detector stage at -4 to 4 deg is in the way"):
        safe_path((30.0, -20.0), (30.0, 20.0), [source])


def test_a_stage_that_reads_back_a_little_inside_the_edge_it_was_sent_to_is_not_caught_there_for_ever():
    region = Forbidden(sample=(0.0, 30.0), detector=(-90.0, 50.0))
    assert safe_path((29.96, 20.0), (60.0, 20.0), [region]) == [(60.0, 20.0)]
    assert safe_path((29.96, 20.0), (10.0, 60.0), [region]) == [(29.96, 60.0), (10.0, 60.0)]
    with pytest.raises(GeometryError):
        safe_path((25.0, 20.0), (60.0, 20.0), [region])


@pytest.mark.parametrize("bad", [(5.0, 5.0), (5.0, -5.0), (math.nan, 5.0)])
def test_an_empty_region_which_would_protect_nothing_is_refused(bad):
    with pytest.raises(ConfigurationError, match="empty"):
        Forbidden(sample=bad, detector=(0.0, 1.0))
    with pytest.raises(ConfigurationError, match="empty"):
        Forbidden(sample=(0.0, 1.0), detector=bad)


def test_no_standing_outside_the_limits_or_in_a_region_is_let_through():
    region = Forbidden(sample=(20.0, 40.0), detector=(100.0, 170.0))
    check_standing((20.0, 120.0), LIMITS, [region])
    for standing in ((-0.1, 0.0), (90.1, 0.0), (0.0, -85.1), (0.0, 170.1), (30.0, 120.0), (math.nan, 0.0)):
        with pytest.raises(GeometryError, match="not possible"):
            check_standing(standing, LIMITS, [region])


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.sampled_from([0.0, 20.0, 45.0, 70.0, 85.0]), min_size=1, max_size=3, unique=True),
    st.sampled_from([-85.0, -40.0, 10.0]),
    st.sampled_from([30.0, 60.0, 85.0]),
    st.lists(
        st.builds(
            Forbidden,
            st.tuples(st.integers(-10, 40), st.integers(41, 95)).map(lambda r: (float(r[0]), float(r[1]))),
            st.tuples(st.integers(-90, 40), st.integers(41, 175)).map(lambda r: (float(r[0]), float(r[1]))),
        ),
        max_size=2,
    ),
    st.sampled_from([LIMITS, ((0.0, 70.0), (-60.0, 100.0)), ((-5.0, 95.0), (-30.0, 171.0))]),
)
def test_a_plan_is_let_through_only_if_the_arm_can_stand_in_all_of_it(incident, lowest, highest, forbidden, limits):
    spec = PlanSpec(tuple(sorted(incident)), lowest, highest)
    wanted = [
        Geometry(t, lowest + i / 4) for t in spec.theta_in for i in range(round(4 * (highest - lowest)) + 1)
    ] + reference_points(spec)

    def stands(geometry):
        standing = (geometry.sample_angle, geometry.detector_angle)
        within = all(low <= angle <= high for angle, (low, high) in zip(standing, limits, strict=True))
        return within and not any(inside(standing, region) for region in forbidden)

    possible = all(stands(g) for g in wanted if not g.blocked)
    refusal = ""
    try:
        check_plan(spec, limits, forbidden)
    except GeometryError as error:
        refusal = str(error)
    assert possible == (refusal == "" or "is in the way" in refusal)


def test_a_refused_plan_names_the_first_impossible_geometry_and_what_would_be_possible():
    with pytest.raises(
        GeometryError,
        match=r"theta_in = 60, theta_out = 60 to 85 deg is not possible: the detector stage would have to stand at "
        r"120 to 145 deg, outside -85 to 120 deg; possible between -55 and 85 deg is -55 to 60 deg",
    ):
        check_plan(SPEC, ((0.0, 90.0), (-85.0, 120.0)), ())
    with pytest.raises(GeometryError, match=r"theta_in = 60 deg .* the sample stage .* outside 0 to 45 deg"):
        check_plan(SPEC, ((0.0, 45.0), (-85.0, 170.0)), ())
    holder = Forbidden(sample=(20.0, 40.0), detector=(80.0, 90.0))
    with pytest.raises(GeometryError, match=r"theta_in = 30, theta_out = 50 to 60 deg .* is -25 to 50 deg, 60 to 85"):
        check_plan(SPEC, LIMITS, [holder])
    check_plan(SPEC, LIMITS, ())


def test_a_plan_that_needs_the_arm_to_cross_the_source_housing_is_refused_before_the_night():
    source = Forbidden(sample=(-10.0, 95.0), detector=(-4.0, 4.0))
    with pytest.raises(GeometryError, match="in the way"):
        check_plan(SPEC, LIMITS, [source])
    check_plan(PlanSpec((0.0, 30.0), lowest=10.0), LIMITS, [source])
