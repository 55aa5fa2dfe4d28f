"""Where a fit of a microfacet model starts, so that no lobe and no shift is missed.

Going downhill alone misses narrow lobes and fast shifts. So alpha (and eta of a dielectric) is scanned without shift,
then w at every minimum found there, with h solved for: all at a few wavelengths, where a scan costs little. Every
minimum of the scans is followed downhill at those wavelengths, and so is the cosine of a metal's local slopes where
lambda_n was not measured; the distinct ends are the starts.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.fits.brdf_problem import from_search, linearise, problem, to_search, weighted_residual
from analysis.fits.brdf_two_component import local_slopes
from analysis.fits.global_fit import search_slopes
from analysis.fits.least_squares import minimise
from analysis.fits.loew import LoewData
from analysis.reflectance.directions import in_plane, round_aperture
from analysis.reflectance.fresnel import fresnel_dielectric
from analysis.reflectance.microfacet import LARGEST_W, Form, View, aperture_for, regressed_albedo, view
from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import BoolArray, FloatArray

SCANNED_ALPHAS = np.geomspace(0.002, 1.0, 32)
"""Roughnesses at which a fit looks for its start."""

_ETAS = np.array([1.1, 1.2, 1.35, 1.5, 1.75, 2.2, 3.0])
_WS = np.arange(0.25, LARGEST_W, 0.25)
_WAVELENGTHS = 8
_FOLLOWED = 3
"""Minima of a scan that are followed downhill."""

_WORSE = 2.0
"""Cost over the lowest beyond which a lobe is not given a shift, which does not make up for a wrong lobe."""

_WITHIN_NOISE = 9.21
"""Chi-square with two degrees of freedom that is exceeded once in a hundred times."""


@dataclass(frozen=True)
class Starts:
    """Where to start, the best first."""

    parameters: tuple[FloatArray, ...]
    """Each [parameters]; all but the first are other minima that are as good within the noise, a residual of each
    point counting as one."""
    view: View
    """Of all wavelengths, with an aperture as fine as the first start's lobe needs."""


def find_starts(form: Form, data: LoewData) -> Starts:
    """Scan for the minima of the cost; see above."""
    coarse = _some_wavelengths(data)
    if form.shift == "two-component":
        return _two_component_starts(form, data)
    plain = replace(form, shift="none")
    seen = _view(plain, coarse, None)
    # a few nodes of the aperture are enough to tell one valley from another
    rule = round_aperture(data.dataset.aperture, rings=2, spokes=6)
    glimpse = view(plain, coarse.theta_in, coarse.theta_out, coarse.dataset.wavelengths, rule)
    found = [_descend(seen, coarse, start) for start in _scan_lobe(plain, glimpse, coarse)]
    if form.shift == "cosine":
        lowest = min(cost for _, cost in found)
        lobes = [start for start, cost in found if cost <= _WORSE * lowest]
        found = [end for lobe in lobes for end in _follow_w(form, coarse, lobe)]
        if not data.dataset.wavelengths[0] <= LAMBDA_N <= data.dataset.wavelengths[-1]:
            found += [end for lobe in lobes for end in _follow_slopes(form, data, coarse, lobe)]
    return _starts(form, data, coarse, found)


def _two_component_starts(form: Form, data: LoewData) -> Starts:
    """From the best cosine, and from the slopes that would lower the cost most, were they free at every point."""
    coarse = _some_wavelengths(data)
    cosine = replace(form, shift="cosine")
    best = find_starts(cosine, data).parameters[0]
    lobe = best[: form.first_of_shift]
    near = linearise(_view(cosine, coarse, best), coarse, np.concatenate([lobe, [0.0, 0.0]]))
    by_slope = near.full_jacobian[form.first_of_shift]  # by h where w = 0 and the cosine one
    size, pull = np.sum(by_slope**2, axis=1), np.sum(by_slope * near.residual, axis=1)
    centre = in_plane(coarse.theta_in, coarse.theta_out)
    wanted = -pull / np.where(size > 0, size, 1.0)
    shift, _ = search_slopes("global-two-component", wanted, size, centre, "fast")
    seen = _view(form, coarse, best)
    # without kappa and sharpness it is the cosine
    ends = [_descend(seen, coarse, start) for start in (np.concatenate([best, np.zeros(4)]), np.append(lobe, shift))]
    # a cosine within reach of chance is the simplest of all that are as good
    chance = 1 + _WITHIN_NOISE / np.count_nonzero(coarse.valid)
    if ends[0][1] <= chance * ends[1][1]:
        ends = ends[:1]
    return _starts(form, data, coarse, ends)


