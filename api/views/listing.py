"""A dataset as a list shows it, and as it opens."""

from typing import Any

import numpy as np

from api.bodies.datasets import DatasetDetail, DatasetRow, FlagUse
from api.views.opened import Opened
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import MEANING, Flag
from goniometer.storage.catalogue import Entry

FLAG_NAMES = {str(flag.name).lower().replace("_", "-"): flag for flag in Flag}
"""Every flag by the name that answers and questions use, e.g. "beyond-reference"."""


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
