"""Whether the parameters of a fitted microfacet model are identified by the measurement, in sentences."""

import math
from dataclasses import dataclass

import numpy as np

from analysis.choices import Distribution
from analysis.fits.noise import above_noise, flag_sentences
from analysis.fits.structure import Structure
from analysis.reflectance.distributions import lobe_width
from analysis.reflectance.microfacet import Quantity
from analysis.results import Verdict
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

LEAST_SHARE_ABOVE_NOISE = 0.25
"""Share of points that must stand above the noise for a fit to be trusted."""

LEAST_R2 = 0.5
"""Share of the variation of ln(1 + cos(theta_in) f) that a model must explain to be one of the sample at all."""

LARGEST_RESIDUAL_RATIO = 2.0
"""Residuals may be as many times their combined standard uncertainty before the standard errors are inflated.

Not one: where an error that all residuals share is the largest, their ratio is the size of one normal number, which
is beyond two once in 22 times.
"""

_OF_SHIFT = {"h", "w", "t_y", "kappa", "sharpness", "threshold"}


@dataclass(frozen=True)
class Evidence:
    """What a fit of a microfacet model knows of itself."""

    dataset: Dataset
    fitted: BoolArray
    """[points] which points were fitted."""
    distribution: Distribution
    quantities: tuple[Quantity, ...]
    values: FloatArray
    """[quantities]"""
    u: FloatArray
    """[quantities] standard uncertainties, infinite where fixed or not determined."""
    u_alpha_from_angles: float
    """The part of alpha's that the angles make: errors of the positions and of the zeros of the stages."""
    residual_ratio: float
    """Root mean square of residual over its combined standard uncertainty, systematic errors included."""
    r2: float
    """Share of the variation that is explained."""
    scanned_alphas: tuple[float, float]
    """Smallest and largest alpha that was scanned for a start."""
    w_fixed: bool
    """True where w had to be fixed at 0."""
    others: tuple[FloatArray, ...]
    """Parameters of other minima that are as good within the noise."""
    not_converged: str
    """Why the optimiser gave up; empty where it did not."""
    structure: Structure

    def of(self, name: str) -> tuple[float, float]:
        """Value and standard uncertainty of a parameter."""
        index = [quantity.name for quantity in self.quantities].index(name)
        return float(self.values[index]), float(self.u[index])

    def has(self, name: str) -> bool:
        """Whether the model has a parameter of this name."""
        return any(quantity.name == name for quantity in self.quantities)


def judge(evidence: Evidence) -> Verdict:
    """The verdict on a fit: what speaks against it first, then what a reader should know besides."""
    undetermined = _undetermined(evidence)
    against = [
        *_against_the_optimiser(evidence),
        *_against_the_model(evidence),
        *_against_alpha(evidence),
        *_against_shift(evidence),
        *_against_others(evidence, undetermined),
        *_outside_the_data(evidence),
    ]
    return Verdict(not against, (*against, *_notes(evidence)), undetermined, converged=not evidence.not_converged)


def _undetermined(evidence: Evidence) -> tuple[str, ...]:
    """Names of the parameters that are known worse than is of any use; without a shift, all that describe it."""
    names = [
        quantity.name
        for quantity, value, u in zip(evidence.quantities, evidence.values, evidence.u, strict=True)
        if not u <= quantity.useful(float(value))
    ]
    if evidence.has("h") and _h_is_zero(evidence):
        names += [quantity.name for quantity in evidence.quantities if quantity.name in _OF_SHIFT - {"h", "t_y"}]
    return tuple(dict.fromkeys(names))


def _h_is_zero(evidence: Evidence) -> bool:
    """Whether there is no shift: h is known, and compatible with zero."""
    h, u_h = evidence.of("h")
    return abs(h) <= 3 * u_h < 1


def _against_the_optimiser(evidence: Evidence) -> list[str]:
    reasons = [f"The fit did not converge. {evidence.not_converged}"] if evidence.not_converged else []
    for other in evidence.others:
        named = ", ".join(
            f"{quantity.name} = {value:.3g}{'' if quantity.unit == '1' else ' ' + quantity.unit}"
            for quantity, value in zip(evidence.quantities, other, strict=True)
        )
        reasons.append(f"Another minimum is as good within the noise: {named}.")
    return reasons


def _against_the_model(evidence: Evidence) -> list[str]:
    if evidence.r2 >= LEAST_R2 or evidence.residual_ratio <= LARGEST_RESIDUAL_RATIO:
        return []
    return [
        f"The model explains only {max(evidence.r2, 0.0):.0%} of how the data vary, which noise does not "
        "account for: it is not one of this sample."
    ]


