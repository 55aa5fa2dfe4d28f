"""A dataset from what somebody else measured.

A dataset needs to know how uncertain it is, through how wide an aperture it was seen and how well its angles are
known; a file rarely says. What it does not say is asked of the person who imports it, and the lineage of the dataset
tells where every number comes from. The stated uncertainty of a value is split: what the scatter between neighbouring
wavelengths explains is noise of each value, and the rest an error that all points and wavelengths share, as that of a
reference is. So the two add up to what was stated, or to the scatter where that is more.
"""

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, along_theta_out, incidence_groups
from goniometer.datasets.checks import checks_of_imported, noise_flags
from goniometer.datasets.dataset import Dataset
from goniometer.errors import OptionError
from goniometer.files.measured_table import MeasuredTable
from goniometer.files.scatter import FEWEST_WAVELENGTHS, scatter
from goniometer.storage.derived import software_version
from goniometer.uncertainty import ErrorSource, combined, everywhere

ROUNDING = 1e-12
"""Scatter, as a part of a value, below which it tells of arithmetic and not of a measurement."""


@dataclass(frozen=True)
class Stated:
    """What a person says of the data, all standard uncertainties with coverage factor 1."""

    relative_uncertainty: float | None
    """Combined, of a value, as a part of it; None where the file states one for every value."""
    relative_noise: float | None
    """Of a value against its neighbouring wavelengths, as a part of it; None to take their scatter."""
    aperture: float
    """Full angle of the detector's aperture, degrees; 0 for one that is as good as a point."""
    u_angle: float
    """Of either angle, degrees; independent between moves of a stage."""


def imported_dataset(sample: str, table: MeasuredTable, stated: Stated, lineage: dict[str, object]) -> Dataset:
    """The dataset of a tidied `table`; `lineage` says what it was read from.

    Raises `InputError` where the noise can neither be seen nor was stated.
    """
    valid = np.isfinite(table.brdf)
    f = np.where(valid, table.brdf, 0.0)
    noise = _noise(table, stated)
    total = table.u if table.u is not None else (stated.relative_uncertainty or 0.0) * np.abs(f)
    known = np.hypot(noise, combined(table.errors, f.shape))
    rest = np.sign(f) * np.sqrt(np.maximum(np.where(valid, total, 0.0) ** 2 - known**2, 0.0))
    incidence = incidence_groups(table.theta_in, SAME_INCIDENCE)
    slope = np.where(valid, along_theta_out(table.theta_out, incidence, table.brdf, noise).first, 0.0)
    everyone = everywhere(table.theta_in.size)
    sources = (
        ErrorSource("random", "random", noise, None, shared_by_wavelengths=False),
        *table.errors,
        ErrorSource("reference: as stated with the file", "reference", rest, everyone, shared_by_wavelengths=True),
        # a turn of the sample moves both angles, see `goniometer.radiometry.sources`
        ErrorSource("angle: sample stage", "angle", -2 * slope * stated.u_angle, incidence, shared_by_wavelengths=True),
        ErrorSource("angle: detector stage", "angle", slope * stated.u_angle, None, shared_by_wavelengths=True),
    )
    dataset = Dataset(
        sample=sample,
        theta_in=table.theta_in,
        theta_out=table.theta_out,
        wavelengths=table.wavelengths,
        brdf=table.brdf,
        sources=tuple(source for source in sources if source.values.any()),
        flags=noise_flags(table.brdf, noise),
        u_angle=stated.u_angle,
        u_zero=0.0,
        aperture=stated.aperture,
        lineage=lineage | {"uncertainty": _origin(table, stated), "software_version": software_version()},
    )
    return replace(dataset, checks=checks_of_imported(dataset))


def _noise(table: MeasuredTable, stated: Stated) -> FloatArray:
    """[points, wavelengths] standard uncertainty of a value that its neighbours do not share, 1/sr; 0 without one."""
    valid = np.isfinite(table.brdf)
    if stated.relative_noise is not None:
        return np.where(valid, stated.relative_noise * np.abs(table.brdf), 0.0)
    found = scatter(table.wavelengths, table.brdf)
    if not (found[valid] > ROUNDING * np.abs(table.brdf[valid])).all():
        raise OptionError(
            f"The noise of the spectra cannot be seen in their scatter, which needs {FEWEST_WAVELENGTHS} wavelengths "
            f"and values that are not rounded or computed; state it with {{relative_noise}}.",
            "relative_noise",
        )
    return np.where(valid, found, 0.0)


def _origin(table: MeasuredTable, stated: Stated) -> dict[str, str]:
    """Where every part of the uncertainty comes from, in words."""
    told = {
        "noise": "scatter between neighbouring wavelengths"
        if stated.relative_noise is None
        else f"stated, {100 * stated.relative_noise:g} % of a value",
        "angles": f"stated, {stated.u_angle:g}° of either angle",
    }
    if table.u is not None:
        told["all"] = "stated in the file for every value"
    elif stated.relative_uncertainty is not None:
        told["all"] = f"stated, {100 * stated.relative_uncertainty:g} % of a value"
    if table.errors:
        told["reference and darks"] = "certificate of the reference, and scatter of the dark spectra"
    return told
