"""What is filled is judged by a reciprocal model, and never looks like a measurement."""

import numpy as np
import pytest

from analysis.directions import in_plane
from analysis.fresnel import load_conductor
from analysis.models import cook_torrance
from goniometer.fill import Filled, blocked_directions, interpolated, partner, reciprocal
from goniometer.geometry import Geometry
from goniometer.plan import Measured, PlanSpec, interpolation, next_points

SPEC = PlanSpec((0.0, 20.0, 40.0, 60.0), colour_tolerance=None, tolerance=0.003)
BANDS = np.array([450.0, 550.0, 650.0])


def metal(geometries):
    theta_in, theta_out = np.array([g.theta_in for g in geometries]), np.array([g.theta_out for g in geometries])
    brdf = cook_torrance(in_plane(theta_in, theta_out), BANDS, 0.3, load_conductor(), 1.0, 3.0)
    return brdf * np.cos(np.radians(theta_in))[:, None]


def measured(geometries, seed=0):
    random, values = np.random.default_rng(seed), metal(geometries)
    noisy = values * (1 + 0.002 * random.normal(size=values.shape))
    return [Measured(g, v, 0.002 * v) for g, v in zip(geometries, noisy, strict=True)]


def test_a_direction_is_filled_from_its_reciprocal_partner_with_an_uncertainty_that_holds():
    known = measured(
        [Geometry(t, x) for t in SPEC.theta_in for x in (-60.0, -40.0, 20.0, 40.0, 60.0) if abs(t + x) > 5]
    )
    wanted = [Geometry(40.0, 0.0), Geometry(60.0, 20.0), Geometry(20.0, -60.0), Geometry(30.0, 7.0)]
    filled = reciprocal(wanted, known)
    # 40, 0 was measured as 0, 40; 60, 20 as 20, 60; 20, -60 as 60, -20, which nobody measured; 30, 7 by nobody
    assert [f.geometry for f in filled] == wanted[:2]
    truth = metal(wanted[:2])
    for one, value in zip(filled, truth, strict=True):
        assert one.by == "reciprocity"
        assert one.partner == partner(one.geometry)
        assert np.all(np.abs(one.values - value) < 4 * one.u)
        assert np.all(one.u < 0.02 * value)


def test_the_partner_has_the_same_brdf_and_the_detector_as_near_to_the_source():
    for geometry in (Geometry(20.0, 50.0), Geometry(20.0, -50.0), Geometry(0.0, 30.0), Geometry(40.0, -38.0)):
        other = partner(geometry)
        assert partner(other) in {geometry, Geometry(-geometry.theta_in, -geometry.theta_out)}
        assert other.theta_in >= 0
        assert other.blocked == geometry.blocked
        f, g = (metal([x])[0] / np.cos(np.radians(x.theta_in)) for x in (geometry, other))
        assert f == pytest.approx(g)


def test_partners_that_disagree_make_what_is_filled_uncertain():
    pairs = [
        Geometry(20.0, 40.0),
        Geometry(40.0, 20.0),
        Geometry(20.0, 60.0),
        Geometry(60.0, 20.0),
        Geometry(0.0, 40.0),
    ]
    known = measured(pairs)
    skewed = [Measured(p.geometry, p.values * (1.1 if p.geometry.theta_in > 30 else 1.0), p.noise) for p in known]
    wanted = [Geometry(40.0, 0.0)]
    assert reciprocal(wanted, skewed)[0].u / reciprocal(wanted, skewed)[0].values == pytest.approx(0.1, rel=0.2)


def test_the_blocked_sector_is_filled_by_interpolation_within_its_uncertainty():
    points = []
    while batch := next_points(SPEC, points):
        points += measured(batch)
    wanted = blocked_directions(SPEC)
    assert all(g.blocked for g in wanted)
    filled = interpolated(wanted, interpolation(SPEC, points))
    assert {f.by for f in filled} == {"interpolation"}
    assert not any(isinstance(f, Measured) for f in filled)
    assert all(isinstance(f, Filled) for f in filled)
    deviation = np.array([(f.values - v) / f.u for f, v in zip(filled, metal(wanted), strict=True)])
    assert np.sqrt(np.mean(deviation**2)) < 2
    assert np.array([f.values for f in filled]) == pytest.approx(metal(wanted), rel=0.03)
