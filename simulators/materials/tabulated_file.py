"""Files of materials that are tables (`simulators.materials.tabulated`): a dataset in NumPy's .npz, made complete.

What a dataset lacks between its directions, such as the sector in which a detector stood in the way of the source, is
filled (`goniometer.datasets.fill`) and counted. A scan of 190 points that is known to 0.3 per cent becomes a table that
is off by 0.5 per cent between its points, the sector included (`python -m tests.benchmarks.tabulated`).
"""

import hashlib
import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import fill
from goniometer.datasets.reciprocity import rows_of
from simulators.errors import UnfitTable
from simulators.materials.tabulated import Row, Tabulated
from simulators.npz_file import read_bytes, read_npz

WIDEST_GAP = 3.0
"""Degrees of theta_out between two directions of a table from which on those in between are filled."""

_FORMAT = "goniometer material 1"

_PARTS = ("format", "name", "theta_in", "theta_out", "wavelengths", "brdf", "aperture", "filled", "origin")

_SAME = 1e-3
"""Degrees within which two directions of an incident angle are one, with the mean of both values."""


def write_tabulated(path: Path, dataset: Dataset) -> None:
    """Write the usable part of a dataset as the table of a material, NumPy's .npz; the same dataset is the same bytes.

    Raises `UnfitTable` where an incident angle has fewer than two directions or a wavelength too few values, and
    `CalibrationError` where a gap has too few points around it to be filled.
    """
    table = tabulated(dataset)
    rows = table.rows
    content = io.BytesIO()  # a file that is named otherwise than .npz would get another name
    np.savez_compressed(
        content,
        format=_FORMAT,
        name=dataset.sample,
        theta_in=np.concatenate([np.full(row.theta_out.size, row.theta_in) for row in rows]),
        theta_out=np.concatenate([row.theta_out for row in rows]),
        wavelengths=dataset.wavelengths,
        brdf=np.concatenate([row.brdf for row in rows]),
        aperture=dataset.aperture,
        filled=table.filled,
        origin=json.dumps(table.origin, sort_keys=True),
    )
    path.write_bytes(content.getvalue())


def tabulated(dataset: Dataset) -> Tabulated:
    """The usable part of a dataset as a material that is in no file; raises what `write_tabulated` raises."""
    rows, filled = _completed(dataset)
    origin = {"dataset_sha256": dataset.content_hash} | {
        name: dataset.lineage[name] for name in ("simulated", "imported", "scan") if name in dataset.lineage
    }
    return Tabulated(dataset.sample, tuple(rows), dataset.wavelengths, dataset.aperture, filled, origin, sha256="")


def _completed(dataset: Dataset) -> tuple[list[Row], int]:
    """The rows of a dataset without gaps, and how many of their directions were filled."""
    some = np.isfinite(dataset.brdf).any(axis=1)
    rows = [row for row in rows_of(dataset, dataset.usable & some) if row.points.size]
    for row in rows:
        if row.points.size < 2:
            raise UnfitTable(
                f'"{dataset.sample}" has one usable direction at theta_in = {row.theta_in:.1f} deg; a material needs '
                f"two at every incident angle."
            )
    if not rows:
        raise UnfitTable(f'"{dataset.sample}" has no usable direction; a material needs some.')
    lacking = np.flatnonzero(dataset.usable & some & ~np.isfinite(dataset.brdf).all(axis=1))
    gaps = [(row.theta_in, angle) for row in rows for angle in _in_gaps(np.sort(dataset.theta_out[row.points]))]
    wanted = np.array([*zip(dataset.theta_in[lacking], dataset.theta_out[lacking], strict=True), *gaps])
    told = fill(dataset, *wanted.T) if len(wanted) else None
    brdf = dataset.brdf.copy()
    if told is not None:
        brdf[lacking] = np.where(np.isfinite(brdf[lacking]), brdf[lacking], told.brdf[: lacking.size])
    made, filled = [], lacking.size
    for row in rows:
        # what the stages were off in theta_in is taken at the same theta_h, too
        theta_out = dataset.theta_out[row.points] - (dataset.theta_in[row.points] - row.theta_in)
        values = brdf[row.points]
        if told is not None:
            mine = np.flatnonzero((told.theta_in == row.theta_in) & np.isfinite(told.brdf).all(axis=1))
            mine = mine[mine >= lacking.size]
            theta_out = np.append(theta_out, told.theta_out[mine])
            values = np.concatenate([values, told.brdf[mine]])
            filled += mine.size
        made.append(_row(max(row.theta_in, 0.0), theta_out, values))
    unknown = ~np.isfinite(np.concatenate([row.brdf for row in made])).all(axis=0)
    if unknown.any():
        raise UnfitTable(
            f'"{dataset.sample}" has too few values at {dataset.wavelengths[unknown][0]:g} nm to fill those that it '
            f"lacks; a material needs all of them."
        )
    return made, int(filled)


