"""The bench's harder samples are what they say they are, and behave as the surfaces that the paper describes."""

import colour
import numpy as np
import pytest

from analysis.reflectance.directions import Directions, round_aperture
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from simulators.errors import UnknownMaterial
from simulators.materials.materials import material, true_brdf
from simulators.materials.surfaces import SANDBLASTED, SANDED, Surface, multiple_lobe, over_aperture, single_lobe

NM = np.array([420.0, 500.0, 600.0, 700.0, 900.0])


def by_hand(surface: Surface, theta_in: float, theta_out: float) -> np.ndarray:
    """[wavelengths] the metal's formula for one direction, written out anew; complex Fresnel amplitudes."""
    i, o = np.radians(theta_in), np.radians(theta_out)
    theta_m, theta_d = abs(o - i) / 2, abs(o + i) / 2
    tan2_m, (tan_i, tan_o) = np.tan(theta_m) ** 2, (abs(np.tan(angle)) for angle in (i, o))
    a, b = 0.8 * surface.alpha, 1.25 * surface.alpha
    ggx = a**2 / (np.pi * np.cos(theta_m) ** 4 * (a**2 + tan2_m) ** 2)
    ggx *= np.prod([2 / (1 + np.sqrt(1 + (a * t) ** 2)) for t in (tan_i, tan_o)])
    beckmann = np.exp(-tan2_m / b**2) / (np.pi * b**2 * np.cos(theta_m) ** 4)
    for t in (tan_i, tan_o):
        c = 1 / (b * max(t, 1e-12))
        beckmann *= 1 if c >= 1.6 else (3.535 * c + 2.181 * c**2) / (1 + 2.276 * c + 2.577 * c**2)
    n = np.array(load_conductor().index(NM)).T @ np.array([1, 1j])
    inside = np.sqrt(n**2 - np.sin(theta_d) ** 2)
    s = (np.cos(theta_d) - inside) / (np.cos(theta_d) + inside)
    p = (n**2 * np.cos(theta_d) - inside) / (n**2 * np.cos(theta_d) + inside)
    fresnel = (abs(s) ** 2 + abs(p) ** 2) / 2
    x = (NM - 600) / 1000
    single = (
        (1 - surface.multiple) * (ggx + beckmann) / 2 / (4 * np.cos(i) * np.cos(o)) * fresnel * (1 + surface.once * x)
    )
    more = surface.multiple / np.pi * np.exp(-2 * np.sin(theta_d) ** 2) * fresnel**2 * (1 + surface.more * x)
    return np.asarray(single + more)


@pytest.mark.parametrize("name", ["two-component-1", "two-component-6"])
@pytest.mark.parametrize(("theta_in", "theta_out"), [(0, 0), (10, 11), (40, -70), (75, 80)])
def test_a_sandblasted_sample_has_the_brdf_that_its_formula_says(name: str, theta_in: float, theta_out: float) -> None:
    value = true_brdf(SANDBLASTED[name], np.array([theta_in]), np.array([theta_out]), NM, aperture=0.0)
    np.testing.assert_allclose(value[0], by_hand(SANDBLASTED[name], theta_in, theta_out), rtol=1e-6)


def test_the_aperture_averages_the_brdf_of_its_directions() -> None:
    mirror = SANDBLASTED["two-component-6"]
    along = np.linspace(-0.5, 0.5, 401)
    # a lobe that depends on theta_m alone is seen sideways as theta_m = hypot of both halves
    sideways = np.linspace(-0.5, 0.5, 401)
    x, y = np.meshgrid(along, sideways)
    inside = np.hypot(x, y) <= 0.5
    theta = np.full(inside.sum(), 1e-9), np.hypot(x, y)[inside]
    mean = true_brdf(mirror, *theta, NM[2:3], aperture=0.0).mean()
    seen = true_brdf(mirror, np.array([0.0]), np.array([0.0]), NM[2:3])
    assert seen[0, 0] == pytest.approx(mean, rel=2e-3)


@pytest.mark.parametrize("name", [*SANDBLASTED, *SANDED, "colorchecker-4", "colorchecker-19"])
def test_no_surface_breaks_reciprocity_or_shines_below_zero(name: str) -> None:
    wavelengths = np.linspace(340, 1050, 30)
    pairs = np.array([(20.0, 60.0), (20.0, -60.0), (70.0, 5.0)]).T
    there = true_brdf(material(name), pairs[0], pairs[1], wavelengths, aperture=0.0)
    back = true_brdf(material(name), np.abs(pairs[1]), pairs[0] * np.sign(pairs[1]), wavelengths, aperture=0.0)
    np.testing.assert_allclose(there, back, rtol=1e-9)
    assert there.min() > 0


