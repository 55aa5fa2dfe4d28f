"""How far a `.bsdf` file is from its model, read back as a renderer reads it."""

from dataclasses import dataclass

import numpy as np

from analysis.bsdf.fields import unit
from analysis.bsdf.measured_bsdf import MeasuredBsdf, evaluate
from analysis.bsdf.rendered_model import RenderedModel
from analysis.colour import delta_e_2000, xyz_weights
from analysis.reflectance.directions import from_vectors
from drivers.arrays import FloatArray

LARGEST_TESTED_ANGLE = 80.0
"""Degrees; directions beyond are in the file but not in its stated error."""

FAINTEST = 1e-6
"""f cos(theta_o), 1/sr, below which a difference is related to this: a millionth of what white paper reflects."""

PAIRS = 4000
_SEED = 20220701
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class RelativeError:
    """Relative error of a file against its model, the worst of all tested wavelengths for each direction pair.

    Half of the pairs are uniform in solid angle up to `LARGEST_TESTED_ANGLE`, half follow the model's own lobe.
    """

    median: float
    p99: float
    maximum: float


@dataclass(frozen=True)
class Probe:
    """Pairs of directions with what the model reflects there."""

    incident: FloatArray
    """[pairs, 3] unit vectors."""
    reflected: FloatArray
    """[pairs, 3] unit vectors."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    exact: FloatArray
    """[pairs, wavelengths] f cos(theta_o), 1/sr."""

    def spread(self, found: FloatArray) -> FloatArray:
        """[pairs, wavelengths] relative difference of `found` from the model.

        A clamped shift makes the model exactly zero, so it is related to a thousandth of the brightest wavelength of
        the direction at least.
        """
        scale = np.maximum(self.exact, np.maximum(1e-3 * self.exact.max(axis=-1, keepdims=True), FAINTEST))
        return np.asarray(np.abs(found - self.exact) / scale)

    def relative(self, found: FloatArray) -> RelativeError:
        """Of values `found` like `exact`."""
        worst = self.spread(found).max(axis=-1)
        return RelativeError(float(np.median(worst)), float(np.percentile(worst, 99)), float(worst.max()))

    def colours(self, found: FloatArray) -> FloatArray:
        """[pairs] CIEDE2000, brightness included, each pair exposed so that the model's Y is that of white.

        Zero for pairs too faint to be seen beside any other. Raises `OutOfRange` as `analysis.colour.xyz_weights`.
        """
        weights = xyz_weights(self.wavelengths)
        exact = self.exact @ weights
        white = np.maximum(exact[:, 1:2], FAINTEST)
        difference = delta_e_2000(np.maximum(found @ weights, 0) / white, exact / white)
        return np.where(exact[:, 1] > FAINTEST, difference, 0.0)


def probe(model: RenderedModel, wavelengths: FloatArray) -> Probe:
    """The pairs by which files of a model are judged, at `wavelengths`, nm."""
    incident, reflected = _directions(model.alpha)
    exact = model.reflectance(from_vectors(incident, reflected, _UP), wavelengths) * reflected[:, 2:]
    return Probe(incident, reflected, wavelengths, exact)


def read_back(bsdf: MeasuredBsdf, at: Probe) -> FloatArray:
    """[pairs, wavelengths] f cos(theta_o) of a file, 1/sr."""
    return evaluate(bsdf, at.incident, at.reflected, at.wavelengths)


def _directions(alpha: float) -> tuple[FloatArray, FloatArray]:
    """Incident and reflected unit vectors [pairs, 3]: half uniform in solid angle, half within the lobe."""
    rng = np.random.default_rng(_SEED)
    lowest = np.cos(np.radians(LARGEST_TESTED_ANGLE))

    def uniform() -> FloatArray:
        return unit(np.arccos(rng.uniform(lowest, 1, PAIRS)), rng.uniform(-np.pi, np.pi, PAIRS))

    incident = uniform()
    share = rng.random(PAIRS)
    normal = unit(np.arctan(alpha * np.sqrt(share / (1 - share))), rng.uniform(-np.pi, np.pi, PAIRS))
    reflected = 2 * np.sum(incident * normal, axis=-1, keepdims=True) * normal - incident
    lit = np.flatnonzero(reflected[:, 2] > lowest)[: PAIRS // 2]
    even = uniform()
    others = slice(PAIRS - lit.size, None)
    return np.concatenate([incident[lit], uniform()[others]]), np.concatenate([reflected[lit], even[others]])
