"""A dataset with known truth, that of the simulated bench, with errors drawn from the sources that it states."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.angular import along_theta_out, incidence_groups
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource, everywhere
from simulators.materials.materials import SAMPLES, true_brdf

U_ANGLE, U_ZERO = 0.005, 0.01
WAVELENGTHS = np.linspace(383, 778, 24)
INCIDENT = tuple(range(0, 81, 10))


def directions(alpha: float, incident: Sequence[float] = INCIDENT) -> tuple[FloatArray, FloatArray]:
    """Directions as a plan takes them: some in the lobe, every 10 degrees elsewhere, none of them blocked."""
    width = 2 * np.degrees(alpha)
    lobe = np.geomspace(0.3 * width, 170, 4)
    offsets = np.unique(np.concatenate([-lobe, lobe, np.arange(-160.0, 161, 10)]))
    pairs = [(t, t + o) for t in incident for o in offsets if abs(t + o) <= 85 and abs(2 * t + o) >= 5]
    theta_in, theta_out = np.array(pairs, dtype=float).T
    return theta_in, theta_out


def drawn_dataset(
    name: str,
    *,
    seed: int = 0,
    spot: int = 0,
    at: tuple[FloatArray, FloatArray] | None = None,
    zeros: tuple[float, float] | None = None,
    reference_error: float | None = None,
) -> Dataset:
    """What lies on the simulated bench as `name`, seen at a `spot`.

    Counts err by 0.3 % and 1e-5 1/sr, the reference by 1 %, the stages by what is stated above; `reference_error`,
    relative, and the `zeros` of sample and detector stage, degrees, stand in place of drawn errors. `at` are theta_in
    and theta_out of the points, degrees.
    """
    random = np.random.default_rng(seed)
    what = SAMPLES[name]
    theta_in, theta_out = directions(what.alpha) if at is None else at
    points = theta_in.size
    groups = incidence_groups(theta_in, 1e-6)
    zero_sample, zero_detector = random.normal(0, U_ZERO, 2) if zeros is None else zeros
    sample = zero_sample + random.normal(0, U_ANGLE, groups.max() + 1)[groups]
    detector = zero_detector + random.normal(0, U_ANGLE, points)
    # the formula knows no difference between the two sides of theta_in = 0
    side = np.where(theta_in + sample < 0, -1, 1)
    truth = true_brdf(what, side * (theta_in + sample), side * (theta_out + detector - sample), WAVELENGTHS, spot=spot)
    of_reference = 0.01 * random.standard_normal() if reference_error is None else reference_error
    counts = np.hypot(3e-3 * truth, 1e-5)
    brdf = truth * (1 + of_reference) + counts * random.standard_normal(truth.shape)
    slope = along_theta_out(theta_out, groups, brdf, counts).first
    everyone = everywhere(points)
    sources = (
        ErrorSource("random", "random", counts, None, False),
        ErrorSource("reference: panel", "reference", 0.01 * brdf, everyone, True),
        ErrorSource("angle: sample zero", "angle", -2 * slope * U_ZERO, everyone, True),
        ErrorSource("angle: detector zero", "angle", slope * U_ZERO, everyone, True),
        ErrorSource("angle: sample stage", "angle", -2 * slope * U_ANGLE, groups, True),
        ErrorSource("angle: detector stage", "angle", slope * U_ANGLE, None, True),
    )
    return Dataset(
        sample=name,
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=WAVELENGTHS,
        brdf=brdf,
        sources=sources,
        flags=np.zeros(points, dtype=np.uint16),
        u_angle=U_ANGLE,
        u_zero=U_ZERO,
        aperture=1.0,
    )
