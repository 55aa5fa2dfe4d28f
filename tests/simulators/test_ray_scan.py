"""A scan with rays keeps its energy, knows its errors, and becomes a dataset that fits understand."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from analysis.fits.local_fit import local_fit
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import FloatArray
from simulators.computed import Computed, computed_dataset
from simulators.errors import UnfitRays, UnfitTopography
from simulators.rays.decomposition import coarser, convergence, halves, jackknife, shares
from simulators.rays.rays import terrain, virtual_scan
from simulators.rays.scan import WINDOWS, Goniometer, RayScan, ray_scan, window
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation

NM = np.arange(400.0, 951.0, 50.0)
INDEX = load_conductor().index(NM)


def aluminium(cosine: FloatArray) -> FloatArray:
    return fresnel_conductor(cosine, *INDEX)


def rough(seed: int, size: int = 256) -> HeightField:
    return gaussian(2.4, gaussian_correlation(9.0), size, 1.0, seed)


ASKED = Goniometer(np.array([0.0, 60.0]), np.arange(-80.0, 81, 8), NM, aluminium, 0, 60_000, 1, 8.0, 0.0)


def scanned(fields: list[HeightField], asked: Goniometer = ASKED) -> RayScan:
    with ThreadPoolExecutor(2) as executor:
        return ray_scan([terrain(field) for field in fields], asked, executor)


@pytest.fixture(scope="module")
def scan() -> RayScan:
    return scanned([rough(1), rough(2)])


@pytest.mark.parametrize("periodic", [True, False])
def test_the_energy_is_accounted_for_to_the_last_ray(periodic: bool) -> None:
    field = replace(rough(3), periodic=periodic)
    found = scanned([field], replace(ASKED, reflectance=lambda cosine: np.ones((*cosine.shape[:-1], NM.size))))
    assert (found.ends.sum(axis=1) == found.traced).all()
    assert (found.escaped.sum(axis=1) == found.ends[:, 0]).all()
    light = found.light.mean(axis=(0, 1)).sum(axis=(1, 2))
    np.testing.assert_allclose(light, np.broadcast_to(found.ends[:, :1] / found.traced, light.shape), atol=1e-12)
    assert (found.ends[:, 1] > 0).all() != periodic


def test_a_mirror_is_found_as_bright_as_fresnel_says_in_its_direction_only() -> None:
    flat = HeightField(np.zeros((64, 64)), 1.0, True)
    found = scanned([flat], replace(ASKED, theta_out=np.array([-60.0, 0.0, 60.0]), aperture=2.0))
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(1)))
    for i, place in ((0, 1), (1, 2)):
        cosine = np.cos(np.radians(ASKED.theta_in[i]))
        expected = fresnel_conductor(np.array([cosine]), *INDEX) / cosine / solid_angle
        np.testing.assert_allclose(found.brdf[i, place], expected, rtol=1e-6)
        assert np.delete(found.brdf[i], place, axis=0).max() == 0
        assert (np.delete(found.u_level[i], place, axis=0) > 0).all()  # no ray is no proof of darkness
    np.testing.assert_allclose(halves(found).share[0, 0], 0.5)


def test_light_keeps_off_the_edges_of_a_measured_patch() -> None:
    field = replace(rough(4), periodic=False)
    surface = terrain(field)
    places = np.array([window(surface, number, 60.0, 30.0) for number in range(WINDOWS**2)])
    extent = surface.extent_um
    assert places.min() >= 0
    assert places[:, 2].max() <= extent[2]
    assert places[:, 3].max() <= extent[3]
    everywhere = virtual_scan(field, 60.0, ASKED.theta_out, aluminium, 60_000, 1, 8.0)
    found = scanned([field], replace(ASKED, theta_in=np.array([60.0])))
    assert found.ends[0, 1] / found.traced < everywhere.lost / 3


def test_the_stated_error_is_the_scatter_between_surfaces_and_seeds() -> None:
    few = replace(ASKED, theta_in=np.array([40.0]), theta_out=np.arange(-40.0, 81, 10), rays=16_000)
    runs = [scanned([rough(10 + seed)], replace(few, seed=seed)) for seed in range(12)]
    scatter = np.std([run.brdf[0, :, 0] for run in runs], axis=0, ddof=1)
    stated = np.sqrt(np.mean([run.u_level[0, :, 0] ** 2 + run.u_spectral[0, :, 0] ** 2 for run in runs], axis=0))
    assert 0.75 < np.sqrt(np.mean((scatter / stated) ** 2)) < 1.35


def test_the_scan_does_not_depend_on_the_threads(scan: RayScan) -> None:
    with ThreadPoolExecutor(1) as executor:
        alone = ray_scan([terrain(rough(1)), terrain(rough(2))], ASKED, executor)
    for name in ("brdf", "u_level", "u_spectral", "by_order", "light", "ends"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(scan, name))


def test_shares_add_up_and_the_brdf_is_the_sum_of_its_orders(scan: RayScan) -> None:
    found, over = shares(scan), halves(scan)
    told = np.isfinite(found.share).all(axis=-1)
    assert told.mean() > 0.5
    np.testing.assert_allclose(found.share[told].sum(axis=-1), 1)
    np.testing.assert_allclose(over.share.sum(axis=(1, 2)), 1)
    np.testing.assert_allclose(scan.by_order.mean(axis=(0, 1)).sum(axis=-1), scan.brdf[..., 0], rtol=1e-12)
    np.testing.assert_allclose(over.share[0, :, 0], over.share[0, :, 1], atol=4 * over.u_share[0].max())


def test_errors_of_a_mean_by_the_jackknife_are_the_closed_form() -> None:
    values = np.random.default_rng(1).normal(size=30)
    value, u = jackknife(lambda parts: np.asarray(values[parts].mean()), 30)
    assert value == pytest.approx(values.mean())
    assert u == pytest.approx(values.std(ddof=1) / np.sqrt(30))


def test_a_pitch_that_is_too_coarse_shows_and_one_that_is_fine_does_not(scan: RayScan) -> None:
    def change(fields: list[HeightField], fine: RayScan) -> float:
        found = convergence(fine, scanned([coarser(field) for field in fields]))
        return abs(next(c for c in found if c.figure.startswith("more than once, of") and c.theta_in == 60).pitch)

    fields = [rough(1), rough(2)]
    coarse = [coarser(coarser(coarser(field))) for field in fields]
    assert change(fields, scan) < 0.02 < change(coarse, scanned(coarse))
    with pytest.raises(UnfitTopography, match="even"):
        coarser(HeightField(np.zeros((5, 6)), 1.0, True))


def test_the_exponent_of_the_local_fit_counts_the_reflections() -> None:
    # walls of 45 degrees send light from above back where it came from, after two reflections at 45 degrees each
    x = np.arange(128) % 32
    grooves = HeightField(np.tile(np.abs(x - 16.0), (128, 1)), 1.0, True)
    for field, reflections in ((grooves, 2), (HeightField(np.zeros((64, 64)), 1.0, True), 1)):
        found = scanned([field], replace(ASKED, theta_in=np.array([0.0]), theta_out=np.array([-4.0, 0.0, 4.0])))
        assert found.escaped[0, reflections] == found.traced
        computed = Computed(
            "grooves",
            np.zeros(3),
            found.asked.theta_out,
            NM,
            found.brdf[0],
            found.u_level[0],
            found.u_spectral[0],
            8.0,
            {"simulated": "rays on grooves"},
        )
        fit = local_fit(computed_dataset(computed))
        assert fit.exponent[1] == pytest.approx(reflections, rel=0.06)
        assert fit.slope[1] == pytest.approx(0, abs=0.02)


def test_angles_that_cannot_be_scanned_are_refused_with_the_reason() -> None:
    for theta_in in ([0.0, 0.0], [-5.0], [88.0], []):
        with pytest.raises(UnfitRays, match="incident angles that differ"):
            replace(ASKED, theta_in=np.array(theta_in))
    with pytest.raises(UnfitRays, match="detector angles"):
        replace(ASKED, theta_out=np.array([0.0, 89.0]))
