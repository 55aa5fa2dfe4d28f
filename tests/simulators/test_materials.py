"""What lies on the bench has the BRDF that it says it has, through the aperture that it says."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.errors import OutOfRange
from analysis.reflectance.directions import in_plane, round_aperture, through_aperture
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cook_torrance
from goniometer.certificates.certificate import NOMINAL_SRS99
from simulators.errors import UnknownMaterial
from simulators.materials.materials import (
    DETECTOR_APERTURE,
    EMBOSSED,
    MERCURY_ARGON,
    NOTHING,
    PANEL_CERTIFICATE,
    SAMPLES,
    SPECTRALON,
    Material,
    material,
    true_brdf,
)

MIRROR = SAMPLES["sample-6"]


def brute_force(what: Material, theta_in: float, theta_out: float, wavelengths: np.ndarray) -> np.ndarray:
    """[wavelengths] the analysis floor's own full model, summed over 49,152 directions within the aperture."""
    aperture = round_aperture(DETECTOR_APERTURE, rings=96, spokes=512)
    directions = through_aperture(np.array([theta_in]), np.array([theta_out]), aperture)
    value = cook_torrance(directions, wavelengths, what.alpha, load_conductor(), what.h, what.w)
    return np.asarray(np.einsum("nw,n->w", value[0], aperture.weights))


@pytest.mark.parametrize("name", ["sample-1", "sample-5", "sample-6", "sample-8"])
@pytest.mark.parametrize(("theta_in", "theta_out"), [(10, 10.4), (30, -60), (60, 60), (80, 80.3), (0, 84.8)])
def test_the_truth_behind_a_demo_is_the_full_model_and_not_a_short_cut(
    name: str, theta_in: float, theta_out: float
) -> None:
    wavelengths = np.array([260.0, 400, 600, 825, 990])
    value = true_brdf(SAMPLES[name], np.array([theta_in]), np.array([theta_out]), wavelengths)
    np.testing.assert_allclose(value[0], brute_force(SAMPLES[name], theta_in, theta_out, wavelengths), rtol=5e-7)


@pytest.mark.parametrize(("alpha", "factor"), [(0.005, 0.55), (0.01, 0.83), (0.02, 0.95), (0.05, 0.99)])
def test_the_aperture_blunts_narrow_lobes_as_found_for_one_degree(alpha: float, factor: float) -> None:
    theta, wavelengths = np.array([20.0]), np.array([600.0])
    through = true_brdf(replace(MIRROR, alpha=alpha), theta, theta, wavelengths)
    point = cook_torrance(in_plane(theta, theta), wavelengths, alpha, load_conductor())
    assert through[0, 0] / point[0, 0] == pytest.approx(factor, abs=0.005)


def test_the_aperture_widens_a_lobe_of_0_7_degrees_to_1_1() -> None:
    theta_out = np.linspace(18, 22, 401)
    value = true_brdf(replace(MIRROR, alpha=0.005), np.full(401, 20.0), theta_out, np.array([600.0]))[:, 0]
    above_half = theta_out[value > value.max() / 2]
    assert above_half[-1] - above_half[0] == pytest.approx(1.12, abs=0.03)


@pytest.mark.parametrize("theta", [10.0, 60.0, 80.0, 85.0])
def test_the_mirror_never_sends_more_light_into_the_detector_than_it_receives(theta: float) -> None:
    value = true_brdf(MIRROR, np.array([theta]), np.array([theta]), np.array([600.0]))[0, 0]
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(DETECTOR_APERTURE / 2)))
    assert value * np.cos(np.radians(theta)) * solid_angle < 0.95


def test_metal_beyond_its_table_is_held_constant_on_the_bench_and_refused_by_the_analysis() -> None:
    wavelengths = np.array([999.8, 1010, 1049])
    value = true_brdf(MIRROR, np.array([30.0]), np.array([30.0]), wavelengths)
    np.testing.assert_allclose(value[0], value[0, 0], rtol=1e-4)
    with pytest.raises(OutOfRange):
        load_conductor().index(wavelengths)


def test_the_panel_on_the_bench_is_the_nominal_reference() -> None:
    theta_in, theta_out, wavelengths = np.array([0.0, 30]), np.array([45.0, -60]), np.array([400.0, 600])
    np.testing.assert_array_equal(
        true_brdf(SPECTRALON, theta_in, theta_out, wavelengths),
        NOMINAL_SRS99.brdf(theta_in, theta_out, wavelengths),
    )


