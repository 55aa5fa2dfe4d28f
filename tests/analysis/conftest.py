"""A measurement made from the models: known truth, seen through a full aperture, with every error of the bench."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from analysis.reflectance.directions import Directions, round_aperture, through_aperture
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cook_torrance
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource, Groups, everywhere

Brdf = Callable[[Directions, FloatArray], FloatArray]
"""Values [..., wavelengths], 1/sr, at directions [...] and wavelengths, nm."""

U_ANGLE = 0.005
U_ZERO = 0.01


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


def _drawn(source: ErrorSource, rng: np.random.Generator) -> FloatArray:
    """[points, wavelengths] one draw of the errors that a source describes, 1/sr."""
    points, wavelengths = source.values.shape
    columns = 1 if source.shared_by_wavelengths else wavelengths
    groups = np.arange(points) if source.groups is None else source.groups
    return np.asarray(source.values * rng.standard_normal((int(groups.max()) + 1, columns))[groups])


def _from_counts(
    clean: FloatArray, times: Groups, incidence: Groups, noise: float, reference: float, floor: float
) -> tuple[ErrorSource, ...]:
    """What the noise of the counts makes: every wavelength has its own error."""
    of_reference = np.sqrt(0.5) * reference * clean
    together = everywhere(clean.shape[0])
    return (
        ErrorSource("random: counts", "random", np.hypot(noise * clean, floor), None, False),
        ErrorSource("dark", "dark", 0.25 * noise * clean, times, False),
        ErrorSource("random: counts of the reference", "random", of_reference, incidence, False),
        ErrorSource("dark: reference", "dark", of_reference, together, False),
    )


def _systematic(clean: FloatArray, wavelengths: FloatArray, incidence: Groups) -> tuple[ErrorSource, ...]:
    """Errors that all wavelengths share, and all points or those of one incident angle, of a size that matters."""
    together, x = everywhere(clean.shape[0]), (wavelengths - 600) * 1e-3
    return (
        ErrorSource("reference: certificate", "reference", 0.005 * clean, together, True),
        ErrorSource("reference: slope of the certificate", "reference", 0.02 * x * clean, together, True),
        ErrorSource("reference: directions", "reference", 0.004 * clean, incidence, True),
        ErrorSource("non-linearity", "non-linearity", 0.002 * clean * clean / clean.max(), together, True),
        ErrorSource("wavelength", "wavelength", 0.1 * np.gradient(clean, wavelengths, axis=1), together, True),
        ErrorSource("drift: colour of the lamp", "drift", 0.01 * x * clean, incidence, True),
        ErrorSource("stray light", "stray light", np.full(clean.shape, 1e-4), together, True),
    )


def _measure(
    alpha: float,
    h: float = 0.0,
    w: float = 0.0,
    *,
    seed: int = 0,
    noise: float = 3e-3,
    reference: float = 1e-3,
    floor: float = 1e-5,
    systematic: bool = False,
    rule: tuple[int, int] = (5, 14),
    wavelength_step: float = 4.6,
    incident: Sequence[float] = (0, 10, 20, 30, 40, 50, 60, 70, 80),
    brdf: Brdf | None = None,
) -> Dataset:
    """Cook-Torrance with shift, measured.

    `noise` is relative and `floor` absolute (1/sr), both independent everywhere; a quarter of `noise` comes again
    as the dark's error, shared by the points of one integration time; `reference` is relative, half of its variance
    shared by all points and half by those of one incident angle; `systematic` adds errors that wavelengths and points
    share, those of the stages' zeros among them; `rule` is the rings and spokes over which the aperture averages;
    `brdf` is what is measured instead, `alpha` then only says where directions lie dense.
    """
    rng = np.random.default_rng(seed)
    theta_in, theta_out = _directions(alpha, incident)
    wavelengths = np.arange(382.0, 996.0, wavelength_step)
    group = np.unique(theta_in, return_inverse=True)[1]
    u_zero = U_ZERO if systematic else 0.0
    sample_error = rng.normal(0, U_ANGLE, len(incident))[group]
    error_at_reference = rng.normal(0, U_ANGLE, len(incident))[group]
    detector_error = rng.normal(0, U_ANGLE, theta_in.size)
    zero_of_sample, zero_of_detector = rng.normal(0, u_zero, 2)
    # the detector stage sets theta_in + theta_out, so turning the sample moves both
    true_in = theta_in + sample_error + zero_of_sample
    true_out = theta_out + detector_error + zero_of_detector - sample_error - zero_of_sample
    aperture = round_aperture(1.0, *rule)
    seen = brdf or (lambda nodes, nm: cook_torrance(nodes, nm, alpha, load_conductor(), h, w))
    clean = np.empty((theta_in.size, wavelengths.size))
    for i in range(theta_in.size):  # one by one, for a fine rule does not fit into memory otherwise
        nodes = through_aperture(true_in[i : i + 1], true_out[i : i + 1], aperture)
        clean[i] = aperture.weights @ seen(nodes, wavelengths)[0]
    # irradiance goes with the cosine of the true angle, of the sample and of the reference panel before it; the zero
    # was the same for both
    at_reference = theta_in + error_at_reference + zero_of_sample
    clean *= (np.cos(np.radians(true_in)) / np.cos(np.radians(at_reference)))[:, None]
    times = np.where(np.abs(theta_out - theta_in) < 30, 0, 1)
    sources = _from_counts(clean, times, group, noise, reference, floor)
    if systematic:
        sources += _systematic(clean, wavelengths, group)
    return Dataset(
        sample=f"alpha {alpha:g}",
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=wavelengths,
        brdf=clean + np.sum([_drawn(source, rng) for source in sources], axis=0),
        sources=sources,
        flags=np.zeros(theta_in.size, dtype=np.uint16),
        u_angle=U_ANGLE,
        u_zero=u_zero,
        aperture=1.0,
    )


@pytest.fixture(scope="session")
def measure() -> Callable[..., Dataset]:
    """Make a measured dataset from (alpha, h, w) and the errors of the bench."""
    return _measure
