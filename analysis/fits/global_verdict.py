"""Whether a function of direction describes the slopes, and its parameters are identified, in sentences."""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from analysis.fits.noise import flag_sentences
from analysis.fits.structure import Structure
from analysis.results import Verdict
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

_SIGNIFICANCE = 0.01

_USEFUL_P = 0.5
"""Standard error of p beyond which it is not told: half a reflection more or less."""


@dataclass(frozen=True)
class SlopeEvidence:
    """What a fit of the slopes knows of itself."""

    dataset: Dataset
    model: str
    names: tuple[str, ...]
    values: FloatArray
    """[names]"""
    u: FloatArray
    """[names] standard uncertainties."""
    w_bounds: tuple[float, float]
    chi2: float
    chi2_constant: float
    """Of the best constant slope."""
    slopes: int
    """How many were fitted,"""
    spectra: int
    """of how many spectra."""
    largest_theta_m: float
    """Radians."""
    scatter: float
    """Birge ratio of the slopes, at least 1,"""
    scatter_of_p: float
    """and of the exponents."""
    other_w: tuple[float, ...]
    """Of minima that are as good within the noise."""
    structure: Structure
    doubts: tuple[str, ...]
    """What speaks against all spectra."""


def judge_slopes(evidence: SlopeEvidence) -> Verdict:
    """The verdict: what speaks against the fit first, then what a reader should know besides."""
    against, undetermined = ([], ()) if evidence.model == "constant-slope" else _against(evidence)
    against = [*evidence.doubts, *against]
    of_p = _vague_exponent(evidence)
    return Verdict(not against, (*against, *of_p, *_notes(evidence)), (*undetermined, *(["p"] if of_p else [])))


def _vague_exponent(evidence: SlopeEvidence) -> list[str]:
    """What to say of a p that the spectra hardly tell, as where Fresnel is flat; the slopes are none the worse."""
    p, u = (
        dict(zip(evidence.names, map(float, each), strict=True)).get("p", 0.0) for each in (evidence.values, evidence.u)
    )
    return [] if u <= _USEFUL_P else [f"The spectra hardly tell p = {p:.2g} ± {u:.2g}."]


def _against(evidence: SlopeEvidence) -> tuple[list[str], tuple[str, ...]]:
    """What speaks against h, w and the others, and which of them mean nothing."""
    free = sum(name != "p" for name in evidence.names)
    left = evidence.slopes - free
    gained = (evidence.chi2_constant - evidence.chi2) / (free - 1)
    f_value = gained / (evidence.chi2 / left) if evidence.chi2 > 0 else np.inf
    # w is free only under the cosine; the search tries about this many independent ones, each a chance to fool it
    trials = max(1.0, evidence.w_bounds[1] * evidence.largest_theta_m / np.pi)
    probability = min(1.0, trials * float(fdtrc(free - 1, left, f_value)))
    value = dict(zip(evidence.names, map(float, evidence.values), strict=True))
    u = dict(zip(evidence.names, map(float, evidence.u), strict=True))
    h, w = value["h"], value["w"]
    low, high = evidence.w_bounds
    against: list[str] = []
    undetermined = [name for name in evidence.names if not _known(name, value, u)]
    if probability > _SIGNIFICANCE:
        against.append(
            f"The slopes are explained as well by a constant (F-test, p = {probability:.2g}), so h and w mean nothing."
        )
        undetermined = [name for name in evidence.names if name != "p"]
    # at its lower bound w is not determined, whatever its linear error says
    elif not (w > low * 1.001 and abs(h) > 3 * u["h"] and w > 3 * u["w"]):
        against.append(
            f"h and w = {w:.2g} are not told from zero: the slopes are as good as a parabola in theta_m, of which "
            "h + t_y and h w^2 are determined and nothing else."
        )
        undetermined += ["h", "w", "t_y"]
    elif undetermined:
        against.append(f"The slopes do not tell {' and '.join(undetermined)}.")
    if w >= high * 0.999:
        against.append(f"w stopped at its upper bound of {high:g}: the slopes vary faster than was searched.")
    if evidence.other_w and probability <= _SIGNIFICANCE:
        others = " and ".join(f"w = {other:.3g}" for other in evidence.other_w)
        against.append(f"Other minima are as good within the noise: {others}.")
    return against, tuple(undetermined)


def _known(name: str, value: dict[str, float], u: dict[str, float]) -> bool:
    """Whether a parameter of a two-component slope is known well enough to be of use."""
    if name not in {"kappa", "sharpness", "threshold"}:
        return True
    absolute, relative = (1.0, 0.5) if name == "sharpness" else (0.3, 0.33)
    return u[name] <= absolute + relative * abs(value[name])


def _notes(evidence: SlopeEvidence) -> list[str]:
    notes = []
    if evidence.slopes < evidence.spectra:
        notes.append(
            f"{evidence.spectra - evidence.slopes} of {evidence.spectra} spectra have no reliable slope and were left "
            "out."
        )
    if evidence.scatter > 1:
        shown = [name for name in evidence.names if name != "p"]
        names = f"{', '.join(shown[:-1])} and {shown[-1]}" if len(shown) > 1 else shown[0]
        notes.append(
            f"The slopes scatter {evidence.scatter:.3g} times as much as their combined standard uncertainty; "
            f"the standard errors of {names} are inflated by this factor (Birge ratio)."
        )
    if evidence.scatter_of_p > 1:
        notes.append(
            f"The exponents scatter {evidence.scatter_of_p:.3g} times as much as their combined standard uncertainty; "
            "the standard error of p is inflated by this factor (Birge ratio)."
        )
    return [*notes, *evidence.structure.sentences(), *flag_sentences(evidence.dataset)]
