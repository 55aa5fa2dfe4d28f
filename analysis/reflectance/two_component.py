"""A shift of two components: one function for light reflected once, one for light reflected more often.

    shift = (1 - s) (1 + m_1 x) + s (1 + m_2 x),    x = lambda - lambda_n,

with s, 0 ... 1, the share of multiple reflections in a direction (section 5.7 of the paper suggests it, without a
formula). The weights sum to one, so the sum is a shift of slope m = (1 - s) m_1 + s m_2, and all that holds for Eq. 4
holds for it. Where s is known, from rays traced over a topography, `mixed_slope` is all there is to it. Where it is
not, `two_component_slope` makes s of two lobes: single reflections fill one about the mirror direction, multiple ones
one about the way back into the lamp (Fig. 11), each an exponential of a cosine. With theta_m the angle between half
vector and surface normal and theta_d that between incident direction and half vector, the share is

    s = 1 / (1 + exp(2 b (v - v_0))),    v = cos(w theta_m) - kappa cos(w theta_d),    b^2 = q.

- threshold v_0 says how strong the lobes are, 2 b v_0 being the logarithm of multiple over single ones;
- sharpness q says how fast one takes over from the other; smooth samples want fast transitions;
- kappa says how much of multiple reflections goes back. At kappa = 1 the lobes cancel at normal incidence and part
  beyond it, as on Spectralon sanded with grit 1000 (Fig. 12); above 1 a valley follows the lamp, as with grit 60.

The slopes of the components are m_1,2 = t_y + h (tanh(b v_0) +- 1) / b, so that the slope is t_y where v = 0:

    m = t_y + h [tanh(b (v - v_0)) + tanh(b v_0)] / b.

For q = 0 and kappa = 0 this is the cosine of Eq. 5, whatever v_0. Unlike m_1 and m_2 the parameters h, w, t_y, kappa
and q stay finite and distinct there, while v_0 means nothing and has the derivative zero. The model is linear in h
and t_y. It is symmetric in the two directions, as a BRDF must be.
"""

import numpy as np

from analysis.errors import OutOfRange
from analysis.reflectance.directions import Directions
from drivers.arrays import FloatArray

TWO_COMPONENTS = (
    "t_y + h (tanh(b (v - v0)) + tanh(b v0)) / b, v = cos(w theta_m) - kappa cos(w theta_d), b^2 the sharpness, "
    "v0 the threshold"
)
"""The slope in one line, for people."""

_SMALL = 1e-3
"""q v^2 below which series, exact to 1e-13, stand for quotients that rounding would spoil."""


def mixed_slope(share: FloatArray, single: FloatArray | float, multiple: FloatArray | float) -> FloatArray:
    """Slope of the shift, 1/um, [...], where a share [...] of the light, 0 ... 1, was reflected more than once.

    `single` and `multiple` are the slopes of the two components, 1/um, one for all directions or [...]. Raises
    `OutOfRange` for a share that is none. Linear in the slopes: the derivative by `single` is 1 - share, that by
    `multiple` is share.
    """
    if np.any((share < 0) | (share > 1)):
        raise OutOfRange(
            f"The share of multiple reflections reaches from {np.min(share):g} to {np.max(share):g}; "
            "it must lie between 0 and 1."
        )
    return np.asarray((1 - share) * single + share * multiple)


def two_component_slope(
    directions: Directions,
    h: float,
    w: float,
    t_y: float = 0.0,
    kappa: float = 0.0,
    sharpness: float = 0.0,
    threshold: float = 0.0,
) -> FloatArray:
    """Slope of the two-component shift, 1/um, [...]; h and t_y in 1/um, the others are numbers.

    `sharpness` is q >= 0, else `OutOfRange` is raised. Beyond w theta_d = 180 degrees the lobe about the lamp stays at
    its minimum: one lamp has one lobe.
    """
    v, _, _ = _balance(directions, w, kappa)
    q = _checked(sharpness)
    return np.asarray(t_y + h * (_saturated(v - threshold, q) + _saturated(np.asarray(threshold), q)))


