"""Gratings (paper, section 5.2): directions and efficiencies of diffraction orders, and spectra binned over angle.

The spectrum that many gratings send into a bin follows from how their spacings d are spread and from nothing else: a
density proportional to d^q gives spectra proportional to wavelength^(q + 1) wherever no end of the spread is in view.
"""

from dataclasses import dataclass

import numpy as np

from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import Spread


def order_angles(theta_in: float, orders: FloatArray, period_um: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """Directions theta_out of diffraction orders in degrees (paper, Eq. 1); NaN where an order does not propagate.

    `orders` (m, signed), `period_um` and `wavelengths` (nm) broadcast; `theta_in` is in degrees. Raises `InputError`
    for a period that is not positive.

    >>> order_angles(10.0, np.array([0.0, 1.0, 2.0]), np.array(3.0), np.array(600.0)).round(2)
    array([ 10.  ,  -1.51, -13.08])
    """
    if not np.all(np.asarray(period_um) > 0):
        raise InputError("The spacing of a grating is a positive length; give it in micrometres.")
    sine = np.sin(np.radians(theta_in)) - orders * (1e-3 * wavelengths) / period_um
    sine = np.where(np.abs(sine) <= 1 + 1e-12, np.clip(sine, -1, 1), np.nan)
    return np.asarray(np.degrees(np.arcsin(sine)))


def binned_spectra(
    theta_in: float, order: int, periods_um: FloatArray, wavelengths: FloatArray, edges: FloatArray
) -> FloatArray:
    """[bins, wavelengths] share of gratings with `periods_um` [gratings] that send `order` between two of `edges`.

    `edges` [bins + 1] are angles theta_out in degrees, ascending: a detector that moves in steps of its own aperture
    over many gratings of different spacing (paper, Fig. 7b). `theta_in` is in degrees, `wavelengths` in nm. Raises as
    `order_angles`.
    """
    angles = order_angles(theta_in, np.array(float(order)), periods_um[:, None], wavelengths)
    counts = [np.histogram(angles[:, i], bins=edges)[0] for i in range(wavelengths.size)]
    return np.stack(counts, axis=1) / periods_um.size


def spread_periods(spread: Spread, smallest_um: float, largest_um: float, count: int) -> FloatArray:
    """[count] spacings of gratings, um, ascending, the mid points of as many equal shares.

    Raises `InputError` unless 0 < `smallest_um` < `largest_um`.
    """
    if not 0 < smallest_um < largest_um < np.inf:
        raise InputError(
            f"Gratings cannot have spacings of {smallest_um:g} to {largest_um:g} um; give the smaller one first, both "
            f"positive."
        )
    share = (np.arange(count) + 0.5) / count
    if spread is Spread.SPACING:
        return np.asarray(smallest_um + share * (largest_um - smallest_um))
    if spread is Spread.LOGARITHM:
        return np.asarray(smallest_um * (largest_um / smallest_um) ** share)
    return np.asarray(1 / (1 / smallest_um + share * (1 / largest_um - 1 / smallest_um)))


@dataclass(frozen=True)
class Lines:
    """Straight lines through spectra, one each."""

    slope: FloatArray
    """[spectra] relative change with the wavelength, 1/um: the slope over the value in the middle of the wavelengths;
    NaN for a spectrum without light."""
    r2: FloatArray
    """[spectra] share of the variance that the line explains; NaN without light, and of no meaning for a constant."""


def straight_lines(spectra: FloatArray, wavelengths: FloatArray) -> Lines:
    """Least-squares lines through `spectra` [spectra, wavelengths]; `wavelengths` are equally spaced, nm."""
    x = 1e-3 * (wavelengths - wavelengths.mean())
    mean = spectra.mean(axis=1)
    slope = spectra @ x / (x @ x)
    left = ((spectra - mean[:, None] - slope[:, None] * x) ** 2).sum(axis=1)
    whole = ((spectra - mean[:, None]) ** 2).sum(axis=1)
    light = mean > 0
    r2 = 1 - np.divide(left, whole, out=np.zeros(mean.size), where=whole > 0)
    return Lines(np.divide(slope, mean, out=np.full(mean.size, np.nan), where=light), np.where(light, r2, np.nan))


def ring(theta_in: FloatArray, theta_out: FloatArray, aperture: float) -> tuple[FloatArray, FloatArray]:
    """Inner and outer radius [points], in direction cosines about the mirror direction, of what a detector sees.

    The two circles touch an aperture (full angle, degrees) at its edges in the plane of incidence; the inner one has no
    radius where the aperture holds the mirror direction. `theta_in` and `theta_out` [points] are in degrees.
    """
    edges = [np.sin(np.radians(theta_out + sign * aperture / 2)) - np.sin(np.radians(theta_in)) for sign in (-1, 1)]
    outer = np.maximum(np.abs(edges[0]), np.abs(edges[1]))
    inner = np.where(edges[0] * edges[1] < 0, 0.0, np.minimum(np.abs(edges[0]), np.abs(edges[1])))
    return inner, outer


def grating_brdf(inner: FloatArray, outer: FloatArray, periods_um: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[points, wavelengths] BRDF, 1/sr, of gratings in all azimuths that send all light into their two first orders.

    In the plane of direction cosines the orders of all gratings of one spacing lie on a circle around the mirror
    direction, of the radius wavelength / spacing. A value is the light between two such circles (`ring`) over the area
    between them. That is the mean BRDF there, because an area of direction cosines is a solid angle times
    cos(theta_out). `periods_um` [gratings] ascend and are equally frequent; the zeroth order is left out.
    """
    waves = 1e-3 * wavelengths
    with np.errstate(divide="ignore"):
        longest = waves / inner[:, None]
    within = np.searchsorted(periods_um, longest) - np.searchsorted(periods_um, waves / outer[:, None])
    return np.asarray(within / periods_um.size / (np.pi * (outer**2 - inner**2))[:, None])
