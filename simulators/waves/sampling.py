"""How finely a topography must be known for its diffraction, and its refinement by splines.

A height map that is summed as points has a spectrum that repeats every 2 pi / pitch. A facet of slope t turns the
phase of the light by k_z t per length, so directions see a copy of the spectrum once |k_x| + k_z t exceeds that: light
that is not there, mostly in the dark directions, and the more of it the shorter the wavelength.
"""

from dataclasses import dataclass, replace
from math import ceil, pi

import numpy as np
import scipy

from drivers.arrays import FloatArray
from simulators.topographies.heights import HeightField, around, complete

STEEPER = 1e-4
"""Share of the area, the steepest, that does not count: slopes of single bad pixels would rule over all others."""


class CoarseSampling(UserWarning):
    """A topography is sampled too coarsely for its diffraction; what was computed holds light that is not there."""


@dataclass(frozen=True)
class Sampling:
    """Whether a topography is sampled finely enough for a set of directions and wavelengths."""

    pitch_um: float
    """Distance of neighbouring points, um."""
    needed_um: float
    """Largest pitch at which no facet but the steepest `STEEPER` of the area aliases, um."""
    aliasing: float
    """Share of the area that is so steep that it aliases in some direction at some wavelength; on a coarse grid even
    level ground does so towards grazing directions."""

    @property
    def sufficient(self) -> bool:
        """Whether the pitch is fine enough."""
        return self.pitch_um <= self.needed_um

    @property
    def times(self) -> int:
        """By how much to refine the topography, see `refined`."""
        return max(1, ceil(self.pitch_um / self.needed_um * (1 - 1e-12)))

    @property
    def message(self) -> str:
        """One sentence for the user."""
        if self.sufficient:
            return (
                f"The topography has a pitch of {self.pitch_um:.3g} um, and at most {self.needed_um:.3g} um is needed."
            )
        return (
            f"The topography has a pitch of {self.pitch_um:.3g} um, at which {100 * self.aliasing:.3g} % of its area "
            f"send light that is not there into some of these directions; at most {self.needed_um:.3g} um is needed: "
            f"refine it {self.times} times."
        )


def sampling(field: HeightField, kx: FloatArray, kz: FloatArray, s_um: float) -> Sampling:
    """Of `field` for scattering vectors (`kx`, `kz`), 1/um, of any one shape; `waves.scattering_vectors` gives them.

    The criterion is 2 pi / pitch > |k_x| + k_z t + 4 / s along the plane of incidence and 2 pi / pitch > k_z t + 4 / s
    across it: t is the slope that all but `STEEPER` of the area stay below, and a coherence window of width s = `s_um`
    spreads light by up to 4 / s. Raises `UnfitTopography` where heights are missing.
    """
    corner = around(field)
    along, across = (np.abs(np.diff(corner, axis=axis)) / field.pitch_um for axis in (1, 0))
    steep_along, steep_across = (float(np.quantile(slope, 1 - STEEPER)) for slope in (along, across))
    fastest = max(float((np.abs(kx) + kz * steep_along).max()), float(kz.max()) * steep_across) + 4 / s_um
    repeat = 2 * pi / field.pitch_um - 4 / s_um
    limit_along = float(((repeat - np.abs(kx)) / kz).min())
    limit_across = repeat / float(kz.max())
    too_steep = (along > limit_along)[: across.shape[0]] | (across > limit_across)[:, : along.shape[1]]
    return Sampling(field.pitch_um, 2 * pi / fastest, float(too_steep.mean()))


def refined(field: HeightField, times: int) -> HeightField:
    """`field` at a pitch `times` smaller, between its points a cubic spline along x and along y.

    A periodic field stays periodic; another keeps its first and last points, [(ny - 1) times + 1, (nx - 1) times + 1].
    Raises `UnfitTopography` where heights are missing.
    """
    heights = complete(field)
    if times == 1:
        return field
    for axis in (0, 1):
        heights = _refined_along(heights, axis, times, field.periodic)
    return replace(field, heights_um=heights, pitch_um=field.pitch_um / times)


def _refined_along(heights: FloatArray, axis: int, times: int, periodic: bool) -> FloatArray:
    """`heights` with `times` as many points along `axis`."""
    count = heights.shape[axis]
    if periodic:
        first = np.take(heights, [0], axis=axis)
        closed = np.concatenate([heights, first], axis=axis)
        spline = scipy.interpolate.CubicSpline(np.arange(count + 1), closed, axis=axis, bc_type="periodic")
        return np.asarray(spline(np.arange(count * times) / times))
    spline = scipy.interpolate.CubicSpline(np.arange(count), heights, axis=axis)
    return np.asarray(spline(np.arange((count - 1) * times + 1) / times))