def _in_gaps(theta_out: FloatArray) -> list[float]:
    """Directions between ascending ones, so many that none are further apart than `WIDEST_GAP`, degrees."""
    found: list[float] = []
    for left, right in zip(theta_out[:-1].tolist(), theta_out[1:].tolist(), strict=True):
        parts = int(np.ceil((right - left - _SAME) / WIDEST_GAP))
        found += np.linspace(left, right, max(parts, 1) + 1)[1:-1].tolist()
    return found


def _row(theta_in: float, theta_out: FloatArray, brdf: FloatArray) -> Row:
    """A row of directions in any order; what is negative is noise around zero."""
    order = np.argsort(theta_out, kind="stable")
    first = np.diff(theta_out[order], prepend=-np.inf) > _SAME
    which = np.cumsum(first) - 1
    sums = np.zeros((which[-1] + 1, brdf.shape[1]))
    np.add.at(sums, which, brdf[order])
    mean = sums / np.bincount(which)[:, None]
    return Row(theta_in, theta_out[order][first], np.maximum(mean, 0.0))


def read_tabulated(path: Path) -> Tabulated:
    """The material of a file that `write_tabulated` wrote; raises `UnfitTable` for any other."""
    try:
        content = read_bytes(path)
    except (OSError, ValueError) as error:
        told = error.strerror if isinstance(error, OSError) else error
        raise UnfitTable(
            f"{path}: the material cannot be read ({told}); write one with goniometer simulate material."
        ) from error
    try:
        if not content.startswith(b"PK"):
            raise ValueError("no .npz file")
        return _parsed(read_npz(content, _PARTS), hashlib.sha256(content).hexdigest())
    except (ValueError, KeyError, TypeError, EOFError, OSError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise UnfitTable(
            f"{path}: holds no material ({str(error) or 'it ends early'}); write one with goniometer simulate material."
        ) from error


def _parsed(stored: dict[str, Any], sha256: str) -> Tabulated:
    """A material from the arrays of its file; raises `ValueError` and what NumPy raises for what is none."""
    if str(stored["format"]) != _FORMAT:
        raise ValueError(f'its format is "{stored["format"]}" and not "{_FORMAT}"')
    theta_in, theta_out, wavelengths, brdf = (
        np.asarray(stored[name], dtype=float) for name in ("theta_in", "theta_out", "wavelengths", "brdf")
    )
    aperture, filled = float(stored["aperture"]), int(stored["filled"])
    if brdf.shape != (theta_in.size, wavelengths.size) or theta_out.shape != theta_in.shape or not brdf.size:
        raise ValueError("its arrays do not go together")
    sound = np.all(np.isfinite(brdf) & (brdf >= 0)) and np.all((theta_in >= 0) & (theta_in < 90))
    sound &= np.all(np.abs(theta_out) < 90) and np.all(wavelengths > 0) and np.all(np.diff(wavelengths) > 0)
    if not (sound and 0 <= aperture < 90):
        raise ValueError("its numbers are those of no BRDF")
    origin = json.loads(str(stored["origin"]))
    if not isinstance(origin, dict):
        raise ValueError("its origin is not told")
    rows = []
    for angle in np.unique(theta_in).tolist():
        mine: BoolArray = theta_in == angle
        if mine.sum() < 2 or np.any(np.diff(theta_out[mine]) <= 0):
            raise ValueError(f"its directions at theta_in = {angle:g} deg do not ascend")
        rows.append(Row(angle, theta_out[mine], brdf[mine]))
    return Tabulated(str(stored["name"]), tuple(rows), wavelengths, aperture, filled, origin, sha256)
