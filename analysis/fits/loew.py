"""A measurement as the cost of Löw et al. 2012 sees it (section 6.2.1 of the paper).

The cost is the sum of [ln(1 + cos(theta_in) f_model) - ln(1 + cos(theta_in) f_measured)]^2 over points and
wavelengths. Some implementations weigh its terms with sin(theta_in); ours may, or may divide every residual by its
standard uncertainty, and says which in the name of the cost.
"""

from dataclasses import dataclass, replace

import numpy as np

from analysis.choices import Weight
from analysis.errors import FitError
from analysis.fits.noise import flag_sentences
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

DARKEST = -0.99
"""Where cos(theta_in) f of a noisy measurement is cut off, so that ln(1 + cos(theta_in) f) exists."""

LEAST_POINTS = 5
"""Points that a fit must have."""

MIRROR_LOBE = 1.0
"""Full width at half maximum, degrees, below which a lobe counts as mirror-like and grazing angles weigh less."""

_NAMES: dict[Weight, str] = {
    "none": "loew",
    "sine": "loew, terms weighted by sin(theta_in)",
    "uncertainty": "loew, each residual divided by its standard uncertainty from the counts",
}


def weight_of(cost: str) -> Weight:
    """The weight that the name of a cost tells."""
    weighted: tuple[Weight, ...] = ("sine", "uncertainty")
    return next((weight for weight in weighted if cost.startswith(_NAMES[weight])), "none")


@dataclass(frozen=True)
class LoewData:
    """The measurement without the points that are not usable."""

    dataset: Dataset
    points: BoolArray
    """[all points] which are fitted; everything below has only these."""
    theta_in: FloatArray
    """[points] degrees."""
    theta_out: FloatArray
    """[points] degrees."""
    log_measured: FloatArray
    """[points, wavelengths] ln(1 + cos(theta_in) f); 0 where there is no value."""
    root_weight: FloatArray
    """[points, wavelengths] root of the weight of a term; 0 where there is no value."""
    log_derivative: FloatArray
    """[points, wavelengths] of ln(1 + cos(theta_in) f) by f: turns an uncertainty of f into one of the residual."""
    cost: str
    """Name of the cost."""

    @property
    def valid(self) -> BoolArray:
        """[points, wavelengths] where there is a value."""
        return np.asarray(self.root_weight > 0)


def loew_data(dataset: Dataset, weight: Weight = "none") -> LoewData:
    """What a fit reads of `dataset`: points without a value, without uncertainty or not usable are left out.

    With the weight "sine", points at theta_in = 0 drop out too. Raises `FitError` if fewer than five points are left.
    """
    valid = np.isfinite(dataset.brdf) & np.isfinite(dataset.u_counts) & (dataset.u_counts > 0)
    points = valid.any(axis=1) & dataset.usable
    if weight == "sine":
        points &= np.sin(np.radians(np.abs(dataset.theta_in))) > 1e-6
    if points.sum() < LEAST_POINTS:
        raise FitError(
            f"Only {points.sum()} of {points.size} points of {dataset.sample} have values and uncertainties and are "
            f"usable; a fit needs at least {LEAST_POINTS}. {' '.join(flag_sentences(dataset))}".rstrip()
        )
    valid, theta_in = valid[points], dataset.theta_in[points]
    cos_in = np.cos(np.radians(theta_in))[:, None]
    seen = np.maximum(cos_in * np.where(valid, dataset.brdf[points], 0.0), DARKEST)
    log_derivative = cos_in / (1 + seen)
    root = valid.astype(float)
    if weight == "uncertainty":
        root[valid] = 1 / (log_derivative * dataset.u_counts[points])[valid]
    elif weight == "sine":
        root *= np.sqrt(np.sin(np.radians(np.abs(theta_in))))[:, None]
    return LoewData(
        dataset=dataset,
        points=points,
        theta_in=theta_in,
        theta_out=dataset.theta_out[points],
        log_measured=np.log1p(seen),
        root_weight=root,
        log_derivative=log_derivative,
        cost=_NAMES[weight],
    )


def grazing_weighs_less(data: LoewData) -> LoewData:
    """The same with every term weighted by cos(theta_in)^2, for mirror-like samples.

    The paper gives grazing angles of its mirror less weight, because its instrument reads too little there (6.2.1),
    and does not say how much less: a term at 80 degrees has 3 % of its weight here.
    """
    cosine = np.cos(np.radians(data.theta_in))[:, None]
    return replace(
        data,
        root_weight=data.root_weight * cosine,
        cost=f"{data.cost}, terms weighted by cos(theta_in)^2 because the sample is mirror-like",
    )
