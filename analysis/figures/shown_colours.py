"""Which colour of a display stands for a spectrum in a map."""

from dataclasses import dataclass

import numpy as np

from analysis.colour import brdf_to_rgb, display_encoded
from analysis.figures.svg import hex_colour
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of the primaries of BT.709."""

_OF_A_HUE = 0.45
"""Luminance at which hues are shown."""


@dataclass(frozen=True)
class Exposure:
    """How radiometric values become display colours."""

    factor: float
    """Linear RGB is multiplied by it; (1, 1, 1) is then f cos(theta_in) = 1 / factor."""
    clipped: int
    """How many of the measured points are brighter than the display."""
    coloured: int
    """How many of the measured points have a colour at all: one whose spectrum has a gap has none."""


def exposure_of(dataset: Dataset) -> Exposure:
    """Exposure that maps the 95th percentile of the brightest channel to white; 1 where that tells of no light.

    Raises `OutOfRange` as `brdf_to_rgb`.
    """
    brightest = brdf_to_rgb(dataset.brdf, dataset.theta_in, dataset.wavelengths).max(axis=-1)
    brightest = brightest[np.isfinite(brightest)]
    level = float(np.percentile(brightest, 95)) if brightest.size else 0.0
    factor = 1 / level if level > 0 else 1.0
    return Exposure(factor, int(np.sum(brightest * factor > 1)), brightest.size)


def shown_colours(
    values: FloatArray, theta_in: FloatArray, wavelengths: FloatArray, exposure: Exposure | None, has_hue: BoolArray
) -> list[str | None]:
    """ "#rrggbb" of spectra [points, wavelengths], 1/sr, under D65; None where there is no value.

    Without an exposure all have one luminance, so that only the hue is left, and those that have none ([points]) are
    None. Raises `OutOfRange` as `brdf_to_rgb`.
    """
    rgb = brdf_to_rgb(values, theta_in, wavelengths)
    if exposure is None:
        luminance = rgb @ _LUMINANCE
        rgb = _OF_A_HUE * rgb / np.where((luminance > 0) & has_hue, luminance, np.nan)[:, None]
    else:
        rgb = rgb * exposure.factor
    return [hex_colour(c) if np.isfinite(c).all() else None for c in display_encoded(rgb)]
