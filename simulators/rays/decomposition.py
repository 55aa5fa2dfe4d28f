"""What a scan with rays is published as: shares of light by reflections, an energy balance, and how far all converged.

Errors of ratios are those of the jackknife over the windows of all patches (Efron, The Jackknife, 1982, chapter 3).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from simulators.errors import UnfitTopography
from simulators.rays.scan import RayScan
from simulators.topographies.heights import HeightField, every_second

BIN = 5.0
"""Width in theta_out over which directions are taken together where their light is decomposed, degrees."""

FEWEST = 10
"""Rays in such a bin below which its shares are not told."""

ASIDE = 15.0
"""From the mirror direction to a direction that flat facets do not shine into, degrees."""

CONVERGED = 0.01
"""Change below which a published figure counts as converged."""

_FIGURES = (
    ("light reflected, of what falls in", True),
    ("more than once, of what is reflected", True),
    ("more than once and back, of what is reflected", True),
    ("BRDF around the mirror direction, 1/sr", False),
    (f"BRDF around {ASIDE:g}° before it, 1/sr", False),
    ("more than once, around the mirror direction", True),
    (f"more than once, around {ASIDE:g}° before it", True),
    ("more than once, around the lamp", True),
)
"""Published figures whose convergence is told, and whether each is a share."""

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Shares:
    """Make-up of the light in each direction by the number of reflections (Fig. 11)."""

    theta_out: FloatArray
    """[bins] middle of each bin, degrees."""
    share: FloatArray
    """[incident, bins, orders] of the light there; NaN where fewer than `FEWEST` rays arrived."""
    u_share: FloatArray
    """[incident, bins, orders] standard error; n rays alike make no share surer than 1 / (n + 2)."""


@dataclass(frozen=True)
class Halves:
    """Where the light goes that was reflected once, and more often: shares of all that leaves the surface."""

    share: FloatArray
    """[incident, (once, more often), (back, forward)] of the hemisphere's two halves."""
    u_share: FloatArray
    """The same of standard errors."""


@dataclass(frozen=True)
class Change:
    """One published figure, and by how much it changes where more is computed."""

    figure: str
    """What it is."""
    theta_in: float
    """Degrees."""
    is_share: bool
    """Whether it is a share of light, whose change is told as it is; of others it is told as a part of the value."""
    value: float
    u: float
    """Standard error."""
    rays: float
    """Change when the number of rays is doubled to what it is; see `is_share`."""
    area: float
    """Likewise when the area of the surface is doubled."""
    pitch: float
    """Likewise when the pitch is halved, the rays being the same."""
    u_pitch: float
    """Standard error of `pitch`, which has the errors of the two scans in common."""

    @property
    def largest(self) -> float:
        """The largest of the changes, without its sign."""
        return max(abs(self.rays), abs(self.area), abs(self.pitch))


def shares(scan: RayScan) -> Shares:
    """Fig. 11 of a scan, at the wavelength of its decomposition."""
    number = np.round(scan.asked.theta_out / BIN).astype(int)
    bins = np.unique(number)
    member = (number == bins[:, None]) * np.cos(np.radians(scan.asked.theta_out))
    energy = np.einsum("bo,phiok->pibk", member, scan.by_order) / scan.by_order.shape[1]

    def share(parts: Indices) -> FloatArray:
        mean = energy[parts].mean(axis=0)
        whole = mean.sum(axis=-1, keepdims=True)
        return np.asarray(np.divide(mean, whole, out=np.zeros_like(mean), where=whole > 0))

    value, u = jackknife(share, len(energy))
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(scan.asked.aperture / 2)))
    rays = energy.mean(axis=0).sum(axis=-1, keepdims=True) * solid_angle * scan.traced
    told = rays >= FEWEST
    u = np.hypot(u, 1 / (rays + 2))
    return Shares(bins * BIN, np.where(told, value, np.nan), np.where(told, u, np.nan))