def two_component_slope_derivative(
    directions: Directions,
    h: float,
    w: float,
    t_y: float = 0.0,
    kappa: float = 0.0,
    sharpness: float = 0.0,
    threshold: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """`two_component_slope` [...] and its derivatives by its six parameters in their order, [6, ...].

    Raises `OutOfRange` for a negative sharpness.
    """
    v, v_by_w, v_by_kappa = _balance(directions, w, kappa)
    q = _checked(sharpness)
    away, level = v - threshold, np.asarray(threshold)
    form = _saturated(away, q) + _saturated(level, q)
    by_v, by_q = _saturated_derivatives(away, q)
    by_level, level_by_q = _saturated_derivatives(level, q)
    by_w, by_kappa = h * by_v * v_by_w, h * by_v * v_by_kappa
    by_sharpness, by_threshold = h * (by_q + level_by_q), h * (by_level - by_v)
    jacobian = np.stack([form, by_w, np.ones_like(v), by_kappa, by_sharpness, by_threshold])
    return np.asarray(t_y + h * form), jacobian


def two_component_shapes(directions: Directions, shapes: FloatArray) -> FloatArray:
    """[shapes, points] the slope of many two-component shifts for h = 1 and t_y = 0, at `directions` [points].

    `shapes` [shapes, 4] are w, kappa, sharpness and threshold of each.
    """
    w, kappa, q, threshold = shapes.T[:, :, None]
    theta_m, theta_d = _angles(directions)
    v = np.cos(w * theta_m) - kappa * np.cos(np.minimum(w * theta_d, np.pi))
    return np.asarray(_saturated(v - threshold, q) + _saturated(threshold, q))


def _checked(sharpness: float) -> float:
    if sharpness.real < 0:
        raise OutOfRange(f"A sharpness of {sharpness:g} has no meaning; it must not be negative.")
    return sharpness


def _balance(directions: Directions, w: float, kappa: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """v of the single lobe against the multiple one, and its derivatives by w and kappa."""
    theta_m, theta_d = _angles(directions)
    phase = np.minimum(w * theta_d, np.pi)
    back = np.cos(phase)
    v = np.cos(w * theta_m) - kappa * back
    by_w = -theta_m * np.sin(w * theta_m) + kappa * theta_d * np.sin(phase)
    return np.asarray(v), np.asarray(by_w), np.asarray(-back)


def _angles(directions: Directions) -> tuple[FloatArray, FloatArray]:
    """theta_m and theta_d, radians."""
    return np.arccos(np.clip(directions.cos_m, -1, 1)), np.arccos(np.clip(directions.cos_d, -1, 1))


def _saturated(v: FloatArray, q: FloatArray | float) -> FloatArray:
    """tanh(sqrt(q) v) / sqrt(q), which is v for q = 0; by its series where that is more exact."""
    z = q * v**2
    small = np.abs(z) < _SMALL
    root = np.sqrt(np.where(small, 1.0, z))
    series = 1 + z * (-1 / 3 + z * (2 / 15 + z * (-17 / 315 + z * 62 / 2835)))
    return np.asarray(v * np.where(small, series, np.tanh(root) / root))


def _saturated_derivatives(v: FloatArray, q: float) -> tuple[FloatArray, FloatArray]:
    """Of `_saturated` by v and by q."""
    z = q * v**2
    small = z < _SMALL
    root = np.sqrt(z)
    # beyond 300 its square is more than a double can hold
    sech2 = 1 / np.cosh(np.minimum(root, 300)) ** 2
    series = -1 / 3 + z * (4 / 15 + z * (-51 / 315 + z * 248 / 2835))
    safe = np.where(small, 1.0, z)
    quotient = (sech2 - np.tanh(root) / np.sqrt(safe)) / (2 * safe)
    return np.asarray(sech2), np.asarray(v**3 * np.where(small, series, quotient))
