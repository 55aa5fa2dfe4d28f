"""A dataset as a list shows it, and as it opens."""

from typing import Any

import numpy as np
from pydantic import Field

from api.views.body import Body, Number
from api.views.opened import Opened
from goniometer.angular import SAME_INCIDENCE, incidence_groups
from goniometer.catalogue import Entry
from goniometer.dataset import MEANING, Flag, Kind

FLAG_NAMES = {str(flag.name).lower().replace("_", "-"): flag for flag in Flag}
"""Every flag by the name that answers and questions use, e.g. "beyond-reference"."""


class DatasetRow(Body):
    """A dataset as a list shows it."""

    id: int
    sample: str = Field(description="Name of the sample, with the number of the repeat where there are several.")
    kind: Kind
    campaign_id: int | None = Field(description="Null where no campaign of this database measured it.")
    campaign: str | None
    bench: str | None = Field(description="Name of the bench; null where no campaign of this database measured it.")
    operator: str | None = Field(description="Who put the campaign into the queue; null where no service measured it.")
    scan_id: int | None
    created: str = Field(description="ISO 8601, UTC.")
    points: int = Field(description="Directions with a spectrum.")
    incident_angles: int
    wavelengths_nm: tuple[float, float] = Field(description="Shortest and longest, nm.")
    flags: list[str] = Field(description="Names of all flags that occur.")
    flagged: int = Field(description="Points with any flag.")
    checks_failed: int
    recalibrated_from: int | None = Field(description="The dataset that it was made anew from.")
    content_hash: str = Field(description="SHA-256 of all its numbers: two datasets of one hash are equal.")
    software_version: str


class FlagUse(Body):
    """A flag that occurs."""

    flag: str
    meaning: str
    points: int


class DatasetDetail(DatasetRow):
    """A dataset as it opens; what is large stands in resources of its own."""

    theta_in_deg: list[float] = Field(description="Mean of every incident angle, degrees, ascending.")
    theta_out_deg: tuple[float, float] = Field(description="Smallest and largest reflected angle, degrees.")
    wavelength_count: int
    aperture_deg: float = Field(description="Full angle of the detector's aperture, degrees; 0 where corrected for.")
    u_angle_deg: float = Field(description="Standard uncertainty (k = 1) of one stage position, degrees.")
    u_zero_deg: float = Field(description="Standard uncertainty (k = 1) of the zero of each stage, degrees.")
    median_relative_u: Number = Field(description="Combined standard uncertainty (k = 1) over the value, median.")
    flag_uses: list[FlagUse]
    fitted: list[str] = Field(description="Models of which there is a fit, oldest first.")
    certificate_override: str | None = Field(description="Who answers for a certificate that was not valid, and why.")


def flag_names(flags: int) -> list[str]:
    """Names of the bits that are set."""
    return [name for name, flag in FLAG_NAMES.items() if flags & flag]


def row(entry: Entry) -> DatasetRow:
    """The line of a list."""
    return DatasetRow(**_facts(entry))


def detail(opened: Opened) -> DatasetDetail:
    """A dataset as it opens."""
    dataset = opened.dataset
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    known = np.isfinite(dataset.u) & (dataset.brdf > 0)
    override = dataset.lineage.get("certificate_override")
    return DatasetDetail(
        **_facts(opened.entry),
        theta_in_deg=[float(dataset.theta_in[groups == g].mean()) for g in range(opened.entry.incident_angles)],
        theta_out_deg=(float(dataset.theta_out.min()), float(dataset.theta_out.max())),
        wavelength_count=dataset.wavelengths.size,
        aperture_deg=dataset.aperture,
        u_angle_deg=dataset.u_angle,
        u_zero_deg=dataset.u_zero,
        median_relative_u=float(np.median(dataset.u[known] / dataset.brdf[known])) if known.any() else None,
        flag_uses=[
            FlagUse(flag=name, meaning=MEANING[flag], points=int(dataset.flagged(flag).sum()))
            for name, flag in FLAG_NAMES.items()
            if dataset.flagged(flag).any()
        ],
        fitted=list(dict.fromkeys(fit.kind for fit in opened.fits)),
        certificate_override=None if override is None else str(override),
    )


def _facts(entry: Entry) -> dict[str, Any]:
    same = {name: getattr(entry, name) for name in DatasetRow.model_fields if hasattr(entry, name)}
    return same | {"wavelengths_nm": (entry.shortest, entry.longest), "flags": flag_names(entry.flags)}
