"""The bench as the thing that is measured: on the wire, with known imperfections, and against closed forms."""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2

import simulators.bench.laboratory
from drivers.interfaces import Spectrum
from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.characterisation.alignment import Sweep, evaluate_alignment
from goniometer.characterisation.characterise import (
    measure_alignment,
    measure_noise,
    measure_repeatability,
    measure_signature,
    measure_wavelengths,
)
from goniometer.characterisation.evaluation import FAR, evaluate_returns
from goniometer.characterisation.lines import Line, evaluate_lines
from goniometer.characterisation.meter import Reading, Series, binned, reading, series
from goniometer.characterisation.peaks import centre_and_width, edge, propagated, u_edge
from goniometer.constants import BenchData, Constants
from goniometer.errors import CharacterisationError
from goniometer.geometry import Geometry
from simulators.bench.imperfections import Imperfections, drawn
from simulators.bench.optics import (
    FULL_SCALE,
    GAIN,
    NONLINEARITY_COEFFICIENTS,
    READ_NOISE,
    dark_rate,
    positioning_error,
)
from simulators.materials.materials import material, true_brdf
from tests.campaign_bench import bench as campaign_bench
from tests.optical_bench import Bench

ALPHA = 0.0045
"""Of the mirror, GGX."""


@asynccontextmanager
async def bench(seed=1, imperfections=None):
    """An instrument in a simulated laboratory, and what mounts a piece there."""
    drawn_anew = drawn(seed, BenchData()) if imperfections is None else imperfections
    async with campaign_bench(seed, drawn_anew) as (instrument, _, laboratory):

        async def mount(piece):
            laboratory.mount(piece)

        yield instrument, mount


def measured(procedure, seed=1, imperfections=None):
    """What `procedure(instrument, mount)` finds on a fresh bench."""

    async def scenario():
        async with bench(seed, imperfections) as (instrument, mount):
            return await procedure(instrument, mount)

    return asyncio.run(scenario())


def spectrum(counts, time=1.0):
    return Spectrum(counts, time, 1, -10.0)


def constants(wavelengths, **values):
    data = BenchData(**values)
    return Constants("QE Pro", {}, wavelengths, np.array(NONLINEARITY_COEFFICIENTS), FULL_SCALE, data)


# --- peaks and edges -------------------------------------------------------------------------------------------


def test_a_narrow_beam_seen_through_the_round_aperture_is_as_wide_as_the_aperture():
    x = np.arange(-2, 2.01, 0.1)
    for middle, blur in ((0.0, 0.1), (0.237, 0.15)):
        y = ndtr((x - middle + 0.5) / blur) - ndtr((x - middle - 0.5) / blur)
        centre, width = centre_and_width(x, y)
        assert centre == pytest.approx(middle, abs=2e-3)
        assert width == pytest.approx(1.0, abs=5e-3)


def test_the_uncertainty_of_a_peak_is_its_scatter_under_the_errors_of_the_stages():
    random = np.random.default_rng(5)
    x = np.arange(-1.5, 1.51, 0.1)
    y = np.exp(-4 * np.log(2) * x**2)

    def found(error, noise):
        y_there = np.exp(-4 * np.log(2) * (x + error) ** 2) * (1 + noise)
        return centre_and_width(x, y_there)

    trials = [found(random.normal(0, 0.01, x.size), random.normal(0, 0.003, x.size)) for _ in range(600)]
    u = propagated(centre_and_width, x, y, 0.01, 0.003 * y)
    assert np.std(trials, axis=0) == pytest.approx(u, rel=0.12)


def test_a_sweep_that_ends_on_the_peak_is_refused_and_not_read_as_a_peak():
    x = np.arange(-0.3, 2, 0.1)
    with pytest.raises(CharacterisationError, match="ends before the peak"):
        centre_and_width(x, np.exp(-(x**2)))


@pytest.mark.parametrize("width", [0.01, 0.1, 0.3])
def test_an_edge_lies_in_the_middle_of_its_penumbra_however_wide(width):
    x = np.arange(3.5, 6.5, 0.01)
    assert edge(x, 120 + 5000 * ndtr((x - 4.95) / width)) == pytest.approx(4.95, abs=1e-4)