@pytest.mark.parametrize("surface", [*SANDBLASTED.values(), *SANDED.values()], ids=lambda s: s.name)
@pytest.mark.parametrize("theta_in", [0.0, 45.0, 75.0])
def test_no_surface_sends_back_more_light_than_it_gets(surface: Surface, theta_in: float) -> None:
    """Integral over the hemisphere of half vectors, which resolves the narrowest lobe."""
    t = np.geomspace(1e-5, np.pi / 2, 1500)[:, None]
    phi = np.linspace(0, np.pi, 400)[None]
    i = np.array([np.sin(np.radians(theta_in)), 0.0, np.cos(np.radians(theta_in))])
    h = np.stack([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), np.cos(t) + 0 * phi], axis=-1)
    cos_d = h @ i
    cos_o = 2 * cos_d * h[..., 2] - i[2]
    directions = Directions(np.full(cos_d.shape, i[2]), cos_o, h[..., 2], np.abs(cos_d))
    f = (1 - surface.multiple) * single_lobe(directions, surface.alpha) + multiple_lobe(directions, surface.multiple)
    jacobian = np.where((cos_d > 0) & (cos_o > 0), 4 * cos_d * cos_o * np.sin(t), 0.0)
    albedo = 2 * np.trapezoid(np.trapezoid(f * jacobian, phi[0], axis=1), t[:, 0])
    assert 0.5 < albedo < 1.0


def slope(name: str, theta_in: float, theta_out: list[float]) -> np.ndarray:
    """Relative tilt of the spectra between 500 and 700 nm, 1/um."""
    angles = np.array(theta_out)
    f = true_brdf(material(name), np.full(angles.size, theta_in), angles, NM)
    return np.asarray((f[:, 3] - f[:, 1]) / f[:, 2] / 0.2)


def test_sanded_spectralon_is_blue_red_or_balanced_at_normal_incidence_as_in_figure_12() -> None:
    angles = [-40.0, -20.0, 10.0, 30.0]
    assert slope("srs-02-grit-60", 0, angles).max() < -0.3
    assert slope("srs-02-grit-2500", 0, angles).min() > 0.3
    assert np.abs(slope("srs-02-grit-1000", 0, angles)).max() < 0.1
    back, forward = slope("srs-02-grit-1000", 40, [-30.0, 60.0])
    assert back < -0.3
    assert forward > 0.9


def test_a_sandblasted_sample_is_red_forward_and_blue_backward() -> None:
    back, forward = slope("two-component-1", 70, [-50.0, 70.0])
    assert back < -0.3
    assert forward > 1.2


@pytest.mark.parametrize(("number", "name"), [(14, "green"), (24, "black 2 (1.5 D)")])
def test_a_patch_has_its_measured_radiance_factor_at_45_0_and_shines_beyond_it(number: int, name: str) -> None:
    patch = material(f"colorchecker-{number}")
    measured = colour.SDS_COLOURCHECKERS["BabelColor Average"][name]
    wavelengths = np.array([450.0, 550.0, 600.0])
    directions = np.array([45.0, 70.0]), np.array([0.0, 70.0])
    value = np.pi * true_brdf(patch, *directions, wavelengths, aperture=0.0)
    np.testing.assert_allclose(value[0], measured[wavelengths], rtol=1e-9)
    assert (value[1] > measured[wavelengths] + 1).all()


def test_a_patch_that_no_chart_has_is_refused() -> None:
    with pytest.raises(UnknownMaterial, match="colorchecker-1 to colorchecker-24"):
        material("colorchecker-25")


def test_what_is_summed_over_an_aperture_before_the_wavelengths_is_the_same_as_after() -> None:
    random = np.random.default_rng(1)
    rule = round_aperture(1.0)
    cos_d = 0.7 + 0.005 * random.uniform(-1, 1, (3, rule.weights.size))
    directions = Directions(cos_d, cos_d, cos_d, cos_d)
    weight, tilt = random.uniform(0, 1, (2, *cos_d.shape))
    index = load_conductor().index(NM)
    quick = over_aperture(directions, weight, tilt, lambda c: fresnel_conductor(c, *index), NM)
    each = fresnel_conductor(cos_d[..., None], *index) * (1 + tilt[..., None] * (NM - 600) * 1e-3)
    np.testing.assert_allclose(quick, (weight[..., None] * each).sum(axis=1), rtol=1e-6)
