"""What a photograph tells of a surface: its mean colour, how red it is, and how deep its speckle (section 4.2)."""

from dataclasses import dataclass

import numpy as np

from analysis.colour import delta_e_2000, rgb_to_xyz
from drivers.arrays import FloatArray
from goniometer.photographs.photos import Photo, PhotoSeries

FORWARD_TILT, BACKWARD_TILT = 10.0, 32.0
"""Angle between half vector and normal, degrees, at which forward and backward scattering are shown: near the mirror
direction but off it, and where Fig. 9 of the paper has the shortest wavelengths."""

FALLEN_TO = 0.05
"""Autocorrelation up to which it counts."""


@dataclass(frozen=True)
class PhotoStatistics:
    """Of the inset of one photograph; all are relative to the panel. What is saturated counts as it is."""

    angle: float
    """Of the light, degrees."""
    rgb: FloatArray
    """[3] mean white-balanced signals of the camera."""
    luminance: float
    """Of the mean, one for the panel."""
    srgb: FloatArray
    """[3] the mean as linear sRGB of luminance one, neither clipped nor encoded; NaN where there is no light."""
    chromaticity: tuple[float, float]
    """CIE 1931 x and y of `srgb`."""
    delta_e: float
    """CIEDE2000 between `srgb` and white: how far the colour is from neutral, whatever its brightness."""
    red_over_blue: float
    """Ratio of the camera's white-balanced signals: above one is reddish, below one bluish."""
    u_red_over_blue: float
    """Its standard uncertainty from the finite number of speckles in the inset; the panel's is not in it."""
    contrast: float
    """Standard deviation over mean of the luminance, without what varies slowly over the inset; noise of the camera
    counts, too."""
    contrast_rgb: FloatArray
    """[3] the same of each channel."""
    speckles: float
    """How many independent values of luminance the inset holds, from its autocorrelation."""
    saturated: float
    """Part of the inset that is saturated."""
    overexposed: bool
    """Whether that is too much: such a photograph takes no part in charts and comparisons."""


def photo_statistics(series: PhotoSeries) -> list[PhotoStatistics]:
    """Of all photographs of a series, the angle of the light ascending."""
    return [_statistics(photo, series.colour_matrix) for photo in series.photos]


def shown_photo(series: PhotoSeries, tilt: float) -> int | None:
    """Which photograph, of those that are not overexposed, shows the half vector nearest to `tilt`; None of none.

    `tilt` in degrees is towards the side of the normal: `FORWARD_TILT` or `BACKWARD_TILT`.
    """
    side = 1 if series.camera_angle >= 0 else -1
    wanted = series.camera_angle - side * 2 * tilt
    usable = [i for i, photo in enumerate(series.photos) if not photo.overexposed]
    return min(usable, key=lambda i: abs(series.photos[i].angle - wanted), default=None)


def as_srgb(rgb: FloatArray, colour_matrix: FloatArray | None) -> FloatArray:
    """[..., 3] linear sRGB of the camera's signals; without a matrix the one is taken as the other."""
    return rgb if colour_matrix is None else np.asarray(rgb @ colour_matrix.T)


def luminance(srgb: FloatArray) -> FloatArray:
    """[...] relative luminance of linear sRGB [..., 3]."""
    return np.asarray(rgb_to_xyz(srgb)[..., 1])


def without_slow_variation(values: FloatArray) -> FloatArray:
    """[y, x] `values` less the quadratic surface that fits them best, so about zero."""
    y, x = (np.linspace(-1, 1, count) for count in values.shape)
    terms = np.stack([np.outer(y**i, x**j).ravel() for i in range(3) for j in range(3 - i)], axis=1)
    fitted = terms @ np.linalg.lstsq(terms, values.ravel(), rcond=None)[0]
    return np.asarray(values - fitted.reshape(values.shape))


def independent_values(values: FloatArray) -> float:
    """How many independent values a pattern [y, x] about zero holds, as far as its mean is concerned.

    The variance of the mean is that of the values over their number times the sum of their autocorrelation, which is
    summed up to the lag where it falls to `FALLEN_TO` on average over all directions; beyond, it is mostly chance.
    """
    ny, nx = values.shape
    power = np.abs(np.fft.rfft2(values, (2 * ny, 2 * nx))) ** 2
    correlation = np.fft.fftshift(np.fft.irfft2(power, (2 * ny, 2 * nx)))
    largest = correlation[ny, nx]
    if largest == 0:
        return float(values.size)
    lag = np.hypot(*np.ogrid[-ny:ny, -nx:nx])
    ring = np.round(lag).astype(int).ravel()
    mean = np.bincount(ring, correlation.ravel()) / np.bincount(ring)
    fallen = np.flatnonzero(mean[: min(ny, nx)] <= FALLEN_TO * largest)
    reach = int(fallen[0]) if fallen.size else min(ny, nx)
    share = float(correlation[lag < reach - 0.5].sum() / largest)
    return float(values.size / max(share, 1.0))


def _statistics(photo: Photo, colour_matrix: FloatArray | None) -> PhotoStatistics:
    inset = photo.inset.astype(float)
    mean = inset.mean(axis=(0, 1))
    srgb = as_srgb(inset, colour_matrix)
    bright = luminance(srgb)
    level = float(bright.mean())
    colour = as_srgb(mean, colour_matrix) / level if level > 0 else np.full(3, np.nan)
    xyz = rgb_to_xyz(colour)
    pattern = without_slow_variation(bright)
    channels = [without_slow_variation(inset[..., c]) for c in range(3)]
    ratio, u_ratio = _red_over_blue(inset[..., 0], inset[..., 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        contrasts = np.array([channel.std() for channel in channels]) / np.where(mean > 0, mean, np.nan)
    return PhotoStatistics(
        angle=photo.angle,
        rgb=mean,
        luminance=level,
        srgb=colour,
        chromaticity=(float(xyz[0] / xyz.sum()), float(xyz[1] / xyz.sum())),
        delta_e=float(delta_e_2000(xyz, rgb_to_xyz(np.ones(3)))),
        red_over_blue=ratio,
        u_red_over_blue=u_ratio,
        contrast=float(pattern.std() / level) if level > 0 else float("nan"),
        contrast_rgb=contrasts,
        speckles=independent_values(pattern),
        saturated=float(photo.saturated.mean()),
        overexposed=photo.overexposed,
    )


def _red_over_blue(red: FloatArray, blue: FloatArray) -> tuple[float, float]:
    """Ratio of the means and its standard uncertainty, to first order; NaN where a mean is not positive.

    What the two channels share, brightness, drops out: the error is the mean of red / mean - blue / mean over the
    pattern.
    """
    means = float(red.mean()), float(blue.mean())
    if min(means) <= 0:
        return float("nan"), float("nan")
    ratio = means[0] / means[1]
    difference = red / means[0] - blue / means[1]
    return ratio, ratio * float(difference.std()) / independent_values(difference) ** 0.5
