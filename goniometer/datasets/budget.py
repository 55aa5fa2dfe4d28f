"""The uncertainty budget of one value of a dataset: what its combined uncertainty consists of, part by part.

Sources of error are independent of one another, so the variance of one value is the sum of theirs (JCGM 100:2008,
5.1.2). The expanded uncertainty takes the coverage factor 2, which covers 95.45 % of a normal distribution: the
effective degrees of freedom are assumed to be large, as no source rests on a few repetitions alone.
"""

from dataclasses import dataclass

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import GeometryError, InputError
from goniometer.uncertainty import PARTS, ErrorSource, combined

COVERAGE_FACTOR = 2
"""Of every expanded uncertainty, in a budget as in the bands and error bars of figures."""

COVERAGE = "95.45 % of a normal distribution, effective degrees of freedom assumed large"
"""What `COVERAGE_FACTOR` stands for, in words."""

FARTHEST = 2.0
"""Degrees from a wanted direction at which the nearest measured one must lie."""

USUAL_INCIDENT = 45.0
"""Incident angle, degrees, near which a budget is shown where nobody asks for another."""

USUAL_WAVELENGTH = 600.0
"""Wavelength, nm, at which a budget is shown where nobody asks for another."""


@dataclass(frozen=True)
class Contribution:
    """What a part of a budget, or one source of error, contributes."""

    name: str
    u: float
    """Standard uncertainty (coverage factor 1), 1/sr; of a single source signed: what its error does to the BRDF."""
    relative: float
    """`u` over the value, with the sign of `u`."""
    share: float
    """Of the variance, 0 to 1."""


@dataclass(frozen=True)
class SourceContribution(Contribution):
    """One source of error."""

    shared: str
    """Which points and wavelengths have the same error, in words."""


@dataclass(frozen=True)
class PartContribution(Contribution):
    """A part of the budget."""

    sources: tuple[SourceContribution, ...]
    """What it consists of, largest first; without those that do nothing to this value."""


@dataclass(frozen=True)
class Budget:
    """The budget of one measured value."""

    sample: str
    theta_in: float
    """Of the measured point, degrees, as read back."""
    theta_out: float
    """Of the measured point, degrees, as read back."""
    wavelength: float
    """Of the measured value, nm."""
    brdf: float
    """1/sr"""
    u: float
    """Combined standard uncertainty (coverage factor 1), 1/sr."""
    parts: tuple[PartContribution, ...]
    """In the order of `PARTS`; those that do not occur are absent."""

    @property
    def expanded(self) -> float:
        """Expanded uncertainty with coverage factor `COVERAGE_FACTOR`, 1/sr."""
        return COVERAGE_FACTOR * self.u


def usual_direction(dataset: Dataset) -> tuple[float, float]:
    """Where a budget is shown unless somebody asks for another direction: (theta_in, theta_out), degrees.

    That of the point with a value at `USUAL_WAVELENGTH` that is nearest to the mirror direction of the measured
    incident angle nearest `USUAL_INCIDENT`. At normal incidence the detector would stand in the beam there.
    """
    mirror = dataset.theta_in[np.argmin(np.abs(dataset.theta_in - USUAL_INCIDENT))]
    away = np.hypot(dataset.theta_in - mirror, dataset.theta_out - mirror)
    column = np.argmin(np.abs(dataset.wavelengths - USUAL_WAVELENGTH))
    point = np.argmin(np.where(np.isfinite(dataset.brdf[:, column]), away, np.inf))
    return float(dataset.theta_in[point]), float(dataset.theta_out[point])


