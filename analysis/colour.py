"""Colour of spectra and colour differences (section 4.3 of the paper).

A spectrum f is seen under D65 at its angle of incidence: the stimulus is cos(theta_in) f(lambda) D65(lambda),
looked at by the CIE 1931 2 degree observer. White is f cos(theta_in) = 1, so a BRDF of 1/sr at normal
incidence is white with Y = 1. Observer, illuminant, Lab and CIEDE2000 come from `colour-science`; all spectra
are converted in one matrix product.
"""

from functools import cache

import numpy as np

from analysis.errors import OutOfRange
from analysis.reflectance.models import LAMBDA_N
from analysis.results import ColourDifferences
from drivers.arrays import FloatArray

COLOUR_RANGE = (400.0, 700.0)
"""Wavelengths that a spectrum must reach to have a colour, nm; 99.8 % of the luminous weight lies within."""

NORMALISATION_HALF_WIDTH = 25.0
"""Half width of the band around lambda_n in which a measured spectrum is normalised, nm."""


@cache
def _observer_under_d65() -> tuple[FloatArray, FloatArray]:
    """Wavelengths [1 nm steps] and colour matching functions times D65 [wavelengths, XYZ], white Y = 1."""
    import colour  # noqa: PLC0415  (takes seconds)

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    illuminant = colour.SDS_ILLUMINANTS["D65"]
    wavelengths = np.arange(360.0, 781.0)
    d65 = np.interp(wavelengths, illuminant.wavelengths, illuminant.values)
    observer = np.stack([np.interp(wavelengths, cmfs.wavelengths, cmfs.values[:, i]) for i in range(3)], axis=-1)
    weighted = observer * d65[:, None]
    return wavelengths, weighted / weighted[:, 1].sum()


def observer(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths, 3] colour matching functions of the CIE 1931 2 degree observer; `wavelengths` in nm.

    Beyond their table, 360 to 830 nm, they are 0: the eye sees nothing there.

    >>> observer(np.array([300.0, 555.0, 900.0]))[:, 1].tolist()
    [0.0, 1.0, 0.0]
    """
    import colour  # noqa: PLC0415  (takes seconds)

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.stack([np.interp(wavelengths, cmfs.wavelengths, cmfs.values[:, i], 0, 0) for i in range(3)], axis=-1)


def illuminant(name: str, wavelengths: FloatArray) -> FloatArray:
    """[wavelengths] relative spectrum of a CIE illuminant, e.g. D65, A or FL11; `wavelengths` in nm.

    Beyond its table it keeps the value at the end. Raises `OutOfRange` for a name that `colour-science` does not know.

    >>> illuminant("D65", np.array([560.0, 780.0, 900.0])).round(4).tolist()
    [100.0, 63.3828, 63.3828]
    """
    import colour  # noqa: PLC0415  (takes seconds)

    if name not in colour.SDS_ILLUMINANTS:
        raise OutOfRange(f'There is no illuminant "{name}"; there are D65, D50, A, E, FL1 to FL12, LED-B1 and others.')
    found = colour.SDS_ILLUMINANTS[name]
    return np.asarray(np.interp(wavelengths, found.wavelengths, found.values))


def xyz_weights(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths, 3] weights that turn a spectrum sampled at `wavelengths` (nm, ascending) into XYZ under D65.

    The spectrum between its samples is taken as linear, beyond its ends as constant, and integrated at 1 nm;
    so the weights of any grid, fine or coarse, sum to the D65 white with Y = 1. Raises `OutOfRange` if the
    grid does not reach from 400 to 700 nm, because a colour would then be invented.
    """
    if not (wavelengths[0] <= COLOUR_RANGE[0] and wavelengths[-1] >= COLOUR_RANGE[1]):
        raise OutOfRange(
            f"A colour needs wavelengths from {COLOUR_RANGE[0]:g} to {COLOUR_RANGE[1]:g} nm, "
            f"but the spectra cover {wavelengths[0]:g} to {wavelengths[-1]:g} nm."
        )
    fine, weighted = _observer_under_d65()
    upper = np.clip(np.searchsorted(wavelengths, fine), 1, wavelengths.size - 1)
    fraction = np.clip((fine - wavelengths[upper - 1]) / (wavelengths[upper] - wavelengths[upper - 1]), 0, 1)
    weights = np.zeros((wavelengths.size, 3))
    np.add.at(weights, upper - 1, (1 - fraction)[:, None] * weighted)
    np.add.at(weights, upper, fraction[:, None] * weighted)
    return weights


def has_colour(wavelengths: FloatArray) -> bool:
    """Whether spectra at these wavelengths, nm, cover what a colour needs."""
    return bool(wavelengths[0] <= COLOUR_RANGE[0] and wavelengths[-1] >= COLOUR_RANGE[1])


