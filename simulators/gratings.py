"""Gratings (paper, section 5.2): directions and efficiencies of diffraction orders, and spectra binned over angle."""

import numpy as np
from scipy.special import jv

from drivers.arrays import FloatArray
from goniometer.errors import InputError


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


def sinusoidal_efficiencies(
    theta_in: float, orders: FloatArray, period_um: FloatArray, amplitude_um: FloatArray, wavelengths: FloatArray
) -> FloatArray:
    """Share of the light in each order of a perfect mirror with heights `amplitude_um` sin(2 pi x / period_um).

    (cos theta_out / cos theta_in) J_m(kz amplitude)^2, kz = (2 pi / wavelength) (cos theta_in + cos theta_out): a thin
    phase grating in the generalised Harvey-Shack theory. Zero for orders that do not propagate. Shapes as for
    `order_angles`.
    """
    theta_out = order_angles(theta_in, orders, period_um, wavelengths)
    cos_i, cos_o = np.cos(np.radians(theta_in)), np.cos(np.radians(theta_out))
    depth = 2 * np.pi / (1e-3 * wavelengths) * (cos_i + cos_o) * amplitude_um
    return np.asarray(np.nan_to_num(cos_o / cos_i * jv(orders, depth) ** 2, nan=0.0))


def binned_spectra(
    theta_in: float, order: int, periods_um: FloatArray, wavelengths: FloatArray, edges: FloatArray
) -> FloatArray:
    """[bins, wavelengths] share of gratings with `periods_um` [gratings] that send `order` between two of `edges`.

    `edges` [bins + 1] are angles theta_out in degrees, ascending: a detector that moves in steps of its own aperture
    over many gratings of different spacing (paper, Fig. 7b). `theta_in` is in degrees, `wavelengths` in nm.
    """
    angles = order_angles(theta_in, np.array(float(order)), periods_um[:, None], wavelengths)
    counts = [np.histogram(angles[:, i], bins=edges)[0] for i in range(wavelengths.size)]
    return np.stack(counts, axis=1) / periods_um.size
