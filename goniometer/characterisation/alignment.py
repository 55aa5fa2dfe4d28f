"""Zero errors of both stages, from mirror peaks and from the edges of the sector where the detector blocks the source.

A zero error is the true angle minus the one that the stage reads, z_s for the sample and z_d for the detector. A mirror
sends its peak to the true detector angle 2 s, so that the detector reads

    d_peak = 2 (s_read + z_s) - z_d + lean tan(theta_in)

there: a mirror tells 2 z_s - z_d and no more. The lean is that of the peak: BRDF times cos(theta_out) is even about the
mirror direction, so the BRDF is not, by an amount that grows as the slope of 1 / cos(theta_out). The blocked sector is
even about the source axis, so the middle of its edges is where the detector reads -z_d, whatever is mounted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import FloatArray
from goniometer.characterisation.meter import Series
from goniometer.characterisation.peaks import centre_and_width, edge, propagated, u_edge

_LARGE = 2.0
"""Normalised departures beyond which measurements contradict what is stated of the stages."""


@dataclass(frozen=True)
class Sweep:
    """The detector stage swept over a mirror peak or an edge of the blocked sector; the signal is that of all bands."""

    kind: Literal["mirror", "lower edge", "upper edge"]
    sample: float
    """Angle that the sample stage reads, degrees."""
    detector: FloatArray
    """[points] angle that the detector stage reads, ascending, degrees."""
    signal: FloatArray
    """[points] counts per second."""
    u_signal: FloatArray
    """[points] standard uncertainty of `signal` by noise, counts per second."""
    place: float
    """Reading of the detector stage at the peak's middle or at the edge, degrees."""
    u_place: float
    """Standard uncertainty of `place` by noise and by how well the detector stage repeats, degrees."""


@dataclass(frozen=True)
class Alignment:
    """True angle minus read angle of both stages, degrees."""

    sample_zero: float
    u_sample_zero: float
    """Standard uncertainty."""
    detector_zero: float
    u_detector_zero: float
    """Standard uncertainty."""
    correlation: float
    """Of the errors of both zeros."""
    lean: float
    """By how much the mirror's peak leans at tan(theta_in) = 1, degrees."""
    chi_square: float
    """Sum of squared normalised residuals of all sweeps."""
    degrees_of_freedom: int
    sweeps: tuple[Sweep, ...]

    @property
    def consistent(self) -> bool:
        """Whether the sweeps agree as well as the stated repeatability of the stages says."""
        spread = np.sqrt(2 * self.degrees_of_freedom)
        return bool(self.chi_square <= self.degrees_of_freedom + _LARGE * spread)


def mirror_sweep(measured: Series, u_angle: float) -> Sweep:
    """A sweep over the mirror direction; raises `CharacterisationError` where it shows no whole peak."""
    order = np.argsort(measured.detector)
    x, y, u = measured.detector[order], measured.total[order], measured.u_total[order]
    place, _ = centre_and_width(x, y)
    u_place, _ = propagated(centre_and_width, x, y, u_angle, u)
    return Sweep("mirror", float(measured.sample.mean()), x, y, u, float(place), float(u_place))


def edge_sweep(measured: Series, u_angle: float) -> Sweep:
    """A sweep from outside the blocked sector to well within it, or the other way round."""
    order = np.argsort(measured.detector)
    x, y, u = measured.detector[order], measured.total[order], measured.u_total[order]
    upper = y[-1] > y[0]
    place = edge(x, y) if upper else -edge(-x[::-1], y[::-1])
    kind: Literal["lower edge", "upper edge"] = "upper edge" if upper else "lower edge"
    return Sweep(kind, float(measured.sample.mean()), x, y, u, place, u_edge(x, u_angle))


def evaluate_alignment(sweeps: Sequence[Sweep], u_angle: float) -> Alignment:
    """Both zeros by weighted least squares over mirror peaks (two or more) and pairs of edges (one or more).

    The sample stage rests during a sweep, so that its error of position, of standard uncertainty `u_angle`, counts
    twice in a peak and not at all in an edge. Sweeps over a lower and an upper edge come in pairs, in any order.
    """
    mirrors = [sweep for sweep in sweeps if sweep.kind == "mirror"]
    lower, upper = ([s for s in sweeps if s.kind == f"{side} edge"] for side in ("lower", "upper"))
    # unknowns: sample zero, detector zero, lean
    rows = [[2.0, -1.0, np.tan(np.radians(m.sample))] for m in mirrors]
    rows += [[0.0, -1.0, 0.0] for _ in lower]
    seen = [m.place - 2 * m.sample for m in mirrors]
    seen += [(a.place + b.place) / 2 for a, b in zip(lower, upper, strict=True)]
    u = [np.hypot(2 * u_angle, m.u_place) for m in mirrors]
    u += [np.hypot(a.u_place, b.u_place) / 2 for a, b in zip(lower, upper, strict=True)]
    design, values = np.array(rows) / np.array(u)[:, None], np.array(seen) / np.array(u)
    covariance = np.linalg.inv(design.T @ design)
    found = covariance @ design.T @ values
    errors = np.sqrt(np.diag(covariance))
    return Alignment(
        sample_zero=float(found[0]),
        u_sample_zero=float(errors[0]),
        detector_zero=float(found[1]),
        u_detector_zero=float(errors[1]),
        correlation=float(covariance[0, 1] / errors[0] / errors[1]),
        lean=float(found[2]),
        chi_square=float(np.sum((values - design @ found) ** 2)),
        degrees_of_freedom=len(values) - 3,
        sweeps=tuple(sweeps),
    )
