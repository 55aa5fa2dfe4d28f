"""The universal BRDF format of the BiRD project (European metrology project 18SIB03), version 1.0, as JSON.

One object of `metadata`, which `goniometer.files.bird_metadata` makes, and `data`: lists of equal length, one number
for each value of the BRDF, with the angles of both directions in spherical coordinates. Both directions point away from
the surface, so in plane the mirror side is that of opposite azimuths: phi_r = phi_i + 180 degrees. The format knows no
flags and no values below zero, so such values are left out, and it does not say what coverage factor an uncertainty
has; it is taken as 1, and written so in a comment.
"""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import LEFT_OUT, Dataset
from goniometer.errors import DataFileError
from goniometer.files.measured_table import MeasuredTable, gridded, mirror_is_absent

_ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
_ANGLE_UNITS = {"rad": 180 / math.pi, "deg": 1.0, "°": 1.0}
_WAVELENGTH_UNITS = {"nm": 1.0, "μm": 1000.0, "µm": 1000.0}
_BRDF_UNITS = ("1/sr", "sr^-1")
_IN_PLANE = 1e-6
"""Sine of the angle between a direction and the plane up to which it lies in the plane."""


def bird_json(dataset: Dataset, metadata: dict[str, Any]) -> tuple[str, list[str]]:
    """The text of the file, and sentences about what is not in it; raises `DataFileError` where nothing is left."""
    kept = np.isfinite(dataset.brdf) & (dataset.brdf >= 0) & ~dataset.flagged(LEFT_OUT)[:, None]
    if not kept.any():
        raise DataFileError(f"{dataset.sample}: has no value that may be exported; calibrate it again.")
    point, wavelength = np.nonzero(kept)
    theta_out = dataset.theta_out[point]
    u_stage = math.hypot(dataset.u_angle, dataset.u_zero)
    columns = {
        "theta_i": _part("deg", dataset.theta_in[point], "", u_stage),
        "phi_i": _part("deg", np.zeros(point.size)),
        # the sample's stage turns the surface below the detector, whose arm is another stage
        "theta_r": _part("deg", np.abs(theta_out), "", math.sqrt(2) * u_stage),
        "phi_r": _part("deg", np.where(theta_out < 0, 0.0, 180.0), "180 deg is the side of the mirror direction"),
        "wavelength_i": _part(
            "nm",
            dataset.wavelengths[wavelength],
            "selected at the detector; the incident light has the same, as there is no fluorescence",
        ),
        "BRDF": _part("sr^-1", dataset.brdf[kept]),
        "uBRDF": _part("sr^-1", dataset.u[kept], "combined standard uncertainty, coverage factor k = 1"),
    }
    text = json.dumps({"metadata": metadata, "data": columns}, ensure_ascii=False, allow_nan=False) + "\n"
    left = int(kept.size - kept.sum())
    told = f"{left} of {kept.size} values are not in the file, which knows no flags and nothing below zero."
    return text, [told] if left else []


def _part(unit: str, values: FloatArray, comments: str = "", u: float = 0.0) -> dict[str, Any]:
    part: dict[str, Any] = {"unit": unit, "values": (values + 0.0).tolist()}  # no negative zero
    if u:
        part["uncertainty"] = {"value": u, "unit": unit}
        comments = "uncertainty: standard, coverage factor k = 1, of position and zero"
    return part | ({"comments": comments} if comments else {})


def parsed_json(path: str, text: str) -> dict[str, Any]:
    """The object of a file; raises `DataFileError` where its text is none."""
    try:
        content = json.loads(text)
    except ValueError as error:
        raise DataFileError(f"{path}: is not valid JSON ({error}); see whether the file is complete.") from error
    except RecursionError as error:
        raise DataFileError(f"{path}: is nested too deeply; it must be an object of metadata and data.") from error
    if not isinstance(content, dict):
        raise DataFileError(f"{path}: must be an object of metadata and data.")
    return content


