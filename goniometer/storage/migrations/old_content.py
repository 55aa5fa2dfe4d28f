"""What revision 0001 makes of campaigns, constants and datasets from before it, for programs from then on to read.

A campaign of versions 1 to 4 had a step that plans no longer ask for, and the constants of versions 1 and 2 knew less
of the bench; what is not stated is what it is by default. The hash of a campaign stays, by which it is told that one
that had begun then is not gone on with now.

Of datasets, versions 1 and 2 stored standard uncertainties by name and whether a point was saturated, version 3 first
knew sources of error and flags but no uncertainty of the stages' zero. What was not stated then is zero. The content
hash stays what fits and files call the dataset by.
"""

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SATURATED, _BEYOND_REFERENCE = 1, 2
_SAME_INCIDENCE = 0.05
"""Degrees."""

Arrays = dict[str, NDArray[Any]]


def campaign_of(text: str) -> str:
    """The JSON of a campaign."""
    content = json.loads(text)
    content["resolution"].pop("coarse_step", None)
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def constants_of(text: str) -> str:
    """The JSON of the constants of a scan."""
    content = json.loads(text)
    if "bench" not in content:
        content["bench"] = {name: content.pop(name) for name in ("gain", "u_angle", "aperture")}
    return json.dumps(content, sort_keys=True)


def columns_of(row: dict[str, Any]) -> dict[str, Any]:
    """All columns of revision 0001 for a row of an older table of datasets."""
    with np.load(io.BytesIO(row["arrays"])) as archive:
        arrays = dict(archive)
    if "sources" not in arrays:
        arrays = _with_sources(arrays)
    arrays.setdefault("u_zero", np.array(0.0))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    lineage = json.loads(row["lineage"])
    checks = row.get("checks", "[]")
    theta_in, wavelengths, flags = arrays["theta_in"], arrays["wavelengths"], arrays["flags"]
    source = lineage.get("recalibrated_from")
    return {
        "certificate": None,
        **row,
        "kind": next((kind for kind in ("simulated", "imported") if kind in lineage), "measured"),
        "points": theta_in.size,
        "incident_angles": int(_incidence_groups(theta_in).max(initial=-1)) + 1,
        "shortest": float(wavelengths[0]),
        "longest": float(wavelengths[-1]),
        "flags": int(np.bitwise_or.reduce(flags, initial=0)),
        "flagged": int(np.count_nonzero(flags)),
        "checks_failed": sum(check["passed"] is False for check in json.loads(checks)),
        "recalibrated_from": source if isinstance(source, int) and "reloaded" not in lineage else None,
        "checks": checks,
        "arrays": buffer.getvalue(),
    }


def _with_sources(old: Arrays) -> Arrays:
    """The arrays of versions 1 and 2 with sources of error and flags instead of what they had."""
    points = old["theta_in"].size
    groups: dict[str, tuple[str, NDArray[np.intp] | None]] = {
        "u_random": ("random", None),
        "u_reference": ("reference", _incidence_groups(old["theta_in"])),
        "u_reference_dark": ("dark", np.zeros(points, dtype=np.intp)),
    }
    if "u_dark" in old:  # points of one integration time shared their darks
        groups["u_dark"] = ("dark", np.unique(old["integration_time"], return_inverse=True)[1].astype(np.intp))
    kept = {"theta_in", "theta_out", "wavelengths", "brdf", "u_angle", "aperture"}
    new = {name: array for name, array in old.items() if name in kept}
    about = []
    for i, name in enumerate(name for name in groups if name in old):
        part, group = groups[name]
        about.append({"name": name.removeprefix("u_").replace("_", " "), "part": part, "shared_by_wavelengths": False})
        new[f"source_{i}"] = np.where(np.isfinite(old["brdf"]), old[name], 0.0)
        if group is not None:
            new[f"groups_{i}"] = group
    beyond = np.isnan(old["brdf"]).all(axis=1) & ~old["saturated"]
    new["flags"] = (_SATURATED * old["saturated"] + _BEYOND_REFERENCE * beyond).astype(np.uint16)
    new["sources"] = np.array(json.dumps(about))
    return new


def _incidence_groups(theta_in: NDArray[np.float64]) -> NDArray[np.intp]:
    """[points] number, from 0, of the incident angle."""
    order = np.argsort(theta_in, kind="stable")
    groups = np.empty(theta_in.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(np.diff(theta_in[order]) > _SAME_INCIDENCE)])
    return groups
