"""The JSON in which Clausen et al. publish in-plane BRDFs.

An array whose first element is `{"wavelengths": [nm, ...]}`. Each of the others is one point: `{"thetaIn": deg,
"phiIn": deg, "thetaOut": deg, "phiOut": deg, "spectrum": [1/sr, ...]}`. In plane every azimuth is 0 or 180 degrees.
Both directions point away from the surface, so equal azimuths lead back towards the lamp, and opposite ones to the
mirror direction.
"""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import DataFileError
from goniometer.files.measured_table import MeasuredTable, mirror_is_absent

_ANGLES = ("thetaIn", "phiIn", "thetaOut", "phiOut")
_IN_PLANE = 1e-6
"""Sine of the azimuth up to which a direction lies in the plane."""


def read_published_json(path: str, text: str) -> tuple[MeasuredTable, list[str]]:
    """The points of the file in its order, and sentences that say what was done; `path` names it in messages.

    `null` and `NaN` in a spectrum are no value. The directions of a file are turned as a whole where its mirror
    direction is absent and the way back into the lamp is not, for only the latter cannot be measured. Raises
    `DataFileError` with the number of the offending element, from 0.
    """
    try:
        content = json.loads(text)
    except ValueError as error:
        raise DataFileError(f"{path}: is not valid JSON ({error}); see whether the file is complete.") from error
    except RecursionError as error:
        raise DataFileError(f"{path}: is nested too deeply; it must be an array of points.") from error
    if not isinstance(content, list) or not content or not isinstance(content[0], dict):
        raise DataFileError(f'{path}: must be an array that begins with {{"wavelengths": [...]}}.')
    if "wavelengths" not in content[0]:
        raise DataFileError(f'{path}, element 0: has no "wavelengths", in nm, which must stand before the points.')
    wavelengths = _numbers(path, 0, "wavelengths", content[0]["wavelengths"])
    if len(content) < 2:
        raise DataFileError(f"{path}: has wavelengths but no point; it needs at least one.")
    angles = np.empty((len(content) - 1, len(_ANGLES)))
    brdf = np.empty((len(content) - 1, wavelengths.size))
    for i, point in enumerate(content[1:], start=1):
        if not isinstance(point, dict):
            raise DataFileError(f"{path}, element {i}: must be an object with {', '.join(_ANGLES)} and spectrum.")
        missing = [name for name in (*_ANGLES, "spectrum") if name not in point]
        if missing:
            raise DataFileError(f"{path}, element {i}: {missing[0]} is missing; every point needs it.")
        angles[i - 1] = _numbers(path, i, "an angle", [point[name] for name in _ANGLES])
        spectrum = _numbers(path, i, "spectrum", point["spectrum"])
        if spectrum.size != wavelengths.size:
            raise DataFileError(
                f"{path}, element {i}: the spectrum has {spectrum.size} values, but there are {wavelengths.size} "
                f"wavelengths; it needs one for each."
            )
        brdf[i - 1] = spectrum
    theta_in, theta_out = _signed(path, angles)
    places = tuple(f"element {i}" for i in range(1, len(content)))
    table = MeasuredTable(theta_in, theta_out, wavelengths, brdf, None, places)
    if not mirror_is_absent(table):
        return table, []
    return replace(table, theta_out=-theta_out), [
        "The file has the way back into the lamp where the mirror direction is expected to be, and nothing there; as "
        "no detector can measure that, equal azimuths were taken as the mirror side."
    ]


def published_json(dataset: Dataset) -> tuple[str, list[str]]:
    """The text of such a file, and sentences about what is not in it; it holds no uncertainty and no flags.

    Points that no fit may use are left out; null is no value. Raises `DataFileError` where no point is left.
    """
    usable = np.flatnonzero(dataset.usable)
    if not usable.size:
        raise DataFileError(f"{dataset.sample}: has no point that may be exported; measure it again.")
    lines = [json.dumps({"wavelengths": dataset.wavelengths.tolist()})]
    for theta_in, theta_out, spectrum in zip(
        dataset.theta_in[usable].tolist(), dataset.theta_out[usable].tolist(), dataset.brdf[usable], strict=True
    ):
        point = {
            "thetaIn": theta_in,
            "phiIn": 0,
            "thetaOut": abs(theta_out),
            "phiOut": 0 if theta_out < 0 else 180,
            "spectrum": [value if math.isfinite(value) else None for value in spectrum.tolist()],
        }
        lines.append(json.dumps(point, allow_nan=False))
    told = ["The format holds neither uncertainties nor flags."]
    if left := dataset.theta_in.size - usable.size:
        told.append(f"{left} of {dataset.theta_in.size} points are flagged as unusable and were left out.")
    return "[\n" + ",\n".join(lines) + "\n]\n", told


def _numbers(path: str, element: int, name: str, values: Any) -> FloatArray:
    """A list of numbers, in which null is NaN."""
    if not isinstance(values, list) or not values:
        raise DataFileError(f"{path}, element {element}: {name} must be a list of numbers.")
    if any(value is not None and (isinstance(value, bool) or not isinstance(value, int | float)) for value in values):
        raise DataFileError(f"{path}, element {element}: {name} must hold nothing but numbers.")
    try:
        return np.array(values, dtype=float)
    except OverflowError as error:
        raise DataFileError(f"{path}, element {element}: {name} holds a number that is too large.") from error


def _signed(path: str, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed angles of incidence and reflection from [points, 4] thetaIn, phiIn, thetaOut, phiOut, degrees."""
    theta_in, phi_in, theta_out, phi_out = angles.T
    for name, phi in (("phiIn", phi_in), ("phiOut", phi_out)):
        outside = ~(np.abs(np.sin(np.radians(phi))) < _IN_PLANE)
        if outside.any():
            i = int(np.argmax(outside))
            raise DataFileError(
                f"{path}, element {i + 1}: {name} is {phi[i]:g} deg, which is not in the plane of incidence; it must "
                f"be 0 or 180 deg."
            )
    return theta_in * np.sign(np.cos(np.radians(phi_in))), -theta_out * np.sign(np.cos(np.radians(phi_out)))
