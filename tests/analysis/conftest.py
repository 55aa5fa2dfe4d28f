"""A measurement made from the models: known truth, seen through a full aperture, with every error of the bench."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from analysis.directions import round_aperture, through_aperture
from analysis.fresnel import load_conductor
from analysis.models import cook_torrance
from drivers.arrays import FloatArray
from goniometer.dataset import Dataset

U_ANGLE = 0.005


def _directions(alpha: float, incident: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Directions as a dynamic plan takes them: dense in the lobe, sparse elsewhere, none of them blocked."""
    width = 2 * np.degrees(alpha)
    offsets = np.concatenate([-np.geomspace(0.3 * width, 170, 4)[::-1], [0.0], np.geomspace(0.3 * width, 170, 4)])
    pairs = [
        (theta, theta + offset)
        for theta in incident
        for offset in np.unique(np.concatenate([offsets, np.arange(-150.0, 160, 4)]))
        if abs(theta + offset) <= 85 and abs(2 * theta + offset) >= 5
    ]
    theta_in, theta_out = np.array(pairs, dtype=float).T
    return theta_in, theta_out


def _measure(
    alpha: float,
    h: float = 0.0,
    w: float = 0.0,
    *,
    seed: int = 0,
    noise: float = 3e-3,
    reference: float = 1e-3,
    floor: float = 1e-5,
    rule: tuple[int, int] = (5, 14),
    wavelength_step: float = 4.6,
    incident: Sequence[float] = (0, 10, 20, 30, 40, 50, 60, 70, 80),
) -> Dataset:
    """Cook-Torrance with shift, measured.

    `noise` is relative and `floor` absolute (1/sr), both independent everywhere; a quarter of `noise` comes again
    as the dark's error, shared by the points of one integration time; `reference` is relative, half of its variance
    shared by all points and half by those of one incident angle; `rule` is the rings and spokes over which the
    aperture averages.
    """
    rng = np.random.default_rng(seed)
    theta_in, theta_out = _directions(alpha, incident)
    wavelengths = np.arange(382.0, 996.0, wavelength_step)
    group = np.unique(theta_in, return_inverse=True)[1]
    sample_error = rng.normal(0, U_ANGLE, len(incident))[group]
    error_at_reference = rng.normal(0, U_ANGLE, len(incident))[group]
    detector_error = rng.normal(0, U_ANGLE, theta_in.size)
    # the detector stage sets theta_in + theta_out, so turning the sample moves both
    true_in, true_out = theta_in + sample_error, theta_out + detector_error - sample_error
    aperture = round_aperture(1.0, *rule)
    clean = np.empty((theta_in.size, wavelengths.size))
    for i in range(theta_in.size):  # one by one, for a fine rule does not fit into memory otherwise
        nodes = through_aperture(true_in[i : i + 1], true_out[i : i + 1], aperture)
        clean[i] = aperture.weights @ cook_torrance(nodes, wavelengths, alpha, load_conductor(), h, w)[0]
    # irradiance goes with the cosine of the true angle, of the sample and of the reference panel before it
    clean *= (np.cos(np.radians(true_in)) / np.cos(np.radians(theta_in + error_at_reference)))[:, None]
    time = np.where(np.abs(theta_out - theta_in) < 30, 1.0, 4.0)
    u_random, u_dark = np.hypot(noise * clean, floor), 0.25 * noise * clean
    u_reference = np.sqrt(0.5) * reference * clean
    dark = rng.standard_normal((2, wavelengths.size))[np.unique(time, return_inverse=True)[1]]
    of_one_angle = rng.standard_normal((len(incident), wavelengths.size))[group]
    of_all = rng.standard_normal(wavelengths.size)
    brdf = clean + u_random * rng.standard_normal(clean.shape) + u_dark * dark + u_reference * (of_one_angle + of_all)
    return Dataset(
        sample=f"alpha {alpha:g}",
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=wavelengths,
        brdf=brdf,
        u_random=u_random,
        u_dark=u_dark,
        u_reference=u_reference,
        u_reference_dark=u_reference,
        integration_time=time,
        u_angle=U_ANGLE,
        aperture=1.0,
        saturated=np.zeros(theta_in.size, dtype=bool),
    )


@pytest.fixture(scope="session")
def measure() -> Callable[..., Dataset]:
    """Make a measured dataset from (alpha, h, w) and the errors of the bench."""
    return _measure