def read_bird_json(path: str, content: dict[str, Any]) -> tuple[MeasuredTable, list[str], dict[str, object]]:
    """The points of a file, sentences that say what was done, and what belongs into the lineage.

    What lies out of plane is left out. A direction that stands there several times becomes as many points. Raises
    `DataFileError` where a part is missing or is not what it should be, where light changes its wavelength or is of one
    polarisation, or where nothing lies in plane.
    """
    data = _object(path, content, "data")
    _refuse_other_variables(path, data)
    brdf = _column(path, data, "BRDF", dict.fromkeys(_BRDF_UNITS, 1.0))
    u = _uncertainty(path, data, brdf)
    columns = [_column(path, data, name, _ANGLE_UNITS) for name in _ANGLES]
    columns += [_wavelengths(path, data), brdf, np.full(brdf.size, np.nan) if u is None else u]
    if len({each.size for each in columns}) > 1:
        raise DataFileError(f"{path}: the lists of values have different lengths; each needs one for every value.")
    rows, notes = _of_natural_light(path, data, np.stack(columns))
    theta_in, theta_out, inside = _in_plane(rows[:4])
    if not inside.any():
        raise DataFileError(f"{path}: no direction lies in the plane of incidence; only such are read.")
    if left := int(np.sum(~inside)):
        notes.append(f"{left} of {inside.size} values lie out of the plane of incidence and were left out.")
    if u is not None:
        notes.append("Its uncertainties are taken as standard uncertainties (k = 1), which the format does not say.")
    directions, rows = np.stack([theta_in, theta_out])[:, inside], rows[:, inside]
    grid = gridded(path, np.vstack([directions, _repeat(directions, rows[4])]), rows[4])
    table = MeasuredTable(
        grid.keys[0],
        grid.keys[1],
        grid.wavelengths,
        grid.fill(rows[5]),
        None if u is None else grid.fill(rows[6]),
        tuple(f"theta_i = {t_i:g}, theta_r = {abs(t_r):g} deg" for t_i, t_r in grid.keys[:2].T),
    )
    if mirror_is_absent(table):
        table = replace(table, theta_out=-table.theta_out)
        notes.append(
            "The file has the way back into the lamp where the mirror direction is expected to be, and nothing there; "
            "as no detector can measure that, equal azimuths were taken as the mirror side."
        )
    return table, notes, _lineage(content)


def _lineage(content: dict[str, Any]) -> dict[str, object]:
    metadata = content.get("metadata")
    if not isinstance(metadata, dict):
        return {}
    told = {name: metadata[name] for name in ("id", "timestamp", "provenance", "license", "sample") if name in metadata}
    if metadata.get("method") != "simulation":
        return {"bird": told}
    software = metadata.get("software")
    software = software if isinstance(software, dict) else {}
    model = software.get("simulation_model")
    name = model.get("name") if isinstance(model, dict) else software.get("name")
    return {"bird": told, "simulated": f"by others: {name or 'software not stated'}"}


def _of_natural_light(path: str, data: dict[str, Any], rows: FloatArray) -> tuple[FloatArray, list[str]]:
    """[theta_i, phi_i, theta_r, phi_r, wavelength, BRDF, u; values] of natural light, and a sentence where it was made.

    It is half of what two orthogonal linear polarisations of the incident light give, each taken by itself. Their
    uncertainties are taken as the same error. Raises `DataFileError` for any other polarisation, and for one that lacks
    its orthogonal.
    """
    if "polarization_r" in data and any(_linear(state) != 0 for state in _values(path, data, "polarization_r")):
        raise DataFileError(f"{path}: polarization_r is not natural light; only what passed no analyser is read.")
    if "polarization_i" not in data:
        return rows, []
    states = np.array([_linear(state) for state in _values(path, data, "polarization_i")])
    if states.size != rows.shape[1]:
        raise DataFileError(f"{path}: polarization_i has not one state for every value.")
    if not states.any():
        return rows, []
    one, other = (rows[:, states == sign] for sign in (1, -1))
    one, other = (each[:, np.lexsort(each[:5])] for each in (one, other))
    if np.isnan(states).any() or not states.all() or not np.array_equal(one[:5], other[:5]):
        raise DataFileError(
            f"{path}: polarization_i must be natural light, or for every direction both of two orthogonal linear "
            f"polarisations; leave out what is not."
        )
    told = "Each value is the mean of two orthogonal linear polarisations, which is that of natural light."
    return np.vstack([one[:5], (one[5:] + other[5:]) / 2]), [told]


def _linear(state: object) -> float:
    """1 for s or horizontal, -1 for p or vertical, 0 for natural light, NaN for any other polarisation."""
    known = (("u", [1, 0, 0, 0]), ("s", [1, 1, 0, 0]), ("p", [1, -1, 0, 0]))
    return next((sign for sign, states in zip((0.0, 1.0, -1.0), known, strict=True) if state in states), math.nan)