@pytest.mark.parametrize(("u_x", "step"), [(0.005, 0.01), (0.02, 0.04), (0.0005, 0.01)])
def test_the_uncertainty_of_an_edge_is_its_scatter_under_the_errors_of_the_stage(u_x, step):
    random = np.random.default_rng(2)
    x = step * np.arange(-12, 13)
    places = random.uniform(-step / 2, step / 2, 2000)
    found = [edge(x, (x + random.normal(0, u_x, x.size) > place).astype(float)) - place for place in places]
    assert np.std(found) == pytest.approx(u_edge(x, u_x), rel=0.1)
    assert np.mean(found) == pytest.approx(0, abs=4 * u_edge(x, u_x) / np.sqrt(2000))


# --- the meter -------------------------------------------------------------------------------------------------


def test_the_stated_noise_of_a_reading_is_the_scatter_of_repeated_readings():
    lit = Bench("spectralon").turn(0, 45)
    facts = constants(lit.wavelengths)
    found = [
        reading(
            Geometry(0, 45),
            [spectrum(lit.read(2.0)) for _ in range(2)],
            np.stack([lit.read(2.0, light=False) for _ in range(4)]),
            facts,
        )
        for _ in range(60)
    ]
    scatter = np.std([r.rate for r in found], axis=0, ddof=1)
    stated = np.mean([np.hypot(r.u, r.u_dark) for r in found], axis=0)
    assert np.sqrt(np.mean((scatter / stated) ** 2)) == pytest.approx(1, abs=0.03)


def test_a_band_with_a_pixel_that_was_ever_saturated_is_left_out_and_a_dazzled_detector_is_refused():
    wavelengths = np.linspace(380, 995, 60)
    saturated = np.zeros(60, dtype=bool)
    saturated[7] = True
    plain = Reading(Geometry(30, 30), 1.0, np.arange(60.0), np.ones(60), np.ones(60), np.zeros(60, dtype=bool))
    found = series([plain, replace(plain, saturated=saturated)], wavelengths)
    assert found.rate[0].tolist() == [2.5, *np.arange(14.5, 60, 6)]
    assert found.u == pytest.approx(1 / np.sqrt(6))
    with pytest.raises(CharacterisationError, match="dim the light"):
        series([replace(plain, saturated=~np.zeros(60, dtype=bool))], wavelengths)


# --- signature -------------------------------------------------------------------------------------------------


def through_the_aperture(offset, diameter):
    """Relative signal of the mirror's lobe at an angle from its middle, degrees, for theta_in = 30 degrees.

    The density of half vectors of GGX for small angles, averaged over a round aperture: half vectors tilt by half of
    an angle in plane, and by half of it over cos(theta_in) across the plane.
    """
    side = (np.arange(400) + 0.5) / 400 - 0.5
    x, y = np.meshgrid(diameter * side, diameter * side)
    inside = x**2 + y**2 < (diameter / 2) ** 2
    tilt = np.hypot((x + offset) / 2, y / 2 / np.cos(np.radians(30)))[inside]
    return np.mean((1 + (np.radians(tilt) / ALPHA) ** 2) ** -2)


@pytest.mark.parametrize("aperture_error", [0.2, pytest.param(0.0, marks=pytest.mark.slow)])
def test_the_signature_is_as_wide_as_the_aperture_makes_the_mirrors_lobe(aperture_error):
    found = measured(measure_signature, imperfections=Imperfections(aperture_error=aperture_error))
    offsets = np.arange(-2, 2.01, 0.05)
    profile = np.array([through_the_aperture(offset, 1 + aperture_error) for offset in offsets])
    _, width = centre_and_width(offsets, profile)
    assert abs(found.width - width) < 3 * found.u_width < 0.02
    assert abs(found.centre) < 3 * found.u_centre < 0.04


