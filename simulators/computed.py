"""A simulated BRDF as a dataset like a measured one, so that fits, maps, checks and exports work on it."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.checks import checks_of_simulated, noise_flags
from goniometer.datasets.dataset import Dataset
from goniometer.storage.derived import software_version
from goniometer.uncertainty import ErrorSource

PRECISION = 1e-4
"""Least error of a computed value of its own, as a part of it: what tables and transforms are good for."""


@dataclass(frozen=True)
class Computed:
    """In-plane spectral BRDF that a simulation found; points first, wavelengths last."""

    sample: str
    """Name that the dataset gets."""
    theta_in: FloatArray
    """[points] incident angle, degrees."""
    theta_out: FloatArray
    """[points] reflected angle, degrees, signed."""
    wavelengths: FloatArray
    """[wavelengths] nm, ascending."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr."""
    u_level: FloatArray
    """[points, wavelengths] standard error that all wavelengths of a point share, 1/sr: too bright or too dark."""
    u_spectral: FloatArray
    """[points, wavelengths] standard error of each value by itself, 1/sr: a wrong colour."""
    aperture: float
    """Full angle over which every value is an average, degrees; 0 for none."""
    lineage: dict[str, object]
    """What was simulated and how; `simulated` is one phrase for lists, e.g. "rays on sample-1"."""
    u_tilt: FloatArray | None = None
    """[points, wavelengths] signed standard error that all wavelengths of a point share, one end of the spectrum being
    too bright where the other is too dark, 1/sr: what makes a slope uncertain. None for none."""


def computed_dataset(computed: Computed) -> Dataset:
    """The dataset of a simulation; it belongs into a database as one of no scan."""
    own = np.maximum(computed.u_spectral, PRECISION * np.abs(computed.brdf))
    sources: tuple[ErrorSource, ...] = (
        ErrorSource("random: of each wavelength", "random", own, None, shared_by_wavelengths=False),
        ErrorSource("random: of all wavelengths", "random", computed.u_level, None, shared_by_wavelengths=True),
    )
    if computed.u_tilt is not None:
        sources += (ErrorSource("random: of the tilt", "random", computed.u_tilt, None, shared_by_wavelengths=True),)
    dataset = Dataset(
        sample=computed.sample,
        theta_in=computed.theta_in,
        theta_out=computed.theta_out,
        wavelengths=computed.wavelengths,
        brdf=computed.brdf,
        sources=sources,
        flags=noise_flags(computed.brdf, own),
        u_angle=0.0,
        u_zero=0.0,
        aperture=computed.aperture,
        lineage=computed.lineage | {"software_version": software_version()},
    )
    return replace(dataset, checks=checks_of_simulated(dataset))
