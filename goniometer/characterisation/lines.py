"""The wavelength scale against the known lines of a mercury-argon lamp."""

from dataclasses import dataclass

import numpy as np
import scipy

from drivers.arrays import FloatArray
from goniometer.errors import CharacterisationError

MERCURY_ARGON = (
    ("Hg", 253.6521),
    ("Hg", 296.7283),
    ("Hg", 334.1484),
    ("Hg", 435.8335),
    ("Hg", 546.0750),
    ("Ar", 696.5431),
    ("Ar", 706.7218),
    ("Ar", 727.2936),
    ("Ar", 738.3980),
    ("Ar", 763.5106),
    ("Ar", 794.8176),
    ("Ar", 826.4522),
    ("Ar", 852.1442),
    ("Ar", 912.2967),
    ("Ar", 922.4499),
    ("Ar", 965.7786),
)
"""Element and wavelength in air, nm, of lines that no other line of the lamp is near to at a resolution of 2 nm.

Mercury: Sansonetti, Salit and Reader, Appl. Opt. 35, 74 (1996), Table 2; argon: NIST Atomic Spectra Database. Left out
are the close groups at 313, 365, 405, 578, 751, 772, 801, 811 and 842 nm.
"""

U_KNOWN = 0.001
"""Standard uncertainty of the wavelength of a line in the lamp at hand, by its isotopes and its pressure, nm."""

SEARCH = 2.5
"""How far from where it belongs a line is looked for, nm."""

HALF_WINDOW = 3
"""Pixels on each side of its brightest one to which a line is fitted."""

CLEAR = 20.0
"""A line is used when it stands out of its surroundings by this many standard uncertainties."""

FEWEST = 4
"""Lines without which nothing is said of the scale."""


@dataclass(frozen=True)
class Line:
    """One line as it was found."""

    element: str
    known: float
    """Wavelength in air, nm."""
    found: float
    """On the scale of the spectrometer's own coefficients, nm."""
    u: float
    """Standard uncertainty of `found` by noise and by how well a Gaussian fits, nm."""
    width: float
    """Full width at half maximum, nm."""


@dataclass(frozen=True)
class WavelengthScale:
    """By how much the spectrometer's own wavelengths are wrong."""

    lines: tuple[Line, ...]
    """In the order of wavelength."""
    offset: float
    """Weighted mean of known - found: what is to be added to the wavelengths, nm."""
    u_offset: float
    """Standard uncertainty of `offset`, nm; widened where the lines scatter more than they should."""
    scatter: float
    """Standard deviation of known - found around `offset`, nm."""
    slope: float
    """Change of known - found over the wavelength, a pure number (nm per nm)."""
    u_slope: float
    """Standard uncertainty of `slope`, widened where the lines scatter around it more than they should."""
    chi_square: float
    """Sum of squared normalised departures from `offset`."""
    degrees_of_freedom: int

    @property
    def u_wavelength(self) -> float:
        """Standard uncertainty of a wavelength of the scale once `offset` is added, nm."""
        return float(np.hypot(self.u_offset, self.scatter))


def find_lines(wavelengths: FloatArray, rate: FloatArray, u: FloatArray) -> tuple[Line, ...]:
    """The lines of `MERCURY_ARGON` that stand clear in a spectrum `rate` with standard uncertainties `u`, [pixels].

    Each is fitted with a Gaussian on an even background; the standard uncertainty is widened by the square root
    of chi-square over the degrees of freedom where this exceeds 1.
    """
    found = (_find(element, known, wavelengths, rate, u) for element, known in MERCURY_ARGON)
    return tuple(line for line in found if line is not None)


def evaluate_lines(lines: tuple[Line, ...]) -> WavelengthScale:
    """Offset and trend of the scale; raises `CharacterisationError` with fewer than `FEWEST` lines."""
    if len(lines) < FEWEST:
        seen = ", ".join(f"{line.element} {line.known:.1f} nm" for line in lines) or "none"
        raise CharacterisationError(
            f"{len(lines)} lines of the mercury-argon lamp stand clear ({seen}) and {FEWEST} are needed; let the lamp "
            f"warm up, bring it closer to the detector, and check that the spectrometer reads the right wavelengths "
            f"within {SEARCH:g} nm"
        )
    known, found, u = (np.array([getattr(line, name) for line in lines]) for name in ("known", "found", "u"))
    departure, weight = known - found, 1 / (u**2 + U_KNOWN**2)
    offset = float(np.sum(weight * departure) / weight.sum())
    chi_square = float(np.sum(weight * (departure - offset) ** 2))
    freedom = len(lines) - 1
    widened = max(1.0, np.sqrt(chi_square / freedom))
    middle = np.sum(weight * known) / weight.sum()
    lever = float(np.sum(weight * (known - middle) ** 2))
    slope = float(np.sum(weight * (known - middle) * departure) / lever)
    about_slope = float(np.sum(weight * (departure - offset - slope * (known - middle)) ** 2))
    return WavelengthScale(
        lines,
        offset,
        float(np.hypot(widened / np.sqrt(weight.sum()), U_KNOWN)),  # what a lamp does, it does to all its lines
        float(np.std(departure, ddof=1)),
        slope,
        float(np.sqrt(max(1.0, about_slope / (freedom - 1)) / lever)),
        chi_square,
        freedom,
    )


def _find(element: str, known: float, wavelengths: FloatArray, rate: FloatArray, u: FloatArray) -> Line | None:
    near = np.flatnonzero(np.abs(wavelengths - known) <= SEARCH)
    if not near.size:
        return None
    brightest = int(near[np.argmax(rate[near])])
    low, high = brightest - HALF_WINDOW, brightest + HALF_WINDOW + 1
    if low < 0 or high > len(rate):
        return None
    x, y, u_y = wavelengths[low:high] - known, rate[low:high], u[low:high]
    background = float(min(y[0], y[-1]))
    if y[HALF_WINDOW] - background < CLEAR * u_y[HALF_WINDOW] or not np.isfinite(y).all():
        return None
    start = (y[HALF_WINDOW] - background, x[HALF_WINDOW], 0.7, background)
    try:
        values, covariance = scipy.optimize.curve_fit(_gaussian, x, y, p0=start, sigma=u_y, absolute_sigma=True)
    except RuntimeError:  # no shape of a line
        return None
    chi_square = float(np.sum(((y - _gaussian(x, *values)) / u_y) ** 2)) / (len(x) - len(values))
    centre, sigma = float(values[1]), abs(float(values[2]))
    if abs(centre) > SEARCH:
        return None
    uncertainty = float(np.sqrt(covariance[1, 1] * max(chi_square, 1.0)))
    return Line(element, known, known + centre, uncertainty, float(np.sqrt(8 * np.log(2)) * sigma))


def _gaussian(x: FloatArray, height: float, centre: float, sigma: float, background: float) -> FloatArray:
    return np.asarray(height * np.exp(-0.5 * ((x - centre) / sigma) ** 2) + background)