def nearest_point(dataset: Dataset, theta_in: float, theta_out: float) -> int:
    """Number of the point with a value that lies nearest to a direction (degrees).

    Raises `GeometryError` where that is more than `FARTHEST` degrees away.
    """
    away = np.hypot(dataset.theta_in - theta_in, dataset.theta_out - theta_out)
    away = np.where(np.isfinite(dataset.brdf).any(axis=1), away, np.inf)
    point = int(np.argmin(away)) if away.size else -1
    if point < 0 or not away[point] <= FARTHEST:
        there = (
            f"the nearest is theta_in = {dataset.theta_in[point]:.2f}°, theta_out = {dataset.theta_out[point]:.2f}°, "
            f"so ask for that one"
            if point >= 0 and np.isfinite(away[point])
            else "it has no value at all"
        )
        raise GeometryError(
            f'The dataset of "{dataset.sample}" has no value within {FARTHEST:g}° of theta_in = {theta_in:g}°, '
            f"theta_out = {theta_out:g}°; {there}"
        )
    return point


def nearest_wavelength(dataset: Dataset, wavelength: float) -> int:
    """Number of the measured wavelength nearest to `wavelength`, nm; raises `InputError` outside their range."""
    step = float(np.diff(dataset.wavelengths).max(initial=1.0))
    lowest, highest = float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])
    if not lowest - step <= wavelength <= highest + step:
        raise InputError(
            f'Dataset of "{dataset.sample}" has no value at {wavelength:g} nm; ask for a wavelength from '
            f"{lowest:.0f} to {highest:.0f} nm"
        )
    return int(np.argmin(np.abs(dataset.wavelengths - wavelength)))


def budget(dataset: Dataset, theta_in: float, theta_out: float, wavelength: float) -> Budget:
    """The budget of the measured value nearest to a direction (degrees) and a wavelength (nm).

    Raises `GeometryError` where no measured direction is near, or the nearest has no value at this wavelength, and
    `InputError` outside the measured wavelengths.
    """
    point, column = nearest_point(dataset, theta_in, theta_out), nearest_wavelength(dataset, wavelength)
    value = float(dataset.brdf[point, column])
    if not np.isfinite(value):
        raise GeometryError(
            f"The point at theta_in = {dataset.theta_in[point]:.2f} deg, theta_out = "
            f"{dataset.theta_out[point]:.2f} deg has no value at {dataset.wavelengths[column]:.1f} nm; ask for another "
            f"wavelength or direction"
        )
    u = float(dataset.u[point, column])

    def contribution(name: str, own: float) -> tuple[str, float, float, float]:
        share = (own / u) ** 2 if u > 0 else 0.0
        return name, own, own / value if value != 0 else float("inf"), share

    parts = []
    for part in PARTS:
        members = [source for source in dataset.sources if source.part == part]
        own = [float(source.values[point, column]) for source in members]
        if not any(own):
            continue
        sources = [
            SourceContribution(*contribution(source.name, each), shared_by(source))
            for source, each in zip(members, own, strict=True)
            if each != 0
        ]
        sources.sort(key=lambda source: -source.share)
        parts.append(PartContribution(*contribution(part, float(np.linalg.norm(own))), tuple(sources)))
    return Budget(
        dataset.sample,
        float(dataset.theta_in[point]),
        float(dataset.theta_out[point]),
        float(dataset.wavelengths[column]),
        value,
        u,
        tuple(parts),
    )


def by_part(dataset: Dataset) -> dict[str, FloatArray]:
    """Standard uncertainty [points, wavelengths] (coverage factor 1), 1/sr, of every part that occurs, by `PARTS`."""
    found = {}
    for part in PARTS:
        members = tuple(source for source in dataset.sources if source.part == part)
        u = combined(members, dataset.brdf.shape)
        if u.any():
            found[part] = u
    return found


def shared_by(source: ErrorSource) -> str:
    """Which points and wavelengths have the same error of a source, in words."""
    points = "" if source.groups is None else "all points" if np.ptp(source.groups) == 0 else "some points"
    wavelengths = "all wavelengths" if source.shared_by_wavelengths else ""
    return ", ".join(word for word in (points, wavelengths) if word) or "nothing"
