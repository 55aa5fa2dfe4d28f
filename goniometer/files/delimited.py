"""Tables of other people's BRDFs as delimited text: CSV with commas or semicolons, TSV with tabs.

Wide: columns `theta_in`, `theta_out`, and one for each wavelength, named by its number. Long: columns `theta_in`,
`theta_out`, `wavelength`, `brdf` and, where it is known, `standard_uncertainty`; one value a row. Columns may stand in
any order; lines with `#` are comments. With semicolons or tabs a comma is a decimal comma. What no table says, and
nobody should guess, are its units and what its values are: `Meaning` is asked of the person who has it. Angles are
signed: the mirror direction is `theta_out = theta_in`.
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import FloatArray
from goniometer.choices import Quantity
from goniometer.errors import DataFileError
from goniometer.files.measured_table import MeasuredTable, gridded

_ANGLES = ("theta_in", "theta_out")
_LONG = (*_ANGLES, "wavelength", "brdf")
_UNCERTAINTY = "standard_uncertainty"
_NO_VALUE = {"", "nan", "na", "n/a", "null", "-"}


@dataclass(frozen=True)
class Meaning:
    """What the numbers of a table are."""

    quantity: Quantity
    angle_unit: Literal["deg", "rad"]
    wavelength_unit: Literal["nm", "um"]

    def as_brdf(self, values: FloatArray, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """[points, wavelengths] `values` as BRDF, 1/sr; angles [points] in degrees."""
        if self.quantity == "brdf-cos-in":
            return values / np.cos(np.radians(theta_in))[:, None]
        if self.quantity == "brdf-cos-out":
            return values / np.cos(np.radians(theta_out))[:, None]
        return values / math.pi if self.quantity == "radiance-factor" else values


def read_delimited(path: str, text: str, meaning: Meaning) -> MeasuredTable:
    """The points of a table in its order; `path` names the file in messages.

    A cell that is empty or says NaN is no value. Raises `DataFileError` with the number of the offending line.
    """
    lines = [(i, line) for i, line in enumerate(text.split("\n"), start=1) if line.strip() and line.strip()[0] != "#"]
    if not lines:
        raise DataFileError(f"{path}: is empty; it needs a line of column names and rows of numbers.")
    number, header = lines[0]
    delimiter = next((mark for mark in "\t;" if mark in header), ",")
    names = [name.strip().strip('"').lower() for name in header.split(delimiter)]
    name, times = Counter(names).most_common(1)[0]
    if times > 1:
        raise DataFileError(f'{path}, line {number}: the column "{name[:60]}" occurs twice; keep one of the two.')
    for name in _ANGLES:
        if name not in names:
            raise DataFileError(
                f"{path}, line {number}: there is no column {name}; the columns must be theta_in, theta_out and the "
                f"wavelengths, or {', '.join(_LONG)}."
            )
    if len(lines) < 2:
        raise DataFileError(f"{path}, line {number}: no row of numbers follows; it needs at least one.")
    rows = np.array([_row(path, i, line, delimiter, len(names)) for i, line in lines[1:]])
    angles = rows[:, [names.index(name) for name in _ANGLES]]
    bad = np.isnan(angles).any(axis=1)
    if bad.any():
        raise DataFileError(f"{path}, line {lines[1 + int(np.argmax(bad))][0]}: a row without angles has no direction.")
    theta_in, theta_out = (np.degrees(angles) if meaning.angle_unit == "rad" else angles).T
    scale = 1000.0 if meaning.wavelength_unit == "um" else 1.0
    where = [i for i, _ in lines[1:]]
    if "wavelength" in names:
        return _long(path, names, number, rows, where, (theta_in, theta_out), scale, meaning)
    others = [i for i, name in enumerate(names) if name not in _ANGLES]
    if not others:
        raise DataFileError(f"{path}, line {number}: no column of values follows theta_in and theta_out.")
    wavelengths = scale * np.array([_wavelength(path, number, names[i], delimiter) for i in others])
    values = meaning.as_brdf(rows[:, others], theta_in, theta_out)
    return MeasuredTable(theta_in, theta_out, wavelengths, values, None, tuple(f"line {i}" for i in where))


def _wavelength(path: str, line: int, name: str, delimiter: str) -> float:
    try:
        return float(_with_point(name, delimiter))
    except ValueError as error:
        raise DataFileError(
            f'{path}, line {line}: the column "{name}" is no wavelength; beside theta_in and theta_out a table has '
            f"columns named by a number, or the columns {', '.join(_LONG[2:])}, {_UNCERTAINTY}."
        ) from error


def _with_point(cell: str, delimiter: str) -> str:
    return cell if delimiter == "," or "." in cell else cell.replace(",", ".")


def _row(path: str, number: int, line: str, delimiter: str, width: int) -> list[float]:
    cells = line.split(delimiter)
    if len(cells) != width:
        raise DataFileError(f"{path}, line {number}: has {len(cells)} cells, but there are {width} columns.")
    try:
        if "_" not in line:
            return [float(cell) for cell in cells]
    except ValueError:
        pass
    return [_cell(path, number, cell.strip().strip('"'), delimiter) for cell in cells]


def _cell(path: str, number: int, cell: str, delimiter: str) -> float:
    if cell.lower() in _NO_VALUE:
        return math.nan
    try:
        if "_" in cell:  # Python reads 1_5 as 15
            raise ValueError(cell)
        return float(_with_point(cell, delimiter))
    except ValueError as error:
        raise DataFileError(
            f'{path}, line {number}: "{cell}" is no number; leave a cell empty for no value.'
        ) from error


def _long(
    path: str,
    names: list[str],
    header: int,
    rows: FloatArray,
    where: list[int],
    angles: tuple[FloatArray, FloatArray],
    scale: float,
    meaning: Meaning,
) -> MeasuredTable:
    """A table of one value a row; `where` [rows] are line numbers."""
    if odd := [name for name in names if name not in {*_LONG, _UNCERTAINTY}] or [n for n in _LONG if n not in names]:
        raise DataFileError(
            f'{path}, line {header}: "{odd[0]}" is unknown or missing; a table with a column wavelength has the '
            f"columns {', '.join(_LONG)} and perhaps {_UNCERTAINTY}."
        )
    column = {name: rows[:, i] for i, name in enumerate(names)}
    grid = gridded(path, np.stack(angles), column["wavelength"])
    order = np.argsort(grid.cell, kind="stable")
    twice = np.flatnonzero(np.diff(grid.cell[order]) == 0)
    if twice.size:
        one, other = where[order[twice[0]]], where[order[twice[0] + 1]]
        raise DataFileError(
            f"{path}, line {other}: the same angles and wavelength stand in line {one} already; keep one of the two."
        )

    brdf, u = (
        meaning.as_brdf(grid.fill(column[name]), *grid.keys) if name in names else None
        for name in ("brdf", _UNCERTAINTY)
    )
    assert brdf is not None  # checked with the names
    places = tuple(f"line {where[i]}" for i in grid.first)
    return MeasuredTable(grid.keys[0], grid.keys[1], scale * grid.wavelengths, brdf, u, places)
