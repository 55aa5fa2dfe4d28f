"""Whether residuals are noise or have a structure, and how many of them count as independent.

Neighbours that share a stated error agree by as much as that error says. What they agree by beyond it is structure:
something that the model does not describe.
"""

from dataclasses import dataclass

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.uncertainty import ErrorSource, combined

LARGEST_AGREEMENT = 4.0
"""Neighbours may agree by so many times what their shared errors explain before it is called structure.

Where one error is shared by all, their agreement is the square of a single normal number, which exceeds 4 once in 22
times.
"""

_CHANCE = 5.0
"""Standard deviations by which chance alone may make neighbours agree."""


@dataclass(frozen=True)
class Agreement:
    """How much neighbouring residuals agree: mean product of two, each divided by its combined uncertainty."""

    found: float
    expected: float
    """What the stated errors that both share make of it."""
    correlation: float
    """Lag-one autocorrelation of the residuals themselves."""
    pairs: int

    @property
    def structured(self) -> bool:
        """Whether neighbours agree by more than their stated errors and chance explain."""
        chance = _CHANCE * (1 + self.expected) / np.sqrt(max(self.pairs, 1))
        return bool(self.found > LARGEST_AGREEMENT * self.expected + chance)


@dataclass(frozen=True)
class Structure:
    """What the residuals of a fit have to say."""

    over_wavelength: Agreement
    over_theta_out: Agreement
    independent: float
    """As how many independent residuals all of them count: N (1 - r) / (1 + r) for each direction of neighbourhood,
    r its lag-one autocorrelation (the effective sample size of a first-order autoregressive series), and at least one
    a spectrum."""

    @property
    def structured(self) -> bool:
        """Whether the residuals are anything but noise."""
        return self.over_wavelength.structured or self.over_theta_out.structured

    def sentences(self) -> tuple[str, ...]:
        """What a reader should know: nothing where the residuals are noise."""
        found = [
            f"{name} (mean product of standardised neighbours {agreement.found:.3g}, of which the stated errors "
            f"explain {agreement.expected:.2g})"
            for name, agreement in (("wavelength", self.over_wavelength), ("theta_out", self.over_theta_out))
            if agreement.structured
        ]
        return (f"The residuals are structured over {' and over '.join(found)}, not noise.",) if found else ()


def structure(
    residual: FloatArray,
    valid: BoolArray,
    errors: tuple[ErrorSource, ...],
    theta_in: FloatArray,
    theta_out: FloatArray,
) -> Structure:
    """Look at residuals [points, wavelengths] along wavelength and along theta_out within an incident angle.

    `valid` says which count; `errors` are what one standard uncertainty of every source does to the residuals.
    """
    size = combined(errors, residual.shape)
    known = valid & (size > 0)
    z = np.where(known, residual / np.where(known, size, 1.0), 0.0)
    share = [(source, np.where(known, source.values / np.where(known, size, 1.0), 0.0)) for source in errors]

    along = slice(None, -1), slice(1, None)
    pairs = known[:, along[0]] & known[:, along[1]]
    expected = sum(
        (e[:, along[0]] * e[:, along[1]] for source, e in share if source.shared_by_wavelengths), np.zeros(pairs.shape)
    )
    over_wavelength = _agreement(z[:, along[0]], z[:, along[1]], expected, pairs)

    first, second = _neighbours(theta_in, theta_out)
    pairs = known[first] & known[second]
    expected = np.zeros(pairs.shape)
    for source, e in share:
        if source.groups is not None:
            together = source.groups[first] == source.groups[second]
            expected += np.where(together[:, None], e[first] * e[second], 0.0)
    over_theta_out = _agreement(z[first], z[second], expected, pairs)

    independent = float(np.count_nonzero(valid))
    for agreement in (over_wavelength, over_theta_out):
        r = min(max(agreement.correlation, 0.0), 0.999)
        independent *= (1 - r) / (1 + r)
    spectra = float(np.count_nonzero(valid.any(axis=1)))
    return Structure(over_wavelength, over_theta_out, max(independent, spectra))


def _neighbours(theta_in: FloatArray, theta_out: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of points that follow each other in theta_out at one incident angle."""
    groups = incidence_groups(theta_in, SAME_INCIDENCE)
    order = np.lexsort((theta_out, groups))
    first, second = order[:-1], order[1:]
    same = groups[first] == groups[second]
    return first[same], second[same]


def _agreement(z: FloatArray, neighbour: FloatArray, expected: FloatArray, pairs: BoolArray) -> Agreement:
    count = int(np.count_nonzero(pairs))
    if count == 0:
        return Agreement(0.0, 0.0, 0.0, 0)
    z, neighbour = z[pairs], neighbour[pairs]
    size = float(np.sqrt(np.sum(z**2) * np.sum(neighbour**2)))
    product = float(z @ neighbour)
    return Agreement(
        found=product / count,
        expected=float(np.abs(expected[pairs]).sum()) / count,
        correlation=product / size if size > 0 else 0.0,
        pairs=count,
    )
