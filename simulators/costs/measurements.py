"""Materials of the bench as measurements whose truth is known, for charts of what fits cost."""

import numpy as np

from analysis.costs.fits import Known
from analysis.reflectance.directions import in_plane
from analysis.reflectance.models import cosine_slope, theta_m
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import InputError
from simulators.computed import Computed, computed_dataset
from simulators.materials.materials import DETECTOR_APERTURE, Material, Mountable, true_brdf

NOISE, DARK = 5e-3, 1e-5
"""Standard deviation of a value at one wavelength: relative, and in the dark, 1/sr."""

_NEAR = (-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0)
_WAVELENGTHS = np.linspace(380.0, 995.0, 401)


def drawn(name: str, what: Mountable, draws: int) -> tuple[list[Dataset], Known | None]:
    """`draws` measurements of a material that differ by their noise, and what is true where a model is behind it.

    306 directions or more: every 5 degrees at nine incident angles, closer around the mirror direction. Raises
    `InputError` for what has no BRDF.
    """
    theta_in, theta_out = _directions()
    brdf = true_brdf(what, theta_in, theta_out, _WAVELENGTHS)
    if not brdf.any():
        raise InputError(f"The material {name} reflects nothing; name one that does.")
    u = NOISE * brdf + DARK
    noises = [np.random.default_rng(seed).normal(size=brdf.shape) for seed in range(draws)]
    lineage: dict[str, object] = {"simulated": f"the bench's {name} with {100 * NOISE:g} % noise"}
    datasets = [
        computed_dataset(
            Computed(
                name,
                theta_in,
                theta_out,
                _WAVELENGTHS,
                brdf + u * noise,
                np.zeros_like(brdf),
                u,
                DETECTOR_APERTURE,
                lineage,
            )
        )
        for noise in noises
    ]
    if not isinstance(what, Material):
        return datasets, None
    slopes = cosine_slope(theta_m(in_plane(theta_in, theta_out)), what.h, what.w)
    return datasets, Known(np.array([what.alpha, what.h, what.w]), brdf, slopes)


def _directions() -> tuple[FloatArray, FloatArray]:
    pairs = {
        (theta_in, theta_out)
        for theta_in in np.arange(0.0, 81.0, 10.0)
        for theta_out in (*np.arange(-85.0, 86.0, 5.0), *(theta_in + offset for offset in _NEAR))
        if abs(theta_in + theta_out) >= 5 and abs(theta_out) <= 85
    }
    theta_in, theta_out = np.array(sorted(pairs)).T
    return theta_in, theta_out