def brdf_to_xyz(brdf: FloatArray, theta_in: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[points, 3] XYZ of spectra [points, wavelengths] in 1/sr, seen under D65 at `theta_in` [points], degrees.

    A spectrum with NaN at a wavelength that the eye sees gives NaN. Raises `OutOfRange` as `xyz_weights`.
    """
    weights = xyz_weights(wavelengths)
    seen = np.any(weights != 0, axis=1)
    return np.asarray((brdf[:, seen] @ weights[seen]) * np.cos(np.radians(theta_in))[:, None])


def xyz_to_rgb(xyz: FloatArray) -> FloatArray:
    """[..., 3] linear BT.709 of [..., 3] XYZ under D65; neither clipped nor encoded.

    White is the sum of `xyz_weights`, so that the white spectrum is (1, 1, 1) exactly; it differs from the
    rounded chromaticity (0.3127, 0.3290) of ITU-R BT.709-6 in the fourth digit.
    """
    import colour  # noqa: PLC0415  (takes seconds)

    white = _observer_under_d65()[1].sum(axis=0)
    matrix = np.asarray(colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_XYZ_to_RGB)
    return np.asarray(xyz @ (matrix / (matrix @ white)[:, None]).T)


def rgb_to_xyz(rgb: FloatArray) -> FloatArray:
    """[..., 3] XYZ under D65 of [..., 3] linear BT.709, which has the primaries of sRGB: undoes `xyz_to_rgb`."""
    return np.asarray(rgb @ np.linalg.inv(xyz_to_rgb(np.eye(3))))


def brdf_to_rgb(brdf: FloatArray, theta_in: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[points, 3] linear BT.709 of spectra [points, wavelengths]; a uniform 1/sr at normal incidence is (1, 1, 1).

    Raises `OutOfRange` as `xyz_weights`.

    >>> brdf_to_rgb(np.ones((2, 4)), np.array([0.0, 60.0]), np.array([400.0, 500.0, 600.0, 700.0])).round(9).tolist()
    [[1.0, 1.0, 1.0], [0.5, 0.5, 0.5]]
    """
    return xyz_to_rgb(brdf_to_xyz(brdf, theta_in, wavelengths))


def display_encoded(rgb: FloatArray) -> FloatArray:
    """Linear RGB of any shape, clipped to [0, 1] and encoded for a display (sRGB, IEC 61966-2-1).

    >>> display_encoded(np.array([-0.1, 0.21404, 2.0])).round(4).tolist()
    [0.0, 0.5, 1.0]
    """
    clipped = np.clip(rgb, 0, 1)
    return np.asarray(np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055))


def delta_e_2000(xyz: FloatArray, other: FloatArray) -> FloatArray:
    """[...] CIEDE2000 between two [..., 3] XYZ; white is D65 with Y = 1. NaN where either is NaN.

    Values are taken as they are: an L above 100 (brighter than f cos = 1) is not clipped.
    """
    import colour  # noqa: PLC0415  (takes seconds)

    white = colour.XYZ_to_xy(_observer_under_d65()[1].sum(axis=0))
    lab, other_lab = colour.XYZ_to_Lab(xyz, white), colour.XYZ_to_Lab(other, white)
    return np.asarray(colour.delta_E(lab, other_lab, method="CIE 2000"))


def colour_differences(
    measured: FloatArray,
    fitted: FloatArray,
    wavelengths: FloatArray,
    theta_in: FloatArray,
    lambda_n: float = LAMBDA_N,
) -> ColourDifferences:
    """CIEDE2000 between spectra [points, wavelengths] in 1/sr, absolute and chromatic.

    Absolute: the spectra as they are; L is not clipped at 100 here, only `display_encoded` clips, for pictures.
    Chromatic: both spectra are divided by their value at `lambda_n` (nm), so their brightness and the angle of
    incidence drop out. A single noisy sample is no normalisation: the measured one is divided by the fitted
    value at `lambda_n` times the median of measured / fitted within 25 nm of it. NaN where a spectrum has a
    gap in the visible, and in the chromatic difference where no light is left at `lambda_n`. Raises `OutOfRange` as
    `xyz_weights`.
    """
    absolute = delta_e_2000(brdf_to_xyz(measured, theta_in, wavelengths), brdf_to_xyz(fitted, theta_in, wavelengths))

    level, ratio = _normalisation(measured, fitted, wavelengths, lambda_n)
    normal = np.zeros_like(theta_in)
    chromatic = delta_e_2000(
        brdf_to_xyz(measured / (level * ratio)[:, None], normal, wavelengths),
        brdf_to_xyz(fitted / level[:, None], normal, wavelengths),
    )
    return ColourDifferences(absolute, chromatic)


def _normalisation(
    measured: FloatArray, fitted: FloatArray, wavelengths: FloatArray, lambda_n: float
) -> tuple[FloatArray, FloatArray]:
    """[points] fitted value at `lambda_n`, and median of measured / fitted around it; NaN where not positive."""
    upper = int(np.clip(np.searchsorted(wavelengths, lambda_n), 1, wavelengths.size - 1))
    fraction = (lambda_n - wavelengths[upper - 1]) / (wavelengths[upper] - wavelengths[upper - 1])
    level = (1 - fraction) * fitted[:, upper - 1] + fraction * fitted[:, upper]
    near = np.abs(wavelengths - lambda_n) <= NORMALISATION_HALF_WIDTH
    near[upper - 1 : upper + 1] = True
    positive = np.where(fitted[:, near] > 0, fitted[:, near], np.nan)
    # a NaN among the samples makes this median NaN, and so it must: the spectrum has a gap in the visible
    ratio = np.median(measured[:, near] / positive, axis=1)
    return np.where(level > 0, level, np.nan), np.where(ratio > 0, ratio, np.nan)