def test_the_floor_of_the_signature_is_the_stray_light_and_the_tail_of_the_mirror():
    stray = 1e-3
    found = measured(measure_signature, imperfections=Imperfections(stray_light=stray))
    far = np.abs(found.angle) > FAR
    theta_out = found.theta_in + np.append(found.angle[far], 0.0)
    brdf = true_brdf(material("mirror"), np.full(theta_out.shape, found.theta_in), theta_out, found.wavelengths)
    light = np.cos(np.radians(found.theta_in)) * brdf + stray
    expected = light[:-1].mean(axis=0) / light[-1]
    score = (found.floor - expected) / found.u_floor
    assert abs(score.mean()) < 3 / np.sqrt(score.size) + 0.05 * np.mean(expected / found.u_floor)
    assert score.std() == pytest.approx(1, abs=0.35)
    assert found.u_floor_level < 0.1 * found.floor_level


# --- noise -----------------------------------------------------------------------------------------------------


def test_the_noise_equivalent_brdf_follows_from_read_noise_dark_current_and_response():
    errors = Imperfections(stray_light=3e-4)
    found = measured(partial(measure_noise, certificate=NOMINAL_SRS99), imperfections=errors)
    panel = Bench("spectralon").turn(0, 45)
    brdf = true_brdf(material("spectralon"), np.array([0.0]), np.array([45.0]), panel.wavelengths)[0]
    response = binned(panel.signal(4.0) / 4.0 / brdf, panel.wavelengths)
    electrons = dark_rate(-10.0) + errors.stray_light * response
    variance = READ_NOISE**2 + 1 / 12 + electrons * found.integration_time / GAIN
    expected = np.sqrt(variance / 6) / (response * found.integration_time)
    ratio = np.sqrt(np.mean((found.brdf / expected) ** 2))
    assert abs(ratio - 1) < 3 * found.u_ratio < 0.05
    assert abs(found.ratio - 1) < 3 * found.u_ratio
    assert np.median(found.predicted / expected) == pytest.approx(1, abs=0.02)
    assert abs(found.stray_level - errors.stray_light) < 3 * found.u_stray_level < 0.5 * errors.stray_light


# --- alignment -------------------------------------------------------------------------------------------------


def test_zeros_follow_from_places_that_obey_the_geometry_whatever_the_peaks_lean():
    sample_zero, detector_zero, lean, edge_of_sector = 0.31, -0.17, 0.004, 4.95

    def sweep(kind, sample, place):
        nothing = np.zeros(3)
        return Sweep(kind, sample, nothing, nothing, nothing, place, 0.002)

    sweeps = []
    for angle in (10.0, 40.0, 70.0):
        leaning = lean * np.tan(np.radians(angle))
        sweeps.append(sweep("mirror", angle, 2 * (angle + sample_zero) - detector_zero + leaning))
    sweeps += [sweep("upper edge", 0.0, edge_of_sector - detector_zero)]
    sweeps += [sweep("lower edge", 0.0, -edge_of_sector - detector_zero)]
    found = evaluate_alignment(sweeps, 0.005)
    assert (found.sample_zero, found.detector_zero, found.lean) == pytest.approx((sample_zero, detector_zero, lean))
    assert found.u_detector_zero == pytest.approx(0.002 / np.sqrt(2))
    assert found.chi_square == pytest.approx(0, abs=1e-9)
    assert found.consistent


@pytest.mark.parametrize(
    "seed", [1, 2, pytest.param(3, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow)]
)
def test_the_zeros_of_both_stages_are_found_within_their_stated_uncertainty(seed):
    large = {1: {"sample_zero": 0.7, "detector_zero": -1.3}}.get(seed, {})
    truth = replace(drawn(seed, BenchData()), **large)
    found = measured(measure_alignment, seed, truth)
    assert abs(found.sample_zero - truth.sample_zero) < 3 * found.u_sample_zero < 0.015
    assert abs(found.detector_zero - truth.detector_zero) < 3 * found.u_detector_zero < 0.01
    assert found.consistent


def test_no_edge_is_invented_where_the_panel_is_missing():
    async def scenario():
        async with bench() as (instrument, mount):

            async def forgotten(piece):
                await mount("nothing" if piece == "spectralon" else piece)

            with pytest.raises(CharacterisationError, match="whether the panel is mounted"):
                await measure_alignment(instrument, forgotten, mirror_angles=(30.0,))

    asyncio.run(scenario())