def halves(scan: RayScan) -> Halves:
    """Single and multiple reflections forward and back over the whole hemisphere, at that wavelength."""
    light = scan.light[..., scan.asked.decomposed_at].mean(axis=1)

    def share(parts: Indices) -> FloatArray:
        mean = light[parts].mean(axis=0)
        split = np.stack([mean[:, 0], mean[:, 1:].sum(axis=1)], axis=1)
        return np.asarray(split / split.sum(axis=(1, 2), keepdims=True))

    return Halves(*jackknife(share, len(light)))


def coarser(field: HeightField) -> HeightField:
    """Every second point of every second row.

    Raises `UnfitTopography` for a periodic patch that would no longer close, or for one with too few points.
    """
    if field.periodic and any(count % 2 for count in field.heights_um.shape):
        raise UnfitTopography(
            f"Whether the pitch is fine enough is told by every second point, but a periodic patch of "
            f"{field.heights_um.shape[1]} x {field.heights_um.shape[0]} points has no such half; make its sides even."
        )
    return every_second(field)


def convergence(scan: RayScan, coarse: RayScan) -> tuple[Change, ...]:
    """How the published figures of the incident angles of `coarse` change.

    `coarse` is a scan of the same surfaces with every second point (`coarser`) and the same rays, at some of the
    incident angles.
    """
    angles = coarse.asked.theta_in
    figures = [(*figure, float(angle)) for figure in _FIGURES for angle in angles]
    is_share = np.array([share for _, share, _ in figures])
    fine, less_fine = (_light_and_directions(each, angles) for each in (scan, coarse))

    def changes(parts: Indices) -> FloatArray:
        value, before = (_published(each, parts, slice(None)) for each in (fine, less_fine))
        fewer = _published(fine, parts, slice(1))
        smaller = _published(fine, parts[: len(parts) // 2], slice(None))
        scale = np.where(is_share, 1.0, value)
        scale = np.where(scale > 0, scale, np.nan)
        return np.stack([value, *((value - other) / scale for other in (fewer, smaller, before))])

    found, u = jackknife(changes, len(scan.by_order))
    return tuple(
        Change(name, angle, share, *map(float, (found[0, i], u[0, i], *found[1:, i], u[3, i])))
        for i, (name, share, angle) in enumerate(figures)
        if np.isfinite(found[:, i]).all()
    )


def jackknife(statistic: Callable[[Indices], FloatArray], parts: int) -> tuple[FloatArray, FloatArray]:
    """`statistic` of the numbers of all parts, and its standard error from leaving out one part after the other."""
    every = np.arange(parts)
    without = np.stack([statistic(np.delete(every, part)) for part in every])
    return statistic(every), np.sqrt((parts - 1) * without.var(axis=0))


def _light_and_directions(scan: RayScan, theta_in: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What figures are made of, at these incident angles: [parts, halves, incident, orders, (back, forward)] light, and
    [parts, halves, (mirror, aside, lamp), incident, orders] BRDF around these directions, NaN beyond the scan."""
    asked = scan.asked
    places = np.flatnonzero(np.isin(asked.theta_in, theta_in))
    centre = np.stack([asked.theta_in[places], asked.theta_in[places] - ASIDE, -asked.theta_in[places]])
    within = np.abs(asked.theta_out - centre[..., None]) <= BIN / 2
    weight = within / np.maximum(within.sum(axis=-1, keepdims=True), 1)
    brdf = np.einsum("nio,phiok->phnik", weight, scan.by_order[:, :, places])
    brdf[:, :, ~within.any(axis=-1)] = np.nan
    return scan.light[..., asked.decomposed_at][:, :, places], brdf


def _published(of: tuple[FloatArray, FloatArray], parts: Indices, half: slice) -> FloatArray:
    """[figures x incident] in the order of `_FIGURES`, from some parts and halves of `_light_and_directions`."""
    light, brdf = (each[parts][:, half].mean(axis=(0, 1)) for each in of)
    whole, once = light.sum(axis=(1, 2)), light[:, 0].sum(axis=1)
    total = brdf.sum(axis=-1)
    more = np.divide(brdf[..., 1:].sum(axis=-1), total, out=np.full_like(total, np.nan), where=total > 0)
    back = light[:, 1:, 0].sum(axis=1)
    return np.concatenate([whole, 1 - once / whole, back / whole, total[0], total[1], more[0], more[1], more[2]])
