"""What the errors of a measurement do to the residuals of a microfacet fit, and through them to its parameters."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.fits.brdf_problem import Linearised, log_model
from analysis.fits.loew import LoewData
from analysis.fits.propagation import covariance_by_part, errors_of_data
from analysis.reflectance.directions import Aperture
from analysis.reflectance.microfacet import View, view
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.uncertainty import ErrorSource, everywhere

_LEAST_EIGENVALUE = 1e-12
"""Of the normal matrix scaled to a unit diagonal, below which its direction is lost in double precision."""

_LEAST_SHARE = 1e-6
"""Share of a lost direction that makes a parameter undetermined."""


class Pulled(NamedTuple):
    """Slopes of points, each measured from its own spectrum, that the parameters were fitted to as well."""

    jacobian: FloatArray
    """[parameters, slopes] of their weighted residuals, by log alpha and the other parameters."""
    row: NDArray[np.intp]
    """[slopes] at which point."""
    gain: FloatArray
    """[slopes, wavelengths] derivative of a weighted slope by ln(1 + cos(theta_in) f) of its point."""


def residual_errors(
    data: LoewData, seen: View, aperture: Aperture, parameters: FloatArray, albedo: FloatArray | None
) -> tuple[ErrorSource, ...]:
    """What one standard uncertainty of every source does to the unweighted residuals.

    The angles' part of the dataset is replaced by what the model says: it knows, through the aperture, how a lobe
    changes between two measured directions.
    """
    of_dataset = errors_of_data(data.dataset, data.points, data.log_derivative)
    return (
        *(source for source in of_dataset if source.part != "angle"),
        *_angle_errors(data, seen, aperture, parameters, albedo),
    )


def _angle_errors(
    data: LoewData, seen: View, aperture: Aperture, parameters: FloatArray, albedo: FloatArray | None
) -> tuple[ErrorSource, ...]:
    """Errors of the stages' positions and zeros; each moves the true direction away from the stated one.

    The detector stage sets theta_in + theta_out: its error changes theta_out alone, while an error e of the sample
    stage changes theta_in by e, and with it the irradiance, and theta_out by -e. When the reference panel stood at
    this theta_in the stage had another error; of it only the irradiance matters, as the panel is nearly Lambertian.
    A zero's error is the same for the panel and the sample, so the irradiance cancels in their ratio.
    """
    dataset = data.dataset
    step = max(1e-3 * dataset.aperture, 1e-5)
    incidence = incidence_groups(data.theta_in, SAME_INCIDENCE)
    # a dataset knows how often the stage came back to an incident angle; without that, once
    visits = {source.name: source.groups for source in dataset.sources}.get("angle: sample stage")
    visit = incidence if visits is None else visits[data.points]
    shared = everywhere(data.theta_in.size)

    def derivative(d_in: float, d_out: float) -> FloatArray:
        """Of the log model at the stated irradiance, per degree."""
        ahead, behind = (
            replace(
                view(
                    seen.form,
                    data.theta_in + side * d_in * step,
                    data.theta_out + side * d_out * step,
                    dataset.wavelengths,
                    aperture,
                ),
                cos_in=seen.cos_in,
            )
            for side in (1, -1)
        )
        return np.asarray((log_model(ahead, parameters, albedo) - log_model(behind, parameters, albedo)) / (2 * step))

    by_detector, by_sample = derivative(0.0, 1.0), derivative(1.0, -1.0)
    # d ln(1 + x) = x / (1 + x) dx / x; the relative error of the irradiance is -tan(theta_in) times that of the angle
    share = -np.expm1(-log_model(seen, parameters, albedo))
    irradiance = -share * np.tan(np.radians(data.theta_in))[:, None] * np.pi / 180
    return tuple(
        ErrorSource(f"angle: {name}", "angle", size * effect, groups, shared_by_wavelengths=True)
        for name, effect, groups, size in (
            ("detector stage", by_detector, None, dataset.u_angle),
            ("sample stage", by_sample + irradiance, visit, dataset.u_angle),
            ("sample stage at the reference", irradiance, incidence, dataset.u_angle),
            ("detector zero", by_detector, shared, dataset.u_zero),
            ("sample zero", by_sample, shared, dataset.u_zero),
        )
    )


def parameter_gain(
    near: Linearised, data: LoewData, parameters: FloatArray, free: int, pulled: Pulled | None = None
) -> tuple[FloatArray, BoolArray]:
    """[free, points, wavelengths] derivative of the first `free` parameters by the data, and which are determined.

    To first order, from the normal equations at the minimum, to which the slopes that were fitted to belong too.
    Parameters that the data do not tell apart, or that have no effect, are not determined; what is given for them means
    nothing.
    """
    shape = near.jacobian[:free].shape
    flat = near.jacobian[:free].reshape(free, -1)
    of_cost = flat.shape[1]
    if pulled is not None:
        flat = np.concatenate([flat, pulled.jacobian[:free]], axis=1)
    size = np.linalg.norm(flat, axis=1)
    scaled = flat / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    lost = values < _LEAST_EIGENVALUE
    determined = (size > 0) & (np.sum(vectors[:, lost] ** 2, axis=1) < _LEAST_SHARE)
    inverse = (vectors[:, ~lost] / values[~lost]) @ vectors[:, ~lost].T
    of_rows = inverse @ scaled / np.where(size > 0, size, 1.0)[:, None]
    gain = of_rows[:, :of_cost].reshape(shape) * data.root_weight
    if pulled is not None:
        gain[:, pulled.row] += of_rows[:, of_cost:, None] * pulled.gain
    gain[0] *= parameters[0]
    return gain, determined


def parameter_covariances(
    near: Linearised,
    data: LoewData,
    parameters: FloatArray,
    free: int,
    errors: tuple[ErrorSource, ...],
    pulled: Pulled | None = None,
) -> dict[str, FloatArray]:
    """[free, free] covariance of the first `free` parameters by part of the budget.

    A parameter that is not determined has an infinite variance and is correlated with nothing.
    """
    gain, determined = parameter_gain(near, data, parameters, free, pulled)
    by_part = covariance_by_part(gain, errors)
    for covariance in by_part.values():
        covariance[~determined, :] = 0.0
        covariance[:, ~determined] = 0.0
        covariance[~determined, ~determined] = math.inf
    return by_part


def albedo_uncertainty(
    near: Linearised, data: LoewData, parameters: FloatArray, free: int, errors: tuple[ErrorSource, ...]
) -> FloatArray:
    """[wavelengths] standard uncertainty of the diffuse albedo, by all `errors`; infinite where it stands at 0.

    An error moves the albedo of its wavelength, and that of all wavelengths through the other parameters.
    """
    gain, _ = parameter_gain(near, data, parameters, free)
    size = np.sum(near.by_albedo**2, axis=0)
    own = data.root_weight * near.by_albedo / np.where(size > 0, size, 1.0)
    in_search = near.full_jacobian[:free] / np.where(np.arange(free) == 0, parameters[0], 1.0)[:, None, None]
    through = np.einsum("kpw,pw->kw", in_search, near.by_albedo) / np.where(size > 0, size, 1.0)
    variance = np.zeros(size.size)
    for source in errors:
        of_parameters, of_own = gain * source.values, own * source.values
        if source.groups is not None:
            member = (np.arange(source.groups.max() + 1)[:, None] == source.groups).astype(float)
            of_parameters, of_own = member @ of_parameters, member @ of_own
        if source.shared_by_wavelengths:
            total = of_own - np.einsum("kw,kg->gw", through, of_parameters.sum(axis=2))
            variance += np.sum(total**2, axis=0)
        else:
            moved = np.einsum("kw,kgw->gw", through, of_parameters)
            flat = of_parameters.reshape(free, -1)
            variance += np.sum(of_own**2 - 2 * of_own * moved, axis=0)
            variance += np.einsum("kw,kl,lw->w", through, flat @ flat.T, through)
    return np.where(size > 0, np.sqrt(variance), math.inf)
