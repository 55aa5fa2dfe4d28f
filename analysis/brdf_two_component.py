"""How a two-component shift of a metal is found: by the slopes of the spectra as much as by the cost of the whole.

Nearly all of Löw's cost on a real surface is brightness that the lobe does not have right, a number for every
direction that has nothing to do with colour. Left alone with it, six parameters of a slope buy brightness: where the
wavelengths do not lie evenly about lambda_n a slope brightens the whole spectrum. The fit then costs less and has the
wrong colours. What tells the slopes is the shape of every spectrum, whatever its brightness; that is what the local fit
reads (`analysis.local_fit`). So both are minimised together, Löw's cost and the chi-square of the local slopes, each in
units of what it leaves: two sets of as many directions whose variances nobody knows (variance components; the product
of both sums is then the likelihood). Where the lobe is right, little is left of the cost, and it decides by itself.

In its own cost, Löw's, the result is never worse than the cosine that it contains: the pull of the slopes is relaxed
until that is so.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.brdf_errors import Pulled
from analysis.brdf_problem import problem, to_search
from analysis.directions import Directions, in_plane
from analysis.errors import FitError
from analysis.fresnel import Conductor
from analysis.global_fit import search_slopes
from analysis.least_squares import Engine, Minimum, SumOfSquares, minimise
from analysis.local_fit import local_fit, local_gain
from analysis.loew import LoewData
from analysis.microfacet import Form, View, slope_derivative
from drivers.arrays import BoolArray, FloatArray

_LEAST_SLOPES = 12
"""Reliable slopes that say more of six parameters than the cost does; with fewer the cost is asked alone."""

_ROUNDS = 12
_LOOSENING, _LOOSENED, _HALVINGS = 32.0, 5, 3
"""By how much a pull is loosened at a time, how often, and how often the interval is then halved."""

_SETTLED = 0.1
"""Relative change of the strength below which another round changes nothing."""


@dataclass(frozen=True)
class LocalSlopes:
    """The reliable slopes of the local fit."""

    values: FloatArray
    """[slopes] 1/um."""
    root_weight: FloatArray
    """[slopes] one over the standard uncertainty, by all errors."""
    directions: Directions
    """[slopes] at the centre of the aperture."""
    row: NDArray[np.intp]
    """[slopes] at which of the fitted points."""
    gain: FloatArray
    """[slopes, wavelengths] derivative of a slope by ln(1 + cos(theta_in) f) of its point."""


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

    def linearised(self, form: Form, parameters: FloatArray) -> Pulled:
        """What the standard errors of the parameters need to know of the slopes."""
        root = np.sqrt(self.strength) * self.slopes.root_weight
        return Pulled(self.rows(form, parameters)[1], self.slopes.row, root[:, None] * self.slopes.gain)

    def scatter(self, form: Form, parameters: FloatArray) -> float:
        """By how much more than their uncertainty the slopes scatter (Birge ratio), at least one."""
        freedom = self.slopes.values.size - (parameters.size - form.first_of_shift)
        return float(np.sqrt(max(self.chi_square(form, parameters) / freedom, 1.0)))

    def chi_square(self, form: Form, parameters: FloatArray) -> float:
        """Of the slopes, whatever their strength."""
        return float(np.sum(self._replace(strength=1.0).rows(form, parameters)[0] ** 2))


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


def local_slopes(data: LoewData, conductor: Conductor) -> LocalSlopes | None:
    """The slopes of the fitted points, None where too few are reliable."""
    local = local_fit(data.dataset, conductor)
    used = local.reliable & data.points
    if np.count_nonzero(used) < _LEAST_SLOPES:
        return None
    row = np.flatnonzero(used[data.points])
    of_slope = local_gain(data.dataset, local, conductor)[0, used]
    return LocalSlopes(
        values=local.slope[used],
        root_weight=1 / local.u_slope[used],
        directions=in_plane(data.theta_in[row], data.theta_out[row]),
        row=row,
        gain=of_slope / data.log_derivative[row],
    )


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
    slopes = local_slopes(data, _metal(form))
    if slopes is not None:
        shift, chi2 = search_slopes(
            "global-two-component", slopes.values, slopes.root_weight**2, slopes.directions, "fast"
        )
        start = np.concatenate([of_cosine.parameters[: form.first_of_shift], shift])
        found = _weighed(posed, form, Pull(slopes, _loew(posed, start) / chi2), start, engine)
        if found.minimum.cost > of_cosine.cost:
            found = _relaxed(posed, form, found, of_cosine.cost, engine)
        if found.minimum.cost <= of_cosine.cost:
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


def _relaxed(posed: SumOfSquares, form: Form, tight: PulledEnd, limit: float, engine: Engine) -> PulledEnd:
    """The strongest pull, within half of it, with which the cost stays below `limit`; the weakest tried where none."""
    loose = tight
    for _ in range(_LOOSENED):
        weaker = tight.pull._replace(strength=tight.pull.strength / _LOOSENING)
        loose = _pulled(posed, form, weaker, tight.minimum.parameters, engine)
        if loose.minimum.cost <= limit:
            break
        tight = loose
    for _ in range(_HALVINGS):
        between = tight.pull._replace(strength=float(np.sqrt(tight.pull.strength * loose.pull.strength)))
        middle = _pulled(posed, form, between, tight.minimum.parameters, engine)
        tight, loose = (tight, middle) if middle.minimum.cost <= limit else (middle, loose)
    return loose


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
