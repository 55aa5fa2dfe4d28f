"""The plan is judged against the paper's own reflectance model on a grid of half a degree."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from analysis.reflectance.directions import round_aperture
from analysis.reflectance.fresnel import load_conductor
from goniometer.bench.route import Motion, StageMotion, travel
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import predict_values
from goniometer.plans.learning import learnt_from
from goniometer.plans.plan import Measured, expected_total, first_points, interpolation, next_points, reached
from goniometer.plans.plan_spec import (
    PlanSpec,
    blocked_ranges,
    plan_spec,
    reference_points,
    segments,
    uniform_grid_size,
)
from tests.measured_lobe import measured_cook_torrance

BANDS = np.array([450.0, 550.0, 650.0, 800.0])
SPEC = PlanSpec((0.0, 30.0, 60.0, 80.0), tolerance=0.002, colour_tolerance=None)
APERTURE = round_aperture(1.0)


def cosine_brdf(geometries, alpha, h=0.8, w=4.0):
    theta_in = np.array([g.theta_in for g in geometries])
    theta_out = np.array([g.theta_out for g in geometries])
    brdf = measured_cook_torrance(theta_in, theta_out, BANDS, alpha, load_conductor(), APERTURE, h, w)
    return np.cos(np.radians(theta_in))[:, None] * brdf


def measure(batch, alpha, noise, random, seconds=2.0):
    values = cosine_brdf(batch, alpha)
    u = noise * values + 1e-5
    return [
        Measured(g, v, s, seconds) for g, v, s in zip(batch, values + u * random.normal(size=u.shape), u, strict=True)
    ]


@cache
def run(spec, alpha, noise=0.001, seed=1):
    """All points of a sampling, and its batches."""
    random = np.random.default_rng(seed)
    measured, batches = [], []
    while batch := next_points(spec, measured):
        batches.append(batch)
        measured += measure(batch, alpha, noise, random)
    return measured, batches


def errors(spec, measured, alpha):
    """Of ln(1 + cos f) as the plan reads it between its points."""
    grid = [Geometry(t, float(x)) for t in spec.theta_in for a, b in segments(spec, t) for x in np.arange(a, b, 0.5)]
    at = np.array([g.theta_in for g in grid]), np.array([g.theta_out for g in grid])
    read, _ = predict_values(interpolation(spec, measured), *at)
    return np.log1p(read) - np.log1p(cosine_brdf(grid, alpha))


@pytest.mark.parametrize("alpha", [0.364, 0.1, 0.02, 0.0045])
def test_a_sample_is_as_accurate_as_asked_with_a_tenth_of_the_points_of_one_degree(alpha):
    measured, _ = run(SPEC, alpha)
    found = np.sqrt(np.mean(errors(SPEC, measured, alpha) ** 2))
    assert found < 2 * SPEC.tolerance
    assert len(measured) < uniform_grid_size(SPEC) / 7
    told = reached(SPEC, measured)
    assert told.stopped in {"accuracy", "noise"}
    assert told.error <= max(SPEC.tolerance, told.noise_error)
    assert told.points == len(measured)
    assert told.seconds == 2.0 * len(measured)


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


def test_mirror_direction_ends_and_edges_of_the_blocked_sector_are_always_measured():
    coarse = next_points(SPEC, [])
    for t in SPEC.theta_in[1:]:
        assert Geometry(t, t) in coarse
    for t in SPEC.theta_in:
        for part in segments(SPEC, t):
            assert {Geometry(t, end) for end in part} <= set(coarse)
    assert len(coarse) / len(SPEC.theta_in) < 10


def test_the_off_specular_peak_is_measured():
    measured, _ = run(SPEC, 0.364)
    brightest = max((p for p in measured if p.geometry.theta_in == 60.0), key=lambda p: p.values.mean()).geometry
    grid = [Geometry(60.0, float(x)) for x in np.arange(0, 85, 0.5)]
    values = cosine_brdf(grid, 0.364).mean(axis=1)
    peak = grid[int(np.argmax(values))].theta_out
    assert peak > 65  # it lies well beyond the mirror direction
    assert cosine_brdf([brightest], 0.364).mean() > 0.97 * values.max()


def test_the_same_points_give_the_same_batch_so_that_a_resume_goes_on_alike():
    spec = PlanSpec(SPEC.theta_in, tolerance=0.0005, colour_tolerance=None)
    measured, batches = run(spec, 0.0045)
    assert len(batches) > 2
    learnt_from.cache_clear()  # another process
    begun = 0
    for batch in batches:
        assert next_points(spec, list(measured[:begun])) == batch
        begun += len(batch)


def test_the_next_batch_can_be_planned_before_the_last_points_are_measured():
    measured, batches = run(SPEC, 0.0045)
    begun = len(batches[0])
    ahead = next_points(SPEC, measured[: begun - 3], pending=batches[0][-3:])
    assert not set(ahead) & {p.geometry for p in measured[:begun]}
    assert ahead


def test_no_direction_is_measured_twice_and_points_keep_the_smallest_distance():
    spec = PlanSpec(SPEC.theta_in, tolerance=0.0003, colour_tolerance=None, minimum_step=0.5)
    measured, _ = run(spec, 0.0045)
    assert len({p.geometry for p in measured}) == len(measured)
    for theta_in in spec.theta_in:
        angles = sorted(p.geometry.theta_out for p in measured if p.geometry.theta_in == theta_in)
        assert min(np.diff(angles)) >= spec.minimum_step - 1e-6


def test_noise_is_not_chased_and_the_result_says_so():
    spec = PlanSpec(SPEC.theta_in, tolerance=1e-5, colour_tolerance=None)
    noisy, _ = run(spec, 0.18, noise=0.1)
    assert len(noisy) < uniform_grid_size(spec) / 5
    told = reached(spec, noisy)
    assert told.stopped == "noise"
    assert told.error > spec.tolerance


def test_errors_of_the_stages_on_the_flank_of_a_mirror_are_not_chased():
    random = np.random.default_rng(4)
    spec = PlanSpec(SPEC.theta_in, tolerance=0.005, colour_tolerance=None, u_angle=0.03, most_points=200)
    measured = []
    while batch := next_points(spec, measured):
        sample, detector = 0.03 * random.normal(size=(2, len(batch)))
        stood = [Geometry(g.theta_in + s, g.theta_out + d - s) for g, s, d in zip(batch, sample, detector, strict=True)]
        values = cosine_brdf(stood, 0.0045)
        measured += [Measured(g, v, 0.001 * v + 1e-5) for g, v in zip(batch, values, strict=True)]
    told = reached(spec, measured)
    assert told.stopped in {"noise", "accuracy"}
    assert len(measured) < 60
    assert told.noise_error > 0.002


def test_failed_points_are_left_alone_and_the_sampling_still_ends():
    random, measured = np.random.default_rng(3), []
    nothing = np.full(4, np.nan)
    while batch := next_points(SPEC, measured):
        new = measure(batch, 0.05, 0.003, random)
        lost = random.random(len(new)) < 0.3
        measured += [Measured(p.geometry, nothing, nothing) if gone else p for p, gone in zip(new, lost, strict=True)]
    assert len({p.geometry for p in measured}) == len(measured)
    assert reached(SPEC, measured).stopped is not None


def test_where_all_points_fail_the_sampling_ends_after_the_coarse_pass():
    nothing = np.full(4, np.nan)
    measured = [Measured(g, nothing, nothing) for g in next_points(SPEC, [])]
    assert next_points(SPEC, measured) == []
    assert np.isnan(reached(SPEC, measured).error)


def test_a_budget_of_points_or_of_time_ends_the_sampling_and_says_so():
    few = PlanSpec(SPEC.theta_in, tolerance=1e-4, colour_tolerance=None, most_points=45)
    measured, _ = run(few, 0.0045)
    assert len(measured) == 45
    assert reached(few, measured).stopped == "points"
    assert reached(few, measured).error > 0
    short = PlanSpec(SPEC.theta_in, tolerance=1e-4, colour_tolerance=None, most_seconds=100.0)
    measured, _ = run(short, 0.0045)
    assert 80 < sum(p.seconds for p in measured) <= 100.0
    assert reached(short, measured).stopped == "seconds"


@pytest.mark.parametrize("mode", ["uniform", "dynamic"])
def test_a_first_pass_that_takes_longer_than_allowed_is_cut_short(mode):
    short = PlanSpec(SPEC.theta_in, tolerance=1e-4, colour_tolerance=None, mode=mode, most_seconds=30.0)
    assert len(first_points(short)) > 25
    random, measured = np.random.default_rng(0), []
    while batch := next_points(short, measured):
        for point in measure(batch, 0.2, 0.001, random):
            measured.append(replace(point, seconds=1.0 + 0.03 * len(measured)))
    assert 25 < sum(p.seconds for p in measured) < 32
    assert reached(short, measured).stopped == "seconds"
    assert len({p.geometry for p in measured}) == len(measured)


def test_colour_alone_can_be_what_is_asked_for():
    loose = PlanSpec(SPEC.theta_in, tolerance=1.0, colour_tolerance=1.0)
    strict = PlanSpec(SPEC.theta_in, tolerance=1.0, colour_tolerance=0.1)
    assert len(run(strict, 0.0045)[0]) > len(run(loose, 0.0045)[0])
    assert reached(strict, run(strict, 0.0045)[0]).colour_error <= 0.1


def test_directions_that_do_not_matter_are_not_refined():
    def forward(theta_in, theta_out):
        return (theta_out > 0).astype(float)

    spec = PlanSpec(SPEC.theta_in, tolerance=0.0005, colour_tolerance=None, importance=forward)
    _, batches = run(spec, 0.02)
    later = [g for batch in batches[1:] for g in batch]
    assert len(later) > 0
    assert np.mean([g.theta_out > -5 for g in later]) > 0.9


def test_a_uniform_grid_is_measured_whole_and_nothing_else():
    spec = PlanSpec((0.0, 40.0), step=5.0, mode="uniform")
    grid = next_points(spec, [])
    assert len(grid) == uniform_grid_size(spec, 5.0) == expected_total(spec, [])
    assert all(abs(g.theta_out / 5 - round(g.theta_out / 5)) < 1e-9 and not g.blocked for g in grid)
    measured = measure(grid, 0.2, 0.001, np.random.default_rng(0))
    assert next_points(spec, measured) == []
    assert reached(spec, measured).stopped == "grid"


def test_the_sample_stage_moves_once_an_incident_angle_in_each_pass():
    _, batches = run(SPEC, 0.0045)
    for batch in batches:
        moves = sum(a.theta_in != b.theta_in for a, b in pairwise(batch))
        assert moves == len({g.theta_in for g in batch}) - 1
    loose = PlanSpec(SPEC.theta_in, motion=Motion(detector=StageMotion(backlash=5.0)))
    path = next_points(loose, [])
    assert travel(path, loose.motion).seconds <= travel(batches[0], loose.motion).seconds


def test_the_expected_number_of_points_is_about_right_after_the_coarse_sweep():
    for alpha in (0.364, 0.18, 0.0045):
        measured, batches = run(SPEC, alpha)
        assert expected_total(SPEC, []) == len(batches[0])
        assert 0.6 < expected_total(SPEC, measured[: len(batches[0])]) / len(measured) < 1.7


def test_one_degree_has_162_directions_at_normal_incidence():
    assert uniform_grid_size(PlanSpec((0.0,))) == 171 - 9


def test_the_campaign_decides_what_is_sampled():
    campaign = Campaign.model_validate(
        {
            "name": "a",
            "samples": [Sample(name="s", material="m")],
            "incident": [20, 10],
            "outgoing": {"start": -40, "stop": 60},
            "resolution": {"tolerance": 0.1, "step": 20, "minimum_step": 2, "points": 50, "time": "2 min"},
        }
    )
    spec = plan_spec(campaign)
    assert spec == PlanSpec((10.0, 20.0), -40.0, 60.0, 0.1, 20.0, 2.0, most_points=50, most_seconds=120.0)
    assert {g.theta_in for g in first_points(spec)} == {10.0, 20.0}
    assert max(g.theta_out for g in first_points(spec)) == 60
