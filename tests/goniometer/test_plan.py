"""The plan is judged against the paper's own reflectance model on a grid of 0.1 degrees."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from analysis.directions import round_aperture
from analysis.fresnel import load_conductor
from analysis.models import measured_cook_torrance
from goniometer.campaign import Campaign, Sample
from goniometer.geometry import Geometry
from goniometer.plan import (
    Measured,
    PlanSpec,
    blocked_ranges,
    expected_total,
    next_points,
    plan_spec,
    reference_points,
    segments,
    uniform_grid_size,
)

BANDS = np.array([450.0, 550.0, 650.0, 800.0])
SPEC = PlanSpec((0.0, 30.0, 60.0, 80.0))
APERTURE = round_aperture(1.0)


def cosine_brdf(geometries, alpha, h=0.0, w=0.0):
    theta_in = np.array([g.theta_in for g in geometries])
    theta_out = np.array([g.theta_out for g in geometries])
    brdf = measured_cook_torrance(theta_in, theta_out, BANDS, alpha, load_conductor(), APERTURE, h, w)
    return np.cos(np.radians(theta_in))[:, None] * brdf


def measure(batch, alpha, noise, random):
    values = cosine_brdf(batch, alpha)
    u = noise * values + 1e-4
    return [Measured(g, v, s) for g, v, s in zip(batch, values + u * random.normal(size=u.shape), u, strict=True)]


@cache
def run(spec, alpha, noise=0.003, seed=1):
    """All points of a sampling, and its batches."""
    random = np.random.default_rng(seed)
    measured, batches = [], []
    while batch := next_points(spec, measured):
        batches.append(batch)
        measured += measure(batch, alpha, noise, random)
    return measured, batches


def largest_error(spec, measured, alpha):
    """Of ln(1 + cos f) read between the points by a monotone cubic."""
    worst = 0.0
    for theta_in in spec.theta_in:
        for low, high in segments(spec, theta_in):
            points = [p for p in measured if p.geometry.theta_in == theta_in and low <= p.geometry.theta_out <= high]
            if len(points) < 2:
                continue
            points.sort(key=lambda p: p.geometry.theta_out)
            grid = np.arange(low, high, 0.1)
            read = PchipInterpolator(
                [p.geometry.theta_out for p in points], np.log1p(np.maximum([p.values for p in points], 0))
            )(grid)
            truth = np.log1p(cosine_brdf([Geometry(theta_in, float(t)) for t in grid], alpha))
            worst = max(worst, float(np.abs(read - truth).max()))
    return worst


def uniform(spec):
    grid = [Geometry(t, float(o)) for t in spec.theta_in for o in range(-85, 86)]
    return [g for g in grid if not g.blocked]


@pytest.mark.parametrize("alpha", [0.364, 0.18, 0.1, 0.05, 0.02])
def test_a_sample_is_resolved_within_the_tolerance_with_a_third_of_the_points_of_one_degree(alpha):
    measured, _ = run(SPEC, alpha, noise=0.001)
    assert largest_error(SPEC, measured, alpha) < SPEC.tolerance * 1.2
    assert len(measured) < uniform_grid_size(SPEC) / 3


def test_a_mirror_is_resolved_better_than_by_one_degree_with_a_third_of_the_points():
    measured, _ = run(SPEC, 0.0045)
    grid = measure(uniform(SPEC), 0.0045, 0.003, np.random.default_rng(2))
    assert largest_error(SPEC, measured, 0.0045) < largest_error(SPEC, grid, 0.0045) / 2
    assert len(measured) < uniform_grid_size(SPEC) / 3


def test_the_detector_never_stands_in_the_beam():
    spec = PlanSpec((0.0, 0.1, 0.3, 28.64788975654116, 42.7, 70.0, 80.0, 85.0))
    measured, _ = run(spec, 0.05)
    everything = [p.geometry for p in measured] + reference_points(spec)
    assert not any(g.blocked for g in everything)
    assert all(-85 <= g.theta_out <= 85 for g in everything)
    assert blocked_ranges(spec)[70.0] == (-75.0, -65.0)
    for theta_in in (0.0, 42.7, 70.0):
        near = sorted(abs(g.detector_angle) for g in everything if g.theta_in == theta_in)
        assert near[0] == pytest.approx(5.0)
        assert near[1] == pytest.approx(5.0)


def test_the_mirror_direction_is_always_measured():
    for theta_in in SPEC.theta_in[1:]:
        assert Geometry(theta_in, theta_in) in next_points(SPEC, [])


def test_the_same_points_in_any_order_give_the_same_batch_so_that_a_resume_goes_on_alike():
    measured, batches = run(SPEC, 0.0045)
    shuffled = list(measured[: len(batches[0])])
    np.random.default_rng(0).shuffle(shuffled)
    assert next_points(SPEC, shuffled) == batches[1]
    assert len(batches) > 2


def test_no_direction_is_measured_twice():
    measured, _ = run(SPEC, 0.02)
    assert len({p.geometry for p in measured}) == len(measured)


def test_points_keep_the_smallest_distance():
    measured, _ = run(SPEC, 0.0045)
    for theta_in in SPEC.theta_in:
        angles = sorted(p.geometry.theta_out for p in measured if p.geometry.theta_in == theta_in)
        assert min(np.diff(angles)) >= SPEC.minimum_step


def test_noise_is_not_chased():
    quiet, _ = run(SPEC, 0.18, noise=0.0)
    noisy, _ = run(SPEC, 0.18, noise=0.1)
    assert len(noisy) < 1.3 * len(quiet)


def test_failed_points_are_left_alone_and_the_sampling_still_ends():
    random, measured = np.random.default_rng(3), []
    while batch := next_points(SPEC, measured):
        new = measure(batch, 0.05, 0.003, random)
        lost = random.random(len(new)) < 0.3
        nothing = np.full(4, np.nan)
        measured += [Measured(p.geometry, nothing, nothing) if gone else p for p, gone in zip(new, lost, strict=True)]
    assert len({p.geometry for p in measured}) == len(measured)


def test_the_sample_stage_moves_once_an_incident_angle_in_each_pass():
    _, batches = run(SPEC, 0.0045)
    for batch in batches:
        moves = sum(a.theta_in != b.theta_in for a, b in pairwise(batch))
        assert moves == len({g.theta_in for g in batch}) - 1
    # Every other sweep runs backwards, so the arm does not travel back empty.
    coarse = batches[0]
    ends = [(a, b) for a, b in pairwise(coarse) if a.theta_in != b.theta_in]
    assert all(abs(a.theta_out - b.theta_out) < 15 for a, b in ends)


def test_the_expected_number_of_points_is_right_within_a_tenth_after_the_coarse_sweep():
    for alpha in (0.364, 0.18, 0.0045):
        measured, batches = run(SPEC, alpha)
        after_coarse = measured[: len(batches[0])]
        assert expected_total(SPEC, after_coarse) == pytest.approx(len(measured), rel=0.1)


def test_one_degree_has_162_directions_at_normal_incidence():
    assert uniform_grid_size(PlanSpec((0.0,))) == 171 - 9


def test_the_campaign_decides_what_is_sampled():
    campaign = Campaign.model_validate(
        {
            "name": "a",
            "samples": [Sample(name="s", material="m")],
            "incident": [20, 10],
            "outgoing": {"start": -40, "stop": 60},
            "resolution": {"tolerance": 0.1, "coarse_step": 20, "minimum_step": 2},
        }
    )
    spec = plan_spec(campaign)
    assert spec == PlanSpec((10.0, 20.0), -40.0, 60.0, 0.1, 20.0, 2.0)
    assert {g.theta_in for g in next_points(spec, [])} == {10.0, 20.0}
    assert max(g.theta_out for g in next_points(spec, [])) == 60
