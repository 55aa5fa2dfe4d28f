"""Rays do on a height map what closed forms and another tracer say, and none of them gets lost."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import FloatArray
from simulators.errors import UnfitRays, UnfitTopography
from simulators.materials.surfaces import Reflectance
from simulators.rays.rays import VirtualScan, beam, tabulated, terrain, trace, virtual_scan, weights
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation

NM = np.array([400.0, 600.0, 800.0])
INDEX = load_conductor().index(NM)


def aluminium(cosine: FloatArray) -> FloatArray:
    return fresnel_conductor(cosine, *INDEX)


def lossless(cosine: FloatArray) -> FloatArray:
    return np.ones_like(cosine)


def at(degrees: float) -> FloatArray:
    return np.array([np.cos(np.radians(degrees))])


def groove(wall: float, cells: int, periodic: bool) -> HeightField:
    """Symmetric V-grooves along y with walls of `wall` degrees, `cells` wide."""
    x = np.arange(4 * cells + (0 if periodic else 1)) % cells
    profile = np.abs(x - cells / 2) * np.tan(np.radians(wall))
    return HeightField(np.tile(profile, (24, 1)), 1.0, periodic)


ROUGH = gaussian(2.4, gaussian_correlation(9.0), 200, 0.8, seed=1)


@pytest.mark.parametrize("theta_in", [0.0, 33.0, 80.0])
@pytest.mark.parametrize("azimuth", [0.0, 57.0])
def test_a_flat_mirror_sends_all_light_where_a_mirror_does(theta_in: float, azimuth: float) -> None:
    flat = HeightField(np.full((20, 30), 1.5), 0.7, True)
    out = np.array([-theta_in - 5, theta_in, theta_in - 3])
    scan = virtual_scan(flat, theta_in, out, aluminium, 2000, seed=1, azimuth=azimuth)
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(0.5)))
    fresnel = fresnel_conductor(at(theta_in), *INDEX)
    np.testing.assert_allclose(scan.brdf[1, 0], fresnel / np.cos(np.radians(theta_in)) / solid_angle, rtol=1e-6)
    assert scan.brdf[[0, 2]].max() == 0
    assert scan.escaped[1] == 1
    np.testing.assert_allclose(scan.reflected[1], fresnel, rtol=1e-6)


@pytest.mark.parametrize("periodic", [True, False])
def test_a_v_groove_reflects_once_or_twice_as_plane_geometry_says(periodic: bool) -> None:
    # At 40 degrees, light from above leaves its first wall 10 degrees above the horizon. Over the opposite ridge goes
    # what was reflected higher than (tan 40 - tan 10) / (tan 40 + tan 10) of the wall; the rest turns up, 70 degrees.
    wall, rays = np.radians(40), 200_000
    once = 2 * np.tan(np.radians(10)) / (np.tan(wall) + np.tan(np.radians(10)))
    surface = terrain(groove(40, 32, periodic))
    paths = trace(surface, *beam(surface, 0.0, rays, seed=2))
    assert paths.escaped.all() or not periodic
    seen = paths.escaped & (paths.reflections == 1)
    if not periodic:  # what left over the outer ridges went through the side or over it
        seen = seen | paths.lost
    assert seen.mean() == pytest.approx(once, abs=4 * np.sqrt(once * (1 - once) / rays))
    twice = paths.reflections == 2
    assert (seen | twice).all()
    np.testing.assert_allclose(paths.cosines[twice, :3], np.tile([np.cos(wall), 0.5, 0], (twice.sum(), 1)), atol=1e-9)
    np.testing.assert_allclose(paths.directions[twice, 2], np.sin(np.radians(70)), atol=1e-9)
    product = weights(paths, tabulated(aluminium))[twice][0]
    np.testing.assert_allclose(
        product, fresnel_conductor(at(40), *INDEX) * fresnel_conductor(at(60), *INDEX), rtol=1e-6
    )


def test_a_spherical_dent_spreads_light_from_above_as_its_closed_form() -> None:
    # A cap of radius R reflects at r = R sin(theta / 2), each ray once: f = R^2 / (4 patch area x cos theta) up to
    # twice the slope of its rim, nothing beyond, and the plane around it keeps what falls on it.
    size, radius, rim = 640, 700.0, np.radians(21)
    y, x = np.indices((size, size)) - size / 2
    sphere = radius * np.cos(rim) - np.sqrt(radius**2 - np.minimum(x**2 + y**2, (radius * np.sin(rim)) ** 2))
    out = np.array([-35.0, -20.0, -10.0, 15.0, 30.0, 50.0])
    scan = virtual_scan(HeightField(sphere, 1.0, True), 0.0, out, lossless, 1_000_000, seed=3, aperture=4.0)
    expected = radius**2 / (4 * size**2 * np.cos(np.radians(out)))
    expected[-1] = 0
    departure = (scan.brdf[:, 0, 0] - expected)[:-1] / scan.u_brdf[:-1, 0, 0]
    assert np.abs(departure).max() < 3.5
    assert (scan.u_brdf[:-1, 0, 0] < 0.04 * expected[:-1]).all()
    assert scan.brdf[-1].max() == 0
    assert scan.escaped[1] == 1


@pytest.mark.slow
def test_an_independent_tracer_finds_the_same_number_of_reflections_for_the_same_rays() -> None:
    pytest.importorskip("embreex")
    from tests.embree_tracer import embree  # noqa: PLC0415

    rays, limit = 1_000_000, 24
    patch = HeightField(ROUGH.heights_um, ROUGH.pitch_um, False)
    surface = terrain(patch)
    origins, directions = beam(surface, 55.0, rays, seed=4, azimuth=20.0)
    paths = trace(surface, origins, directions, limit)
    other = embree(patch, origins, directions, limit)
    ours = np.bincount(paths.reflections[paths.escaped], minlength=limit + 1)
    assert np.abs(ours - other.escaped).max() / rays < 1e-4
    assert abs(int(paths.lost.sum()) - other.lost) / rays < 1e-4
    assert ours[1:5].min() > 1000  # there was something to compare


@pytest.mark.parametrize("shape", [(37, 53), (64, 16)])
def test_a_tile_repeats_without_a_seam(shape: tuple[int, int]) -> None:
    tile = ROUGH.heights_um[: shape[0], : shape[1]]
    one, wall = (terrain(HeightField(heights, 0.8, True)) for heights in (tile, np.tile(tile, (3, 2))))
    origins, directions = beam(one, 62.0, 20_000, seed=5, azimuth=200.0)
    a, b = (trace(surface, origins, directions) for surface in (one, wall))
    same = a.reflections == b.reflections
    assert same.mean() > 0.9995  # a ray that grazes an edge may go either way
    np.testing.assert_allclose(a.directions[same], b.directions[same], atol=1e-6)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("theta_in", [5.0, 75.0])
def test_every_ray_is_accounted_for(periodic: bool, theta_in: float) -> None:
    field = HeightField(ROUGH.heights_um, ROUGH.pitch_um, periodic)
    scan = virtual_scan(field, theta_in, np.array([0.0]), aluminium, 50_000, seed=6, limit=2)
    assert scan.escaped.sum() + scan.lost + scan.stopped == pytest.approx(1, abs=1e-12)
    assert scan.stopped > 0
    assert (scan.lost > 0) is not periodic
    every = virtual_scan(field, theta_in, np.array([0.0]), lossless, 50_000, seed=6)
    assert every.reflected.sum() + every.lost == pytest.approx(1, abs=1e-12)
    assert every.stopped == 0
    assert (scan.reflected.sum(axis=0) < 0.95).all()  # aluminium takes its part


def test_light_goes_back_the_way_it_came() -> None:
    angles = np.array([0.0, 25.0, 50.0, 70.0])
    signed = np.concatenate([angles, -angles])

    def scan(theta_in: float, azimuth: float) -> VirtualScan:
        return virtual_scan(ROUGH, theta_in, signed, aluminium, 300_000, seed=7, aperture=5.0, azimuth=azimuth)

    towards, back = ([scan(theta, azimuth) for theta in angles] for azimuth in (0.0, 180.0))
    z = []
    for i in range(4):
        for o in range(4):
            # forward: the way back comes from the other side; backward: lamp and detector change places
            for one, other, place in ((towards[i], back[o], 0), (towards[i], towards[o], 4)):
                if i < o:
                    for order in (0, 1):
                        u = np.hypot(one.u_brdf[o + place, order, 1], other.u_brdf[i + place, order, 1])
                        z.append((one.brdf[o + place, order, 1] - other.brdf[i + place, order, 1]) / u)
    assert len(z) == 24
    assert np.mean(np.square(z)) < 1.9  # chi squared of 24 exceeds that once in 200


def test_the_stated_error_of_a_bin_is_the_scatter_between_runs() -> None:
    scans = [virtual_scan(ROUGH, 40.0, np.array([30.0, 60.0]), lossless, 20_000, s, 6.0) for s in range(40)]
    values = np.array([scan.brdf[:, :2, 0] for scan in scans])
    stated = np.sqrt(np.mean([scan.u_brdf[:, :2, 0] ** 2 for scan in scans], axis=0))
    np.testing.assert_allclose(values.std(axis=0, ddof=1) / stated, 1, atol=0.35)


def test_the_result_does_not_depend_on_the_number_of_threads() -> None:
    arguments: tuple[HeightField, float, FloatArray, Reflectance, int, int] = (
        ROUGH,
        30.0,
        np.linspace(-60, 60, 7),
        aluminium,
        100_000,
        8,
    )
    with ThreadPoolExecutor(3) as executor:
        threads = virtual_scan(*arguments, executor=executor)
    alone = virtual_scan(*arguments)
    np.testing.assert_array_equal(threads.brdf, alone.brdf)
    np.testing.assert_array_equal(threads.u_brdf, alone.u_brdf)
    np.testing.assert_array_equal(threads.reflected, alone.reflected)


def test_rays_that_cannot_be_traced_are_refused_with_the_reason() -> None:
    surface = terrain(ROUGH)
    origins, directions = beam(surface, 30.0, 3, seed=1)
    with pytest.raises(UnfitRays, match=r"Ray 1 of 3 .* above its highest point"):
        trace(surface, origins - [[0, 0, 0], [0, 0, 1], [0, 0, 0]], directions)
    with pytest.raises(UnfitRays, match="length one"):
        trace(surface, origins, directions * 1.1)
    with pytest.raises(UnfitRays, match="stay below 90 deg"):
        virtual_scan(ROUGH, 30.0, np.array([89.8]), lossless, 100, seed=1)
    holes = ROUGH.heights_um.copy()
    holes[3, 4] = np.nan
    with pytest.raises(UnfitTopography, match="fill it first"):
        terrain(HeightField(holes, 1.0, True))
