"""How a two-component shift of a metal is found: by the slopes of the spectra as much as by the cost of the whole.

Nearly all of Löw's cost on a real surface is brightness that the lobe does not have right, a number for every
direction that has nothing to do with colour. Left alone with it, six parameters of a slope buy brightness: where the
wavelengths do not lie evenly about lambda_n a slope brightens the whole spectrum. The fit then costs less and has the
wrong colours. What tells the slopes is the shape of every spectrum, whatever its brightness. So two sums are minimised
together, Löw's cost and the chi-square of the slopes that the spectra have by themselves, each in units of what it
leaves: two sets of as many directions whose variances nobody knows (variance components; the product of both sums is
then the likelihood). Where the lobe is right, little is left of the cost, and it decides by itself.

By that product the result is never worse than the cosine that it contains. Löw's cost alone may be a few per cent above
that of a cosine which was fitted to nothing else.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from analysis.choices import Engine
from analysis.errors import FitError
from analysis.fits.brdf_errors import Pulled
from analysis.fits.brdf_problem import problem, to_search
from analysis.fits.global_fit import search_slopes
from analysis.fits.least_squares import Minimum, SumOfSquares, minimise
from analysis.fits.loew import LoewData
from analysis.fits.noise import above_noise
from analysis.fits.propagation import variance_of_each_point
from analysis.reflectance.directions import Directions, in_plane
from analysis.reflectance.fresnel import Conductor, fresnel_conductor
from analysis.reflectance.microfacet import Form, View, slope_derivative, slope_of
from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

_LEAST_SLOPES = 12
"""Reliable slopes that say more of six parameters than the cost does; with fewer the cost is asked alone."""

_ROUNDS = 12
_SETTLED = 0.1
"""Relative change of the strength below which another round changes nothing."""


@dataclass(frozen=True)
class LocalSlopes:
    """Slopes that spectra have by themselves."""

    values: FloatArray
    """[slopes] 1/um."""
    root_weight: FloatArray
    """[slopes] one over the standard uncertainty, by all errors."""
    directions: Directions
    """[slopes] at the centre of the aperture."""
    points: BoolArray
    """[points] of the dataset that have a slope here."""
    gain: FloatArray
    """[slopes, wavelengths] derivative of a slope by the BRDF of its point."""

    def chi_square(self, modelled: FloatArray) -> float:
        """Of `modelled` slopes [slopes], 1/um."""
        return float(np.sum((self.root_weight * (self.values - modelled)) ** 2))


class Pull(NamedTuple):
    """Slopes that pull at a fit beside its cost."""

    slopes: LocalSlopes
    strength: float
    """By how much the chi-square of the slopes counts in the cost."""

    def rows(self, form: Form, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """[slopes] weighted residuals and [parameters, slopes] their derivatives."""
        value, by_shift = slope_derivative(form, self.slopes.directions, parameters)
        root = np.sqrt(self.strength) * self.slopes.root_weight
        jacobian = np.zeros((parameters.size, value.size))
        jacobian[form.first_of_shift :] = root * by_shift
        return root * (value - self.slopes.values), jacobian

    def linearised(self, form: Form, data: LoewData, parameters: FloatArray) -> Pulled:
        """What the standard errors of the parameters need to know of the slopes."""
        root = np.sqrt(self.strength) * self.slopes.root_weight
        row = np.flatnonzero(self.slopes.points[data.points])
        gain = root[:, None] * self.slopes.gain / data.log_derivative[row]
        return Pulled(self.rows(form, parameters)[1], row, gain)

    def scatter(self, form: Form, parameters: FloatArray) -> float:
        """By how much more than their uncertainty the slopes scatter (Birge ratio), at least one."""
        freedom = self.slopes.values.size - (parameters.size - form.first_of_shift)
        return float(np.sqrt(max(self.chi_square(form, parameters) / freedom, 1.0)))

    def chi_square(self, form: Form, parameters: FloatArray) -> float:
        """Of the slopes, whatever their strength."""
        return self.slopes.chi_square(slope_of(form, self.slopes.directions, parameters))


class PulledEnd(NamedTuple):
    """Where a descent ended that slopes pulled at."""

    minimum: Minimum
    """Its cost is Löw's alone."""
    pull: Pull


class TwoComponents(NamedTuple):
    """Where the search ended."""

    minimum: Minimum
    """Its cost is Löw's alone."""
    pull: Pull | None
    """What pulled in the end; None where the cost alone decided."""


