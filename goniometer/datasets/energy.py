"""Energy of a dataset: how much of the light that falls in at an angle comes out, which cannot be more than all.

The directional-hemispherical reflectance rho(theta_in) is the integral of f cos(theta_out) over the hemisphere, of
which only one slice is measured. On an isotropic surface of microfacets f is steep in the angle theta_h of the half
vector h and smooth in everything else, so the slice is carried out of the plane at constant theta_h. With
dω_out = 4 cos(theta_d) dω_h (Walter et al. 2007, Eq. 14) and psi the azimuth of h, 0 towards the mirror side,

    rho = integral of k cos(theta_out)^(1 - p) 4 cos(theta_d) sin(theta_h) dtheta_h dpsi
    k = (1 + cos psi) / 2 k(theta_in + 2 theta_h) + (1 - cos psi) / 2 k(theta_in - 2 theta_h),  k = f cos(theta_out)^p

with k interpolated in its logarithm along the slice. p = 0 is right for a Lambertian surface, where f is constant,
and p = 1 for a lobe of facets without shadowing, where f cos(theta_out) depends on theta_h alone. The estimate takes
p = 1/2, and what the two others differ by as the width of a rectangular distribution of its error. Where these happen
to agree, shadowing still differs out of the plane: a few per cent at large theta_in for GGX lobes of all widths.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.angular import SAME_PLANNED_INCIDENCE, incidence_groups
from goniometer.datasets.averages import Averages, averages, narrow
from goniometer.datasets.between import FEWEST
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled, fill
from goniometer.datasets.sector import is_hidden
from goniometer.geometry import BLOCKED_HALF_WIDTH

BAND = 25.0
"""Smallest width of the bands of wavelengths, nm."""

_SHADOWING = 0.05
"""Relative standard uncertainty for what shadowing does out of the plane, times sin(theta_in)^2."""

_BEYOND = 5.1
"""Degrees beyond the outermost measured direction over which f is taken as it is there: 85 to 90 degrees."""

_RINGS, _SPOKES = 300, 48
"""Nodes in theta_h, dense near 0, and in psi over half a turn."""

_BLOCKED = np.linspace(-BLOCKED_HALF_WIDTH, BLOCKED_HALF_WIDTH, 41)[1:-1]
"""theta_in + theta_out of the blocked directions that are filled, degrees."""

_NEIGHBOURS = 1000
"""Points, of the smallest incident angles, from which hidden lobes are filled: its time grows with their cube."""

_DARK = 1e-7
"""Part of the largest value of a slice that stands for values that are smaller or negative."""


class Energy(NamedTuple):
    """Directional-hemispherical reflectance."""

    theta_in: FloatArray
    """[angles] degrees, ascending."""
    wavelengths: FloatArray
    """[bands] centres, nm."""
    rho: FloatArray
    """[angles, bands]; NaN where no measured value of the slice is above zero, so that there is no light to sum."""
    u: FloatArray
    """[angles, bands] standard uncertainty from all sources, of interpolating, and of leaving the plane; NaN as rho."""


class _Slice(NamedTuple):
    """The hemisphere of one incident angle as a sum over directions of the slice."""

    theta_out: FloatArray
    """[nodes] degrees, the forward half and then the other one."""
    weights: FloatArray
    """[nodes, 3] what k is multiplied by for p = 0, 1/2 and 1."""


def energy(dataset: Dataset) -> Energy:
    """rho of every incident angle with three or more usable directions on its slice; there may be none.

    Where the slice ends early, only what was measured of it is summed, so rho is then a lower limit. The blocked
    directions are read between their edges. Where these hide the lobe, as at normal incidence, they are filled from the
    other incident angles (`goniometer.datasets.fill`), and their uncertainty, as of one error, is part of `u`; where
    too little is known to fill them, rho is a lower limit there, too.
    """
    weights = narrow(dataset.wavelengths, BAND)
    mean = averages(dataset, weights)
    filled = _hidden_lobes(dataset, mean, dataset.wavelengths @ weights)
    groups = incidence_groups(dataset.theta_in, SAME_PLANNED_INCIDENCE)
    usable = np.isfinite(mean.values).all(axis=1)
    found = []
    for group in range(int(groups.max(initial=-1)) + 1):
        members = np.flatnonzero((groups == group) & usable)
        members = members[np.argsort(dataset.theta_out[members])]
        apart = np.diff(dataset.theta_out[members], prepend=-np.inf) > 1e-3  # a direction that was measured twice
        members = members[apart]
        if members.size >= 3:
            theta_in = float(dataset.theta_in[members].mean())
            found.append((theta_in, *_reflectance(theta_in, _nodes(dataset, mean, members, filled), mean, members)))
    found.sort(key=lambda each: each[0])
    bands = weights.shape[1]
    return Energy(
        np.array([each[0] for each in found]),
        dataset.wavelengths @ weights,
        np.array([each[1] for each in found]).reshape(-1, bands),
        np.array([each[2] for each in found]).reshape(-1, bands),
    )


class _Nodes(NamedTuple):
    """What is known of one slice, in order of theta_out."""

    theta_out: FloatArray
    """[nodes] degrees."""
    f: FloatArray
    """[nodes, bands] 1/sr."""
    u: FloatArray
    """[nodes, bands] standard uncertainty of what was filled, 1/sr; zero for what was measured."""
    measured: BoolArray
    """[nodes]"""


def _hidden_lobes(dataset: Dataset, mean: Averages, bands: FloatArray) -> Filled | None:
    """The hidden directions of incident angles whose mirror direction is one of them; None where nothing fills any."""
    incident = np.unique(dataset.theta_in[2 * dataset.theta_in < BLOCKED_HALF_WIDTH].round(1))
    incident = incident[[is_hidden(dataset, angle) for angle in incident.tolist()]]
    known = np.isfinite(mean.values).all(axis=1)
    if not incident.size or np.count_nonzero(known) < FEWEST:
        return None
    near = np.flatnonzero(known)
    near = near[np.argsort(dataset.theta_in[near], kind="stable")][:_NEIGHBOURS]
    averaged = replace(
        dataset,
        theta_in=dataset.theta_in[near],
        theta_out=dataset.theta_out[near],
        wavelengths=bands,
        brdf=mean.values[near],
        sources=tuple(
            replace(s, values=s.values[near], groups=None if s.groups is None else s.groups[near]) for s in mean.sources
        ),
        flags=dataset.flags[near],
    )
    theta_in, s = (each.ravel() for each in np.meshgrid(incident, _BLOCKED, indexing="ij"))
    return fill(averaged, theta_in, s - theta_in)


def _nodes(dataset: Dataset, mean: Averages, members: NDArray[np.intp], filled: Filled | None) -> _Nodes:
    """The measured directions `members` of a slice, and those that are filled and known well enough."""
    theta_out, f = dataset.theta_out[members], mean.values[members]
    u, measured = np.zeros(f.shape), np.ones(members.size, dtype=bool)
    if filled is not None:
        mine = filled.tells & (np.abs(filled.theta_in - dataset.theta_in[members].mean()) < SAME_PLANNED_INCIDENCE)
        theta_out = np.append(theta_out, filled.theta_out[mine])
        f, u = np.vstack([f, filled.brdf[mine]]), np.vstack([u, filled.u[mine]])
        measured = np.append(measured, np.zeros(np.count_nonzero(mine), dtype=bool))
    order = np.argsort(theta_out, kind="stable")
    return _Nodes(theta_out[order], f[order], u[order], measured[order])


def _reflectance(
    theta_in: float, nodes: _Nodes, mean: Averages, members: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """rho and its standard uncertainty, each [bands], from the nodes of a slice; `members` are the measured ones.

    Both are NaN in a band of which no measured value is above zero.
    """
    theta_out = nodes.theta_out
    smallest = _DARK * nodes.f.max(axis=0)
    lit = (_DARK * nodes.f[nodes.measured].max(axis=0)) > 0
    f = np.where(lit, np.maximum(nodes.f, smallest), 1.0)  # a dark band has no logarithm; what comes of it is dropped
    slice_ = _slice(theta_in, float(theta_out[0]), float(theta_out[-1]))
    at = np.clip(slice_.theta_out, theta_out[0], theta_out[-1])
    right = np.clip(np.searchsorted(theta_out, at), 1, theta_out.size - 1)
    part = ((at - theta_out[right - 1]) / (theta_out[right] - theta_out[right - 1]))[:, None]
    cosines = np.cos(np.radians(theta_out))[:, None]
    rho = []
    for power, weights in zip((0.0, 0.5, 1.0), slice_.weights.T, strict=True):
        logarithm = np.log(f * cosines**power)
        smooth = weights @ np.exp(scipy.interpolate.PchipInterpolator(theta_out, logarithm)(at))
        straight = np.exp((1 - part) * logarithm[right - 1] + part * logarithm[right])
        rho.append(smooth)
        if power == 0.5:
            by_interpolation = np.abs(smooth - weights @ straight)
            # a relative change of f at a node of the straight interpolation changes k by its share there
            share = np.zeros(f.shape)
            np.add.at(share, right - 1, weights[:, None] * straight * (1 - part))
            np.add.at(share, right, weights[:, None] * straight * part)
    by_plane = np.hypot((rho[2] - rho[0]) / np.sqrt(12), _SHADOWING * np.sin(np.radians(theta_in)) ** 2 * rho[1])
    gain = share / f
    by_filling = np.sum(np.abs(gain) * nodes.u, axis=0)
    by_sources = np.sqrt(_by_sources(gain[nodes.measured], mean, members))
    # what is filled comes from the measured points and shares their errors, so both may add up
    u = np.sqrt((by_sources + by_filling) ** 2 + by_interpolation**2 + by_plane**2)
    return np.where(lit, rho[1], np.nan), np.where(lit, u, np.nan)


def _by_sources(gain: FloatArray, mean: Averages, members: NDArray[np.intp]) -> FloatArray:
    """[bands] variance of the sum of `gain` [members, bands] times f, from the dataset's sources.

    As `goniometer.uncertainty.variance`, for one sum a band.
    """
    found = np.zeros(gain.shape[1])
    for source in mean.sources:
        effect = gain * source.values[members]
        if source.groups is not None:
            groups = source.groups[members]
            effect = (np.unique(groups)[:, None] == groups).astype(float) @ effect
        found += np.sum(effect**2, axis=0)
    return found


def _slice(theta_in: float, lowest: float, highest: float) -> _Slice:
    """Directions of a slice that is measured from `lowest` to `highest` theta_out, degrees, and their weights."""
    edges = np.linspace(0, 1, _RINGS + 1)
    largest = np.radians(90 + theta_in) / 2
    x = 0.5 * (edges[1:] + edges[:-1])
    theta_h, step = largest * x**3, largest * 3 * x**2 / _RINGS
    psi = (np.arange(_SPOKES) + 0.5) / _SPOKES * np.pi
    tilt, turn = theta_h[:, None], np.cos(psi)
    incident = np.radians(theta_in)
    cos_d = np.cos(tilt) * np.cos(incident) - np.sin(tilt) * np.sin(incident) * turn
    cos_out = 2 * cos_d * np.cos(tilt) - np.cos(incident)
    above = (cos_out > 0) & (cos_d > 0)
    solid_angle = np.where(above, 4 * cos_d * np.sin(tilt) * step[:, None] * 2 * np.pi / _SPOKES, 0.0)
    forward, backward = theta_in + 2 * np.degrees(theta_h), theta_in - 2 * np.degrees(theta_h)
    # What one half of the slice does not show is taken from the other; the last degrees may lack in both.
    has_forward, has_backward = ((forward <= highest)[:, None], (backward >= lowest)[:, None])
    neither = ~(has_forward | has_backward)
    has_forward = has_forward | (neither & (forward <= min(highest + _BEYOND, 90))[:, None])
    has_backward = has_backward | (neither & (backward >= max(lowest - _BEYOND, -90))[:, None])
    share = np.where(has_forward & has_backward, 0.5 * (1 + turn), has_forward * 1.0)
    shares = np.concatenate([share, np.where(has_backward, 1 - share, 0.0)])
    cos_out, solid_angle = (np.tile(np.where(above, each, 0.0), (2, 1)) for each in (cos_out, solid_angle))
    weights = [np.sum(shares * solid_angle * cos_out**exponent, axis=1) for exponent in (1.0, 0.5, 0.0)]
    return _Slice(np.concatenate([forward, backward]), np.stack(weights, axis=1))
