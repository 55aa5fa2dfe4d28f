"""Which directions tell most about a BRDF, judged by the uncertainty of the process that interpolates it.

The error of reading the BRDF between its points is judged where it matters: in ln(1 + cos(theta_in) f), the scale on
which the fits compare a model with a measurement (Loew et al. 2012), and in colour. Directions are added one by one,
each the one that most reduces the expected square of both errors over all directions (Cohn 1996), as far as the
measurement's noise lets it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from drivers.arrays import BoolArray, FloatArray
from goniometer.interpolation.interpolant import Interpolant, Prediction, Shape
from goniometer.interpolation.kernel import coordinates, covariance
from goniometer.plans.colour_error import colour_slopes

WIDEST_STEP = 4.0
"""Largest distance of two candidate directions, degrees."""

FINENESS = 0.3
"""Distance of two candidates in correlation lengths."""


@dataclass(frozen=True)
class Candidates:
    """Directions that might be measured, and over which errors are averaged; [candidates] each."""

    theta_in: FloatArray
    """Degrees."""
    theta_out: FloatArray
    """Degrees."""
    share: FloatArray
    """Part of all directions for which it stands, times how much they matter; sums to one."""


@dataclass(frozen=True)
class Errors:
    """Expected errors of reading the BRDF at candidates, [candidates]; standard uncertainties."""

    sigma: FloatArray
    """Of ln(cos f), by the process and its record."""
    noise: FloatArray
    """Of ln(cos f), if the direction were measured."""
    per_sigma: FloatArray
    """[candidates, 2] error of ln(1 + cos f), and dE00, for each unit of `sigma`."""
    noise_floor: FloatArray
    """[2] root mean square over directions of what the noise of a measured point makes of both errors."""
    colour_mean: float
    """Mean of dE00 over its root mean square, at one direction."""


def candidates(parts: dict[float, list[tuple[float, float]]], shape: Shape) -> Candidates:
    """Directions of each incident angle's measurable `parts` (from, to; degrees), denser where it is steep."""
    theta_in, theta_out, share = [], [], []
    for angle, ranges in parts.items():
        for low, high in ranges:
            fine = np.linspace(low, high, max(int((high - low) / 0.05), 1) + 1)
            warped = coordinates(np.full_like(fine, angle), fine, shape.lobe).warped(shape.scales)
            position = warped / FINENESS + fine / WIDEST_STEP
            position -= position[0]
            count = int(np.ceil(position[-1])) + 1
            at = np.interp(np.linspace(0, position[-1], count), position, fine) if count > 1 else fine[:1]
            at = np.concatenate([at[:1], np.round(at[1:-1], 2), at[-1:]]) if count > 1 else at
            theta_in.append(np.full(at.size, angle))
            theta_out.append(at)
            share.append(np.gradient(at) if at.size > 1 else np.zeros(1))
    weights = np.concatenate(share)
    return Candidates(np.concatenate(theta_in), np.concatenate(theta_out), weights / weights.sum())


def expected_errors(
    process: Interpolant, where: Candidates, predicted: Prediction, colour_slope: float | None = None
) -> Errors:
    """What `predicted` at the candidates means for both errors.

    With `colour_slope` colours are those of a scene's image, in which `where.share` says how much a direction shows:
    it is the mean dE00 of the image for each unit of error of ln(cos f) in all directions together.
    """
    offset = process.shape.offset
    level = np.exp(predicted.latent)
    value = np.maximum(level - offset, 0.0)
    spread = np.diag(process.spread)
    logarithmic = (level / (1 + value)) ** 2
    slopes = colour_slopes(value) * level[:, None, :]  # dE00 along three axes by ln(cos f) of each band
    axes = np.einsum("pab,bc,pdc->pad", slopes, process.spread, slopes)
    square = np.trace(axes, axis1=1, axis2=2)
    near = predicted.near + 1e-9
    noise = np.exp((np.log(process.noise) @ near) / near.sum(axis=0))
    per_sigma = np.sqrt(np.stack([logarithmic @ spread / spread.size, square], axis=1))
    own = np.stack([logarithmic.mean(axis=1), np.einsum("pab,pab->p", slopes, slopes)], axis=1)
    if colour_slope is not None:
        per_sigma[:, 1], own[:, 1] = colour_slope, colour_slope**2
    floor = np.sqrt(where.share @ (own * noise[:, None] ** 2))
    degrees = np.sum(square) ** 2 / max(float(np.sum(axes**2)), 1e-300) / max(len(square), 1)
    return Errors(
        predicted.sigma * predicted.trust, noise, per_sigma, floor, _mean_of_length(float(np.clip(degrees, 1, 3)))
    )