def _against_others(evidence: Evidence, undetermined: tuple[str, ...]) -> list[str]:
    """Parameters that have no sentence of their own."""
    # without a shift, or with w fixed, h and w have a sentence already
    told = {"alpha", "h", "w"} if evidence.w_fixed or (evidence.has("h") and _h_is_zero(evidence)) else {"alpha"}
    names = [name for name in undetermined if name not in told]
    if not names or (evidence.has("h") and _h_is_zero(evidence) and set(names) <= _OF_SHIFT):
        return []
    return [f"The data do not tell {' and '.join(names)}."]


def _outside_the_data(evidence: Evidence) -> list[str]:
    """What was found where nothing was measured, or where the search ended."""
    dataset, fitted = evidence.dataset, evidence.fitted
    alpha, _ = evidence.of("alpha")
    nearest = float(np.min(np.abs(dataset.theta_out - dataset.theta_in)[fitted]))
    width = lobe_width(alpha, evidence.distribution)
    reasons = []
    if nearest > 0.5 * max(width, dataset.aperture):
        reasons.append(
            f"The lobe is {width:.2g} deg wide, but the direction nearest to the mirror's is {nearest:.2g} "
            "deg away from it, so alpha is an extrapolation."
        )
    at_bound = [
        quantity.name
        for quantity, value in zip(evidence.quantities, evidence.values, strict=True)
        if quantity.name not in {"alpha", "sharpness"}
        and not (quantity.name == "w" and evidence.w_fixed)
        and not quantity.lower + 1e-6 < value < quantity.upper - 1e-6
    ]
    if at_bound:
        reasons.append(f"The search of {' and '.join(at_bound)} ended at its bound.")
    return reasons


def _against_alpha(evidence: Evidence) -> list[str]:
    dataset, reasons = evidence.dataset, []
    alpha, u_alpha = evidence.of("alpha")
    width = lobe_width(alpha, evidence.distribution)
    if width < dataset.aperture:
        share = (evidence.u_alpha_from_angles / u_alpha) ** 2 if math.isfinite(u_alpha) else 0.0
        reasons.append(
            f"The lobe is {width:.2g} deg wide and the aperture {dataset.aperture:.2g} deg, so what was seen is "
            f"mostly the aperture; {share:.0%} of the variance of alpha comes from the stages: standard uncertainties "
            f"of {dataset.u_angle:.2g} deg of a position and {dataset.u_zero:.2g} deg of a zero."
        )
    useful = evidence.quantities[0].useful(alpha)
    if not u_alpha <= useful:
        reasons.append(f"alpha is known to {u_alpha / alpha:.1%} only; {useful / alpha:.0%} would do.")
    low, high = evidence.scanned_alphas
    if not low < alpha < high:
        reasons.append(f"alpha = {alpha:.3g} lies outside the range {low:g} to {high:g} of surfaces known.")
    bright = int(np.count_nonzero(above_noise(dataset) & evidence.fitted))
    count = int(evidence.fitted.sum())
    if bright < LEAST_SHARE_ABOVE_NOISE * count:
        reasons.append(
            f"Only {bright} of {count} points stand above the noise; {LEAST_SHARE_ABOVE_NOISE:.0%} would do."
        )
    return reasons


def _against_shift(evidence: Evidence) -> list[str]:
    if not evidence.has("h"):
        return []
    h, u_h = evidence.of("h")
    if _h_is_zero(evidence):
        fixed = "w to describe; w was fixed at 0." if evidence.w_fixed else "the other parameters to describe."
        return [f"h = {h:.2g} ± {u_h:.1g} 1/um is compatible with zero, so there is no shift for {fixed}"]
    if not evidence.w_fixed:
        return []
    return ["The slope does not change measurably with theta_m, so w was fixed at 0 and h is a constant slope."]


def _notes(evidence: Evidence) -> list[str]:
    notes = list(flag_sentences(evidence.dataset))
    notes += evidence.structure.sentences()
    if evidence.residual_ratio > LARGEST_RESIDUAL_RATIO:
        answer = "are inflated by this factor (Birge ratio)"
        if evidence.structure.structured:
            answer = 'have a part for it, "model"'
        notes.append(
            f"The residuals are {evidence.residual_ratio:.3g} times the combined standard uncertainty of the "
            "data, systematic errors included: the model does not describe everything. The standard errors "
            f"{answer}."
        )
    return notes