def _refuse_other_variables(path: str, data: dict[str, Any]) -> None:
    several = data.get("adhoc_variables", {})
    if not isinstance(several, dict):
        raise DataFileError(f"{path}: adhoc_variables must be an object.")
    for name in several:
        values = _values(path, several, name)
        if any(value != values[0] for value in values):
            raise DataFileError(
                f"{path}: its values differ in {name}, too, which a dataset does not know; split the file."
            )


def _wavelengths(path: str, data: dict[str, Any]) -> FloatArray:
    found = [_column(path, data, name, _WAVELENGTH_UNITS) for name in ("wavelength_i", "wavelength_r") if name in data]
    if not found:
        raise DataFileError(f"{path}: says no wavelength_i and no wavelength_r; a spectral BRDF needs one of them.")
    if len(found) == 2 and not np.array_equal(found[0], found[1]):
        raise DataFileError(f"{path}: wavelength_i and wavelength_r differ; fluorescence is no BRDF of one wavelength.")
    return found[0]


def _uncertainty(path: str, data: dict[str, Any], brdf: FloatArray) -> FloatArray | None:
    """[values] 1/sr; None where the file states none."""
    if "uBRDF" in data:
        part = _object(path, data, "uBRDF")
        u = _column(path, data, "uBRDF", dict.fromkeys((*_BRDF_UNITS, "%"), 1.0))
        return 0.01 * u * np.abs(brdf) if part["unit"] == "%" and u.size == brdf.size else u
    stated = _object(path, data, "BRDF").get("uncertainty")
    if stated is None:
        return None
    if not isinstance(stated, dict) or not isinstance(stated.get("value"), int | float):
        raise DataFileError(f"{path}: the uncertainty of BRDF must have a value and a unit.")
    value = float(stated["value"])
    return 0.01 * value * np.abs(brdf) if stated.get("unit") == "%" else np.full(brdf.shape, value)


def _in_plane(angles: FloatArray) -> tuple[FloatArray, FloatArray, Any]:
    """Signed theta_in and theta_out [values], degrees, from theta_i, phi_i, theta_r, phi_r, and which lie in plane."""
    theta_i, phi_i, theta_r, phi_r = np.radians(angles)
    turned = phi_r - phi_i
    inside = np.abs(np.sin(theta_i) * np.sin(theta_r) * np.sin(turned)) < _IN_PLANE
    back = np.cos(turned) > _IN_PLANE
    return angles[0], np.where(back, -angles[2], angles[2]), inside


def _repeat(directions: FloatArray, wavelength: FloatArray) -> FloatArray:
    """[values] the how-manieth value of its direction and wavelength each is, from 0, in the order of the file."""
    _, which = np.unique(np.vstack([directions, wavelength]), axis=1, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ordered = which.ravel()[order]
    new = np.concatenate([[True], np.diff(ordered) != 0])
    start = np.maximum.accumulate(np.where(new, np.arange(ordered.size), 0))
    found = np.empty(ordered.size)
    found[order] = np.arange(ordered.size) - start
    return found


def _object(path: str, parent: dict[str, Any], name: str) -> dict[str, Any]:
    found = parent.get(name)
    if not isinstance(found, dict):
        raise DataFileError(f"{path}: {name} is missing or no object, which a universal BRDF file needs.")
    return found


def _values(path: str, data: dict[str, Any], name: str) -> list[Any]:
    values = _object(path, data, name).get("values")
    if not isinstance(values, list) or not values:
        raise DataFileError(f"{path}: {name} has no list of values.")
    return values


def _column(path: str, data: dict[str, Any], name: str, units: dict[str, float]) -> FloatArray:
    """[values] of one quantity in our unit."""
    values = _values(path, data, name)
    unit = data[name].get("unit")
    if not isinstance(unit, str) or unit not in units:
        raise DataFileError(f"{path}: {name} has the unit {unit!r}; it must be one of {', '.join(units)}.")
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
        raise DataFileError(f"{path}: {name} must hold nothing but numbers.")
    try:
        return units[unit] * np.array(values, dtype=float)
    except OverflowError as error:
        raise DataFileError(f"{path}: {name} holds a number that is too large.") from error