# --- repeatability ---------------------------------------------------------------------------------------------


def test_scatter_and_backlash_follow_from_a_signal_on_a_flank():
    random = np.random.default_rng(8)
    returns, slope, scatter, backlash, noise = 2000, -2.5, 0.004, 0.03, 0.003
    wanted = 60 + random.uniform(-0.05, 0.05, returns)
    from_above = random.random(returns) < 0.5
    true = wanted + random.normal(0, scatter, returns) + backlash * from_above
    signal = 1000 * (1 + slope * (true - 60) + random.normal(0, noise, returns))
    u = np.full((returns, 1), 1000 * noise)
    seen = Series(np.array([600.0]), np.full(returns, 30.0), wanted, signal[:, None], u, 0 * u)
    found = evaluate_returns("detector", wanted, from_above, seen)
    assert found.scatter == pytest.approx(scatter, abs=4 * found.u_scatter)
    assert found.backlash == pytest.approx(backlash, abs=4 * found.u_backlash)
    assert found.read_back == 0


@pytest.mark.parametrize("u_angle", [0.005, 0.02])
def test_a_run_of_returns_tells_how_well_each_stage_repeats(u_angle, monkeypatch):
    monkeypatch.setattr(simulators.bench.laboratory, "positioning_error", partial(positioning_error, std_deg=u_angle))
    found = measured(partial(measure_repeatability, returns=20))
    # on the simulated bench the detector stage errs anew wherever the sample stage stands, which adds half of its error
    for stage, true in ((found.detector, u_angle), (found.sample, u_angle * np.sqrt(1 + 1 / 4))):
        freedom = stage.degrees_of_freedom
        low, high = chi2.ppf(np.array([0.001, 0.999]), freedom)
        assert low < freedom * (stage.scatter / true) ** 2 < high
        assert abs(stage.backlash) < 4 * stage.u_backlash
    assert found.u_angle == max(found.detector.scatter, found.sample.scatter)


def test_no_repeatability_is_told_from_a_signal_that_does_not_depend_on_the_angle():
    random = np.random.default_rng(1)
    angle, rate = np.arange(10.0), 1000 + random.normal(0, 1, (10, 1))
    seen = Series(np.array([600.0]), angle, angle, rate, np.ones((10, 1)), np.zeros((10, 1)))
    with pytest.raises(CharacterisationError, match="whether the mirror is mounted"):
        evaluate_returns("sample", angle, np.arange(10) % 2 == 0, seen)


# --- wavelengths -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_the_wavelength_offset_is_found_within_its_stated_uncertainty(seed):
    truth = replace(drawn(seed, BenchData()), wavelength_offset=(-1.2, -0.4, -0.03, 0.05, 0.3, 1.5)[seed])
    found = measured(measure_wavelengths, seed, truth)
    assert abs(found.offset - truth.wavelength_offset) < 3 * found.u_offset < 0.005
    assert len(found.lines) > 12
    assert abs(found.slope) < 4 * found.u_slope
    # a line of 1.6 nm through pixels of about 0.78 nm
    through_pixels = float(np.hypot(1.6, 0.78 * np.sqrt(8 * np.log(2) / 12)))
    assert np.median([line.width for line in found.lines]) == pytest.approx(through_pixels, rel=0.01)


def test_a_scale_that_is_stretched_shows_a_slope():
    known = np.array([435.8335, 546.075, 696.5431, 763.5106, 912.2967])
    found = evaluate_lines(tuple(Line("Hg", k, k - 0.1 - 2e-4 * (k - 700), 0.002, 1.6) for k in known))
    assert found.slope == pytest.approx(2e-4)
    assert abs(found.slope) > 10 * found.u_slope


def test_a_lamp_that_is_off_gives_no_offset():
    async def scenario():
        async with bench() as (instrument, mount):

            async def dark(_):
                await mount("nothing")

            with pytest.raises(CharacterisationError, match=r"0 lines .* stand clear"):
                await measure_wavelengths(instrument, dark)

    asyncio.run(scenario())