def test_the_panel_has_a_certificate_of_its_own_with_the_values_of_a_clean_one() -> None:
    assert SPECTRALON.certificate is PANEL_CERTIFICATE
    assert PANEL_CERTIFICATE.serial_number == "SIM-SRS-99-01"
    assert (str(PANEL_CERTIFICATE.calibrated), str(PANEL_CERTIFICATE.valid_until)) == ("2024-01-15", "2099-12-31")


@pytest.mark.parametrize(
    ("name", "spot", "alpha"), [("sample-4", 0, 0.18), ("sample-4", 3, 0.18), ("mirror", 0, 0.0045)]
)
def test_a_point_detector_sees_the_model_itself(name: str, spot: int, alpha: float) -> None:
    what = material(name)
    theta_in, theta_out, wavelengths = np.array([20.0, 60]), np.array([21.0, 60]), np.array([400.0, 600, 990])
    point = cook_torrance(in_plane(theta_in, theta_out), wavelengths, alpha, load_conductor(), what.h, what.w)
    np.testing.assert_allclose(true_brdf(what, theta_in, theta_out, wavelengths, 0.0, spot), point, rtol=1e-6)


def test_many_points_at_once_are_what_each_is_alone() -> None:
    theta_in, wavelengths = np.linspace(0, 80, 150), np.array([300.0, 600, 1040])
    theta_out = theta_in[::-1] - 20
    together = true_brdf(SAMPLES["sample-3"], theta_in, theta_out, wavelengths)
    for point in (0, 63, 64, 149):
        some = slice(point, point + 1)
        alone = true_brdf(SAMPLES["sample-3"], theta_in[some], theta_out[some], wavelengths)
        np.testing.assert_allclose(together[some], alone, rtol=1e-12)


def test_sample_7_is_rough_in_another_way_at_each_spot_and_no_other_sample_is() -> None:
    alphas = np.array([SAMPLES["sample-7"].alpha_at(spot) for spot in range(12)])
    assert np.all((alphas >= 0.20) & (alphas <= 0.35))
    assert alphas[:2] == pytest.approx([0.24, 0.32], abs=0.005)
    assert np.abs(alphas[1:4] - alphas[0]).min() > 0.05
    others = [sample for name, sample in SAMPLES.items() if name != "sample-7"]
    assert all(sample.alpha_at(spot) == sample.alpha for sample in others for spot in range(12))


def test_the_embossed_sheet_is_diffuse_but_for_a_lobe_on_either_side_of_the_mirror_direction() -> None:
    theta_in, red = np.array([30.0, 30.0, 30.0, 30.0, 30.0]), np.array([600.0])
    lobe = 30.0 + 2 * EMBOSSED.tilt
    theta_out = np.array([30.0, lobe, 60.0 - lobe, lobe + EMBOSSED.width / 2, -50.0])
    seen = true_brdf(EMBOSSED, theta_in, theta_out, red, aperture=0.0)[:, 0] - EMBOSSED.reflectance / np.pi
    assert seen == pytest.approx([0, EMBOSSED.height, EMBOSSED.height, EMBOSSED.height / 2, 0], abs=1e-9)
    there, back = (true_brdf(EMBOSSED, np.array([a]), np.array([b]), red) for a, b in ((20.0, 44.0), (44.0, 20.0)))
    assert there == pytest.approx(back)


def test_a_lamp_has_no_brdf_and_an_empty_stage_sends_nothing_back() -> None:
    angles, wavelengths = (np.array([10.0]), np.array([20.0])), np.array([600.0])
    with pytest.raises(UnknownMaterial, match="'mercury-argon' shines by itself"):
        true_brdf(MERCURY_ARGON, *angles, wavelengths)
    np.testing.assert_array_equal(true_brdf(NOTHING, *angles, wavelengths), 0)


@pytest.mark.parametrize("name", ["sample-2", "spectralon"])
def test_nothing_shines_below_the_horizon(name: str) -> None:
    value = true_brdf(material(name), np.array([10.0, 10, 95]), np.array([90.0, -120, 0]), np.array([600.0]))
    np.testing.assert_array_equal(value, 0)


def test_a_misspelt_material_is_answered_with_the_list_of_what_there_is() -> None:
    with pytest.raises(UnknownMaterial, match=r"'sample_1'.* sample-1, .*sample-6, .*spectralon, .*mirror"):
        material("sample_1")
    assert material("mirror") is MIRROR


def test_presets_never_reach_the_clamp_of_the_shift() -> None:
    # the reddest and the bluest slope must leave 1 + m (lambda - 600 nm) positive over the detector's range
    assert all(1 - abs(sample.h) * (1050 - 600) * 1e-3 > 0 for sample in SAMPLES.values())
