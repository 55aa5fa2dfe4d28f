"""A calibrated in-plane spectral BRDF: what calibration, an import or a simulation makes, and all after it reads."""

import dataclasses
import hashlib
from dataclasses import dataclass, field, replace
from enum import IntFlag
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import BoolArray, FloatArray
from goniometer.uncertainty import ErrorSource, combined


class Flag(IntFlag):
    """What is doubtful about a point; a flagged point is kept, and the fits say what they do with it."""

    SATURATED = 1
    """Some pixel stayed saturated at the shortest integration time."""
    BEYOND_REFERENCE = 2
    """The reference scan does not reach so far, so the point has no value."""
    CLIPPED = 4
    """The detector sees beyond the edge of the sample."""
    BELOW_NOISE = 8
    """The median signal is below its uncertainty from the counts."""
    NEGATIVE = 16
    """Values lie below zero by more than three of their uncertainties from the counts."""


MEANING = {
    Flag.SATURATED: "saturated at the shortest integration time",
    Flag.BEYOND_REFERENCE: "beyond the reference scan",
    Flag.CLIPPED: "footprint leaves the sample",
    Flag.BELOW_NOISE: "below the noise",
    Flag.NEGATIVE: "negative beyond the noise",
}
"""Every flag in words."""

LEFT_OUT = Flag.SATURATED | Flag.BEYOND_REFERENCE | Flag.CLIPPED
"""Flags whose points the fits leave out."""

IN_FITS = {
    Flag.BELOW_NOISE: "kept in fits of all points, without a slope of their own",
    Flag.NEGATIVE: "kept",
} | dict.fromkeys(LEFT_OUT, "left out of all fits")
"""What the fits do with points of every flag, in words."""


Kind = Literal["measured", "simulated", "imported"]


def kind_of(lineage: dict[str, object]) -> Kind:
    """Who made the dataset of this lineage: this program's bench, a simulation, or another program."""
    if "simulated" in lineage:
        return "simulated"
    return "imported" if "imported" in lineage else "measured"


@dataclass(frozen=True)
class Check:
    """One question that the dataset was asked."""

    name: str
    """E.g. "reciprocity"."""
    passed: bool | None
    """None where the data do not tell."""
    message: str
    """What was found, with numbers, and if it failed what to do; whole sentences."""


@dataclass(frozen=True)
class Dataset:
    """In-plane BRDF of one sample; points first, wavelengths last. Blocked directions are absent."""

    sample: str
    """Name of the sample."""
    theta_in: FloatArray
    """[points] incident angle, degrees, as read back from the stages."""
    theta_out: FloatArray
    """[points] reflected angle, degrees, signed, as read back from the stages."""
    wavelengths: FloatArray
    """[wavelengths] nanometres, ascending: of the detector pixels that were binned, weighted by their light."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr; NaN where no valid value exists: saturated pixels, and points beyond
    the reference scan."""
    sources: tuple[ErrorSource, ...]
    """Everything that makes `brdf` uncertain; zero where it has no value."""
    flags: NDArray[np.uint16]
    """[points] what is doubtful about a point, a sum of `Flag`."""
    u_angle: float
    """Standard uncertainty of one stage position, degrees; independent between moves of a stage."""
    u_zero: float
    """Standard uncertainty of the zero of each stage, degrees; the same error for all points."""
    aperture: float
    """Full angle of the detector aperture over which `brdf` is an average, degrees; 0 where that was corrected."""
    checks: tuple[Check, ...] = ()
    """What the sanity checks found."""
    lineage: dict[str, object] = field(default_factory=dict)
    """What it was derived from: run, exposures, reference scan, certificate, software version, settings."""

    @property
    def simulated(self) -> bool:
        """Whether a simulation made it, in which no detector stands in the way of the source."""
        return kind_of(self.lineage) == "simulated"

    @property
    def kind(self) -> Kind:
        """Who made it: this program's bench, a simulation, or another program."""
        return kind_of(self.lineage)

    @cached_property
    def u(self) -> FloatArray:
        """[points, wavelengths] combined standard uncertainty (coverage factor 1), 1/sr; NaN without a value."""
        return np.where(np.isfinite(self.brdf), combined(self.sources, self.brdf.shape), np.nan)

    @cached_property
    def u_counts(self) -> FloatArray:
        """[points, wavelengths] the part of `u` that wavelengths do not share, 1/sr: noise, by which to weigh."""
        own = tuple(source for source in self.sources if not source.shared_by_wavelengths)
        return np.where(np.isfinite(self.brdf), combined(own, self.brdf.shape), np.nan)

    def flagged(self, flag: Flag) -> BoolArray:
        """[points] whether any of the bits of `flag` is set."""
        return np.asarray((self.flags & int(flag)) != 0)

    @property
    def usable(self) -> BoolArray:
        """[points] which points a fit may use: those without a flag of `LEFT_OUT`."""
        return ~self.flagged(LEFT_OUT)

    def at_points(self, chosen: NDArray[np.intp]) -> "Dataset":
        """The same at some of its points, by their indexes."""
        return replace(
            self,
            theta_in=self.theta_in[chosen],
            theta_out=self.theta_out[chosen],
            brdf=self.brdf[chosen],
            sources=tuple(_of_points(source, chosen) for source in self.sources),
            flags=self.flags[chosen],
        )

    def at_wavelengths(self, chosen: NDArray[np.intp] | slice) -> "Dataset":
        """The same at some of its wavelengths, by their indexes."""
        return replace(
            self,
            wavelengths=self.wavelengths[chosen],
            brdf=self.brdf[:, chosen],
            sources=tuple(replace(source, values=source.values[:, chosen]) for source in self.sources),
        )

    @property
    def content_hash(self) -> str:
        """SHA-256 of the sample's name and all numbers, so that a fit can say what exactly it was fitted to."""
        digest = hashlib.sha256()

        def add(name: str, value: object) -> None:
            if isinstance(value, np.ndarray):
                digest.update(f"{name} {value.shape}\n".encode())
                numbers = np.asarray(value, dtype="<f8")
                # of the many bit patterns of "no number" a text keeps none
                digest.update(np.where(np.isnan(numbers), np.nan, numbers).astype("<f8").tobytes())
            else:
                if isinstance(value, int | float) and not isinstance(value, bool):
                    value = float(value)
                digest.update(f"{name} {value!r}\n".encode())

        for each in dataclasses.fields(self):
            if each.name not in {"sources", "checks", "lineage"}:
                add(each.name, getattr(self, each.name))
        for source in self.sources:
            for each in dataclasses.fields(source):
                add(f"{source.name}: {each.name}", getattr(source, each.name))
        return digest.hexdigest()


def _of_points(source: ErrorSource, chosen: NDArray[np.intp]) -> ErrorSource:
    """A source of error at some of its points; the groups that are left count from 0 again."""
    groups = None if source.groups is None else np.unique(source.groups[chosen], return_inverse=True)[1]
    return replace(source, values=source.values[chosen], groups=groups)
