"""Whether the parameters of a fitted lobe are identified by the measurement, in sentences."""

import math
from dataclasses import dataclass

import numpy as np

from analysis.noise import above_noise, flag_sentences
from analysis.results import Verdict
from drivers.arrays import BoolArray
from goniometer.dataset import Dataset

LEAST_SHARE_ABOVE_NOISE = 0.25
"""Share of points that must stand above the noise for a fit to be trusted."""

LARGEST_RELATIVE_ERROR = 0.1
"""Relative standard error beyond which alpha counts as undetermined."""

LARGEST_RESIDUAL_RATIO = 2.0
"""Residuals may be as many times their combined standard uncertainty before the standard errors are inflated.

Not one: where an error that all residuals share is the largest, their ratio is the size of one normal number, which
is beyond two once in 22 times.
"""


@dataclass(frozen=True)
class Evidence:
    """What a fit of Cook-Torrance, with or without shift, knows of itself."""

    dataset: Dataset
    fitted: BoolArray
    """[points] which points were fitted."""
    alpha: float
    u_alpha: float
    u_alpha_from_angles: float
    """The part of `u_alpha` that the angles make: errors of the positions and of the zeros of the stages."""
    residual_ratio: float
    """Root mean square of residual over its combined standard uncertainty, systematic errors included."""
    scanned_alphas: tuple[float, float]
    """Smallest and largest alpha that was scanned for a start."""
    h: float | None
    """1/um; None for a model without shift."""
    u_h: float
    shift_determined: bool
    """False where w had to be fixed."""


def lobe_width(alpha: float) -> float:
    """Full width at half maximum of the GGX distribution of normals, as seen in theta_out, degrees.

    D = alpha^2 / (pi (cos^2 (alpha^2 - 1) + 1)^2) falls to one half where cos^2 = (1 - sqrt(2) alpha^2) / (1 - alpha^2)
    (Walter et al. 2007, Eq. 33), and theta_m changes half as fast as theta_out. 360 where D never falls that far.
    """
    squared = alpha**2
    if squared >= math.sqrt(0.5):
        return 360.0
    return 4 * math.degrees(math.acos(math.sqrt((1 - math.sqrt(2) * squared) / (1 - squared))))


def judge(evidence: Evidence) -> Verdict:
    """The verdict on a fit: what speaks against it first, then what a reader should know besides."""
    against = [*_against_alpha(evidence), *_against_shift(evidence)]
    return Verdict(not against, (*against, *_notes(evidence)))


def _against_alpha(evidence: Evidence) -> list[str]:
    dataset, reasons = evidence.dataset, []
    width = lobe_width(evidence.alpha)
    if width < dataset.aperture:
        share = (evidence.u_alpha_from_angles / evidence.u_alpha) ** 2 if math.isfinite(evidence.u_alpha) else 0.0
        reasons.append(
            f"The lobe is {width:.2g} deg wide and the aperture {dataset.aperture:.2g} deg, so what was measured is "
            f"mostly the aperture; {share:.0%} of the variance of alpha comes from the stages: standard uncertainties "
            f"of {dataset.u_angle:.2g} deg of a position and {dataset.u_zero:.2g} deg of a zero."
        )
    if evidence.u_alpha > LARGEST_RELATIVE_ERROR * evidence.alpha:
        reasons.append(
            f"alpha is known to {evidence.u_alpha / evidence.alpha:.1%} only; {LARGEST_RELATIVE_ERROR:.0%} would do."
        )
    low, high = evidence.scanned_alphas
    if not low < evidence.alpha < high:
        reasons.append(f"alpha = {evidence.alpha:.3g} lies outside the range {low:g} to {high:g} of surfaces known.")
    bright = int(np.count_nonzero(above_noise(dataset) & evidence.fitted))
    count = int(evidence.fitted.sum())
    if bright < LEAST_SHARE_ABOVE_NOISE * count:
        reasons.append(
            f"Only {bright} of {count} points stand above the noise; {LEAST_SHARE_ABOVE_NOISE:.0%} would do."
        )
    return reasons


def _against_shift(evidence: Evidence) -> list[str]:
    if evidence.h is None or evidence.shift_determined:
        return []
    if abs(evidence.h) <= 3 * evidence.u_h:
        return [
            f"h = {evidence.h:.2g} ± {evidence.u_h:.1g} 1/um is compatible with zero, so there is no shift for w to "
            "describe; w was fixed at 0."
        ]
    return ["The slope does not change measurably with theta_m, so w was fixed at 0 and h is a constant slope."]


def _notes(evidence: Evidence) -> list[str]:
    notes = list(flag_sentences(evidence.dataset))
    if evidence.residual_ratio > LARGEST_RESIDUAL_RATIO:
        notes.append(
            f"The residuals are {evidence.residual_ratio:.3g} times the combined standard uncertainty of the "
            "measurement, systematic errors included: the model does not describe everything. The standard errors are "
            "inflated by this factor (Birge ratio)."
        )
    return notes