def _some_wavelengths(data: LoewData) -> LoewData:
    """The same at a few wavelengths."""
    step = max(1, data.dataset.wavelengths.size // _WAVELENGTHS)
    some = slice(step // 2, None, step)
    return replace(
        data,
        dataset=data.dataset.at_wavelengths(some),
        log_measured=data.log_measured[:, some],
        root_weight=data.root_weight[:, some],
        log_derivative=data.log_derivative[:, some],
    )


def _view(form: Form, data: LoewData, parameters: FloatArray | None) -> View:
    """Through an aperture rule as fine as the lobe of `parameters` needs, or the default one."""
    dataset = data.dataset
    wide = 1.0 if parameters is None else float(parameters[0])
    return view(form, data.theta_in, data.theta_out, dataset.wavelengths, aperture_for(wide, dataset.aperture))


def _scan_lobe(form: Form, seen: View, data: LoewData) -> list[FloatArray]:
    """Minima over alpha, and eta of a dielectric, without shift."""
    if form.conductor is not None:
        costs = np.array([[_cost(seen, data, np.array([alpha]))] for alpha in SCANNED_ALPHAS])
        return [SCANNED_ALPHAS[[i]] for i, _ in _minima(costs)]
    costs = np.empty((SCANNED_ALPHAS.size, _ETAS.size))
    reflectances = [fresnel_dielectric(seen.cos_d, eta) for eta in _ETAS]
    for i, alpha in enumerate(SCANNED_ALPHAS):
        lobe = seen.surface(np.array([alpha, _ETAS[0]])) / reflectances[0]
        costs[i] = [_cost_of_dielectric(lobe * reflectance, seen, data) for reflectance in reflectances]
    return [np.array([SCANNED_ALPHAS[i], _ETAS[j]]) for i, j in _minima(costs)]


def _cost_of_dielectric(surface: FloatArray, seen: View, data: LoewData) -> float:
    """Of a surface with the albedo of a linear regression, which is close enough to find a start."""
    albedo = regressed_albedo(surface, seen.cos_in, data.log_measured, data.root_weight)
    value = np.log1p(surface + seen.cos_in / math.pi * albedo)
    return float(np.sum((data.root_weight * (value - data.log_measured)) ** 2))


def _cost(seen: View, data: LoewData, parameters: FloatArray) -> float:
    residual, _ = weighted_residual(seen, data, parameters)
    return float(np.sum(residual**2))


def _minima(costs: FloatArray) -> list[tuple[int, int]]:
    """Indices of the lowest local minima of costs [first, second], the lowest first."""
    padded = np.pad(costs, 1, constant_values=math.inf)
    around = [padded[1 + i : padded.shape[0] - 1 + i, 1 + j : padded.shape[1] - 1 + j]
              for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]  # fmt: skip
    lowest = np.argwhere(np.all([costs <= other for other in around], axis=0))
    order = np.argsort([costs[i, j] for i, j in lowest], kind="stable")
    return [(int(i), int(j)) for i, j in lowest[order][:_FOLLOWED]]


def _follow_w(form: Form, data: LoewData, start: FloatArray) -> list[tuple[FloatArray, float]]:
    """Descend in all parameters from the minima over w, h solved for, of a lobe that was found without shift.

    The lobe is seen through an aperture as fine as it needs: else its misfit is larger than the whole shift.
    """
    seen = _view(form, data, start)
    here = np.concatenate([start, [0.0, 0.0]])
    near = linearise(seen, data, here)
    # with h = 0 the derivative by h at any w is that at w = 0 times the cosine at the centre of the aperture
    by_h = near.full_jacobian[form.first_of_shift]
    cosines = np.cos(_WS[:, None] * np.radians(0.5 * np.abs(data.theta_out - data.theta_in)))
    with_residual = cosines @ np.sum(by_h * near.residual, axis=1)
    size = cosines**2 @ np.sum(by_h**2, axis=1)
    if form.conductor is None:
        # what the albedo makes up for at every wavelength is no merit of h
        albedo_size = np.sum(near.by_albedo**2, axis=0)
        overlap = cosines @ (by_h * near.by_albedo)
        size = size - np.sum(overlap**2 / np.where(albedo_size > 0, albedo_size, 1.0), axis=1)
    usable = size > 0
    h = np.where(usable, -with_residual / np.where(usable, size, 1.0), 0.0)
    gained = np.where(usable, with_residual**2 / np.where(usable, size, 1.0), 0.0)
    return [
        _descend(seen, data, np.concatenate([start, [h[i] if h[i] != 0 else 1e-3, _WS[i]]]))
        for i, _ in _minima(-gained[:, None])
    ]


def _follow_slopes(form: Form, data: LoewData, coarse: LoewData, lobe: FloatArray) -> list[tuple[FloatArray, float]]:
    """Descend from the cosine of the slopes that a metal's spectra have by themselves; nothing where they have none.

    Where lambda_n lies beyond the measured wavelengths a shift changes the brightness of whole spectra; a lobe that
    was found without shift makes up for that, and h and w do not show in what it leaves.
    """
    slopes = None if form.conductor is None else local_slopes(data.dataset, data.points, form.conductor)
    if slopes is None:
        return []
    cosine, _ = search_slopes("global", slopes.values, slopes.root_weight**2, slopes.directions, "fast")
    return [_descend(_view(form, coarse, lobe), coarse, np.concatenate([lobe, cosine[:2]]))]


def _descend(seen: View, data: LoewData, start: FloatArray) -> tuple[FloatArray, float]:
    free: BoolArray = np.ones(start.size, dtype=bool)
    end = minimise(problem(seen, data), to_search(start), free, "fast")
    return from_search(end.parameters), end.cost


def _starts(form: Form, data: LoewData, coarse: LoewData, found: list[tuple[FloatArray, float]]) -> Starts:
    """The ends that are as good as the best within the noise, the best first, one of each minimum.

    Two ends are of one minimum where the cost midway between them is as good, too: a valley is not two minima.
    """
    ordered = sorted(found, key=lambda end: end[1])
    best, lowest = ordered[0]
    limit = lowest * (1 + _WITHIN_NOISE / max(coarse.theta_in.size - len(form.quantities), 1))
    seen = _view(form, coarse, best)
    kept = [best]
    for end, cost in ordered[1:]:
        midway = [from_search(0.5 * (to_search(end) + to_search(other))) for other in kept]
        if cost <= limit and all(_cost(seen, coarse, between) > limit for between in midway):
            kept.append(end)
    return Starts(tuple(kept), _view(form, data, best))
