"""How much of what the detector sees lies on the sample.

The detector sees a disc of diameter d across its axis, on the sample an ellipse that is longer by 1 / cos(theta_out)
in plane; the beam is wider than that. On a round sample of diameter D the share of the ellipse is 1 until its half
length reaches D / 2, and falls beyond.
"""

import numpy as np

from drivers.arrays import FloatArray

CLIPPED_BELOW = 0.999
"""Share below which a point counts as clipped."""

_STRIPS = 400


def share_on_sample(theta_out: FloatArray, field_of_view: float, diameter: float) -> FloatArray:
    """[points] share of the footprint that lies on a centred round sample, 0 to 1.

    `theta_out` [points] in degrees, `field_of_view` (at normal view) and `diameter` of the sample in mm. Integrates the
    height of the ellipse, or of the sample where that is less, over strips across the plane of incidence, with
    x = a sin(t), which makes the integrand smooth: the error is below 1e-5.

    >>> share_on_sample(np.array([0.0, 60.0]), 5.0, 10.0).round(4).tolist()
    [1.0, 1.0]
    >>> share_on_sample(np.zeros(1), 10.0, 5.0).round(4).tolist()
    [0.25]
    """
    half = 0.5 * field_of_view
    a = half / np.maximum(np.cos(np.radians(theta_out)), 1e-6)
    t = (np.arange(_STRIPS) + 0.5) / _STRIPS * (np.pi / 2)
    x = a[:, None] * np.sin(t)
    of_ellipse = half * np.cos(t)
    of_sample = np.sqrt(np.maximum((0.5 * diameter) ** 2 - x**2, 0.0))
    seen = np.minimum(of_ellipse, of_sample) * np.cos(t)
    return np.asarray(seen.sum(axis=1) / (of_ellipse * np.cos(t)).sum())
