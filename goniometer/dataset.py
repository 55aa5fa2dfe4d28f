"""A calibrated in-plane spectral BRDF: what calibration makes and everything after it reads."""

import dataclasses
import hashlib
from dataclasses import dataclass, field

import numpy as np

from drivers.arrays import BoolArray, FloatArray

NOT_COVERED = "the uncertainty of the reference panel, lamp drift and stray light are not in it"
"""What no stated uncertainty contains, to be said wherever one is stated."""


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
    u_random: FloatArray
    """[points, wavelengths] standard uncertainty from the point's own counts, 1/sr; independent everywhere."""
    u_dark: FloatArray
    """[points, wavelengths] standard uncertainty passed on by the mean dark signal, 1/sr; independent between
    wavelengths, the same error for all points of one integration time."""
    u_reference: FloatArray
    """[points, wavelengths] standard uncertainty passed on by the counts of the reference scan, 1/sr;
    independent between wavelengths, taken as fully correlated between the points of one incident angle."""
    u_reference_dark: FloatArray
    """[points, wavelengths] standard uncertainty passed on by the mean dark signal of the reference scan, 1/sr;
    independent between wavelengths, taken as fully correlated between all points."""
    integration_time: FloatArray
    """[points] seconds; points of one integration time share their dark spectra."""
    u_angle: float
    """Standard uncertainty of one stage position, degrees; independent between moves of a stage."""
    aperture: float
    """Full angle of the detector aperture, degrees."""
    saturated: BoolArray
    """[points] whether some pixel stayed saturated at the shortest integration time."""
    lineage: dict[str, object] = field(default_factory=dict)
    """What it was derived from: run, exposures, reference scan, certificate, software version, settings."""

    @property
    def u(self) -> FloatArray:
        """[points, wavelengths] combined standard uncertainty (coverage factor 1) at the stated angles, 1/sr.

        Of the counts only: the errors of the stages, of the reference panel and of the lamp are not in it.
        """
        return np.sqrt(self.u_random**2 + self.u_dark**2 + self.u_reference**2 + self.u_reference_dark**2)

    @property
    def content_hash(self) -> str:
        """SHA-256 of the sample's name and all numbers, so that a fit can say what exactly it was fitted to."""
        digest = hashlib.sha256()
        for each in dataclasses.fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray):
                digest.update(f"{each.name} {value.shape}\n".encode())
                digest.update(np.ascontiguousarray(value, dtype="<f8").tobytes())
            elif each.name != "lineage":
                digest.update(f"{each.name} {value!r}\n".encode())
        return digest.hexdigest()