def local_slopes(dataset: Dataset, points: BoolArray, conductor: Conductor) -> LocalSlopes | None:
    """The slope of every spectrum beside the Fresnel reflectance that the model gives its direction.

    A spectrum is a F (1 + m x) there, linear in a and a m, and weighted by the noise of its counts. The exponent of
    Eq. 2 has no place in Eq. 7, where F is that of the half vector. None where fewer than twelve of them
    stand above the noise. Raises `OutOfRange` for wavelengths beyond the conductor's table.
    """
    used = above_noise(dataset) & points
    if np.count_nonzero(used) < _LEAST_SLOPES:
        return None
    directions = in_plane(dataset.theta_in[used], dataset.theta_out[used])
    u = dataset.u_counts[used]
    valid = np.isfinite(dataset.brdf[used]) & (u > 0)
    weight = np.where(valid, 1 / np.where(valid, u, 1.0) ** 2, 0.0)
    first = fresnel_conductor(directions.cos_d[:, None], *conductor.index(dataset.wavelengths))
    second = first * (dataset.wavelengths - LAMBDA_N) * 1e-3
    columns = np.stack([first, second], axis=1)
    # [spectra, 2, wavelengths] derivative of a and a m by the data
    estimator = np.linalg.solve((columns * weight[:, None]) @ columns.transpose(0, 2, 1), columns * weight[:, None])
    level, tilt = (estimator @ np.where(valid, dataset.brdf[used], 0.0)[:, :, None])[:, :, 0].T
    slope = tilt / level
    gain = (estimator[:, 1] - slope[:, None] * estimator[:, 0]) / level[:, None]
    everywhere = np.zeros(dataset.brdf.shape)
    everywhere[used] = gain
    variance = variance_of_each_point(everywhere, dataset.sources)[used]
    return LocalSlopes(slope, 1 / np.sqrt(variance), directions, used, gain)


def find_two_components(form: Form, data: LoewData, seen: View, cosine: FloatArray, engine: Engine) -> TwoComponents:
    """Search from the local slopes, and from the `cosine`'s parameters where there are too few or they mislead.

    `form` is that of a metal with two components, and `seen` what it needs to know.
    """
    posed = problem(seen, data)
    of_cosine = minimise(
        problem(replace(seen, form=replace(form, shift="cosine")), data), to_search(cosine), _all(cosine), engine
    )
    # without sharpness and kappa it is the cosine
    contained = np.concatenate([of_cosine.parameters, np.zeros(len(form.quantities) - cosine.size)])
    slopes = local_slopes(data.dataset, data.points, _metal(form))
    if slopes is not None:
        shift, chi2 = search_slopes(
            "global-two-component", slopes.values, slopes.root_weight**2, slopes.directions, "fast"
        )
        start = np.concatenate([of_cosine.parameters[: form.first_of_shift], shift])
        found = _weighed(posed, form, Pull(slopes, _loew(posed, start) / chi2), start, engine)
        ours, cosines = (
            end.cost * found.pull.chi_square(form, at)
            for end, at in ((found.minimum, found.minimum.parameters), (of_cosine, contained))
        )
        if ours <= cosines:
            return TwoComponents(found.minimum, found.pull)
    return TwoComponents(minimise(posed, contained, _all(contained), engine), None)


def _weighed(posed: SumOfSquares, form: Form, pull: Pull, start: FloatArray, engine: Engine) -> PulledEnd:
    """Descend until the strength of the pull is the ratio of what cost and slopes leave."""
    found = _pulled(posed, form, pull, start, engine)
    for _ in range(_ROUNDS):
        strength = found.minimum.cost / pull.chi_square(form, found.minimum.parameters)
        if strength >= (1 - _SETTLED) * pull.strength:
            break
        pull = pull._replace(strength=strength)
        found = _pulled(posed, form, pull, found.minimum.parameters, engine)
    return found


def _pulled(posed: SumOfSquares, form: Form, pull: Pull, start: FloatArray, engine: Engine) -> PulledEnd:
    end = minimise(_with_pull(posed, form, pull), start, _all(start), engine)
    return PulledEnd(replace(end, cost=_loew(posed, end.parameters)), pull)


def _metal(form: Form) -> Conductor:
    if form.conductor is None:
        raise FitError("Slopes of the spectra say little of a dielectric, whose diffuse light has a colour of its own.")
    return form.conductor


def _all(parameters: FloatArray) -> BoolArray:
    return np.ones(parameters.size, dtype=bool)


def _loew(posed: SumOfSquares, parameters: FloatArray) -> float:
    residual = posed.residual(parameters)
    return float(residual @ residual)


def _with_pull(posed: SumOfSquares, form: Form, pull: Pull) -> SumOfSquares:
    """The cost and what the slopes add to it; parameters as `to_search` gives them."""

    def residual(parameters: FloatArray) -> FloatArray:
        return np.concatenate([posed.residual(parameters), pull.rows(form, parameters)[0]])

    def linearised(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        of_cost, of_slopes = posed.linearised(parameters), pull.rows(form, parameters)
        return np.concatenate([of_cost[0], of_slopes[0]]), np.concatenate([of_cost[1], of_slopes[1]], axis=1)

    return SumOfSquares(residual, linearised, posed.lower, posed.upper)
