"""What scalar theory says of a grating so shallow that it only shifts the phase."""

import numpy as np
from scipy.special import jv

from drivers.arrays import FloatArray
from simulators.waves.gratings import order_angles


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