def _mean_of_length(degrees: float) -> float:
    """Mean over root mean square of the length of a vector of so many equal normal components (chi distribution)."""
    return float(np.sqrt(2 / degrees) * np.exp(gammaln((degrees + 1) / 2) - gammaln(degrees / 2)))


def total(where: Candidates, errors: Errors, sigma: FloatArray) -> FloatArray:
    """[2] root mean square error of ln(1 + cos f) and mean dE00 over all directions, for a `sigma` [candidates]."""
    rms = np.sqrt(where.share @ (errors.per_sigma * sigma[:, None]) ** 2)
    mean = errors.colour_mean * (where.share @ (errors.per_sigma[:, 1] * sigma))
    return np.array([rms[0], mean])


_SAME = 1e-6
"""Degrees that rounding may take from a distance."""

_NEGLIGIBLE = 1e-3
"""Part of the expected square of the errors that may come from candidates that are not looked at."""


def _weighty(squares: FloatArray) -> NDArray[np.intp]:
    """The candidates from which nearly all of the errors come."""
    order = np.argsort(-squares, kind="stable")
    enough = int(np.searchsorted(np.cumsum(squares[order]), (1 - _NEGLIGIBLE) * squares.sum())) + 1
    return order[:enough]


def choose(
    process: Interpolant,
    where: Candidates,
    predicted: Prediction,
    errors: Errors,
    goals: FloatArray,
    allowed: BoolArray,
    apart: float,
    most: int,
    least: int = 1,
    pending: Sequence[int] = (),
) -> list[int]:
    """Up to `most` candidates, best first, until both errors are expected to be below `goals` [2] and at least `least`.

    `allowed` [candidates] says which may be measured; they stay `apart` degrees from each other. A direction that is
    known as well as a measurement would tell it is not chosen: empty where there is no other. `pending` are candidates
    that will be measured anyway.
    """
    trust2 = predicted.trust**2
    open_goals = total(where, errors, errors.sigma) > goals
    if not open_goals.any():
        open_goals[:] = True
    weight = where.share * trust2 * ((errors.per_sigma / goals) ** 2 @ open_goals)
    kept = np.union1d(_weighty(weight * predicted.sigma**2), np.asarray(pending, dtype=int))
    at = coordinates(where.theta_in[kept], where.theta_out[kept], process.shape.lobe)
    solved = predicted.solved[:, kept]
    doubt = predicted.doubt[kept]
    C = covariance(at, at, process.shape.scales) + doubt @ doubt.T - solved.T @ solved
    weight, trust2, noise2, free = weight[kept], trust2[kept], errors.noise[kept] ** 2, allowed[kept]
    for known in np.searchsorted(kept, pending):
        C -= np.outer(C[known], C[known]) / (C[known, known] + noise2[known])
    chosen: list[int] = []
    sigma = errors.sigma.copy()
    for _ in range(most):
        left = np.maximum(np.diag(C), 0.0)
        useful = free & (left * trust2 > noise2)
        if not useful.any():
            break
        gain = np.where(useful, (C**2 @ weight) / (left + noise2), -1.0)
        best = int(np.argmax(gain))
        chosen.append(int(kept[best]))
        same = where.theta_in[kept] == where.theta_in[kept[best]]
        free = free & ~(same & (np.abs(where.theta_out[kept] - where.theta_out[kept[best]]) < apart - _SAME))
        C -= np.outer(C[best], C[best]) / (left[best] + noise2[best])
        sigma[kept] = np.sqrt(np.maximum(np.diag(C), 0.0) * trust2)
        if len(chosen) >= least and np.all(total(where, errors, sigma) <= 0.9 * goals):
            break
    return chosen
