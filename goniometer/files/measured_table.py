"""A BRDF that somebody else measured, as it is read from a file, and how it is put in order.

Nothing is invented and nothing vanishes in silence: what is turned, left out or doubtful is said in a sentence, and
what cannot be meant is refused.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import DataFileError
from goniometer.geometry import BLOCKED_HALF_WIDTH
from goniometer.uncertainty import ErrorSource, Groups

LARGEST_FILE = 100_000_000
"""Bytes above which a file is refused; what is read needs about ten times as much memory."""

SHORTEST, LONGEST = 100.0, 20_000.0
"""Wavelengths between which a BRDF may be meant, nm."""

DIGITS = 9
"""Decimals of an angle in degrees that are kept."""

LEAST_FILLED = 0.5
"""Part of all combinations of direction and wavelength that rows of one value each must have."""

_FAR = 20.0
"""Incident angle, degrees, from which on mirror direction and way back are told apart."""


@dataclass(frozen=True)
class MeasuredTable:
    """What a file holds; points first, wavelengths last."""

    theta_in: FloatArray
    """[points] degrees; signed until `tidied`."""
    theta_out: FloatArray
    """[points] degrees, signed: the mirror direction is `theta_out = theta_in`."""
    wavelengths: FloatArray
    """[wavelengths] nanometres."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr; NaN where there is no value."""
    u: FloatArray | None
    """[points, wavelengths] combined standard uncertainty (coverage factor 1) that the file states, 1/sr; else None."""
    places: tuple[str, ...]
    """[points] where each point stands in the file, e.g. "line 17"."""
    errors: tuple[ErrorSource, ...] = ()
    """What else is known to make the values uncertain."""

    def take(self, points: Groups | BoolArray) -> "MeasuredTable":
        """Some of the points, by their numbers or as a mask."""
        chosen = np.arange(self.theta_in.size)[points]
        return replace(
            self,
            theta_in=self.theta_in[chosen],
            theta_out=self.theta_out[chosen],
            brdf=self.brdf[chosen],
            u=None if self.u is None else self.u[chosen],
            places=tuple(self.places[i] for i in chosen),
            errors=tuple(
                replace(e, values=e.values[chosen], groups=None if e.groups is None else e.groups[chosen])
                for e in self.errors
            ),
        )

    def take_wavelengths(self, chosen: Groups) -> "MeasuredTable":
        """Some of the wavelengths, by their numbers."""
        return replace(
            self,
            wavelengths=self.wavelengths[chosen],
            brdf=self.brdf[:, chosen],
            u=None if self.u is None else self.u[:, chosen],
            errors=tuple(replace(e, values=e.values[:, chosen]) for e in self.errors),
        )


def read_text(path: Path) -> tuple[str, bytes]:
    """Text, as `as_text` has it, and content of a file; raises `DataFileError` as `read_content` and `as_text` do."""
    content = read_content(path)
    return as_text(str(path), content), content


def read_content(path: Path) -> bytes:
    """Content of a file; raises `DataFileError` where it cannot be read, or is larger than `LARGEST_FILE`."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise DataFileError(f"{path}: cannot be read ({error.strerror}); name an existing file.") from error
    if len(content) > LARGEST_FILE:
        raise DataFileError(
            f"{path}: is larger than {LARGEST_FILE / 1e6:.0f} MB, which is more than is read at once; leave out "
            f"wavelengths, or split it by incident angles."
        )
    return content


def as_text(path: str, content: bytes) -> str:
    """Content as text; a byte order mark is taken off, and all line ends become the same.

    `path` names the file in messages. Raises `DataFileError` where it is no text.
    """
    encoding = "utf-16" if content[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataFileError(f"{path}: is no text in UTF-8; save it as such.") from error
    if "\0" in text:
        raise DataFileError(f"{path}: is no text but a binary file; name a file of a format that is read.")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def tidied(path: str, table: MeasuredTable, lowest: float, highest: float) -> tuple[MeasuredTable, list[str]]:
    """The table with ascending wavelengths from `lowest` to `highest` nm and points in the order of their angles.

    Incident angles become positive: the plane is turned by half a turn, under which an isotropic surface looks the
    same. Points that stand in the file twice with the same values are taken once; measured twice, they stay two. Also
    sentences that say what was done. `path` names the file in messages. Raises `DataFileError` for angles and
    wavelengths that cannot be meant, infinite values, and a table without any value.
    """
    _check_wavelengths(path, table.wavelengths)
    _check_points(path, table)
    notes: list[str] = []
    chosen = np.argsort(table.wavelengths)
    chosen = chosen[(table.wavelengths[chosen] >= lowest) & (table.wavelengths[chosen] <= highest)]
    if chosen.size == 0:
        raise DataFileError(
            f"{path}: has no wavelength from {lowest:g} to {highest:g} nm; it covers {table.wavelengths.min():g} to "
            f"{table.wavelengths.max():g} nm."
        )
    if left := table.wavelengths.size - chosen.size:
        notes.append(f"{left} of {table.wavelengths.size} wavelengths were left out, as asked for.")
    table = table.take_wavelengths(chosen)
    empty = np.asarray(~np.isfinite(table.brdf).any(axis=1))
    if empty.all():
        raise DataFileError(f"{path}: has no value at any point; a BRDF needs numbers.")
    unmeasured = ~np.isfinite(table.brdf).any(axis=0)
    if unmeasured.any():
        which = ", ".join(f"{wavelength:g} nm" for wavelength in table.wavelengths[unmeasured][:3])
        more = " and others" if unmeasured.sum() > 3 else ""
        notes.append(f"At {which}{more} no point has a value; left out.")
        table = table.take_wavelengths(np.flatnonzero(~unmeasured))
    if empty.any():
        notes.append(f"{_count(empty.sum())} without any value {_was(empty.sum())} left out.")
        table = table.take(~empty)
    if missing := int(np.isnan(table.brdf).sum()):
        notes.append(f"{missing} of {table.brdf.size} values are missing and stay so.")
    turned = table.theta_in < 0
    if turned.any():
        notes.append(
            f"{_count(turned.sum())} with a negative incident angle {_was(turned.sum())} turned by half a turn: the "
            "sample is taken as isotropic."
        )
    side = np.where(turned, -1.0, 1.0)
    # what radians leave of a right angle is none, and adding zero takes the sign off a negative one
    theta_in, theta_out = (np.round(side * angle, DIGITS) + 0.0 for angle in (table.theta_in, table.theta_out))
    table = replace(table, theta_in=theta_in, theta_out=theta_out)
    table, repeated = _without_copies(table.take(np.lexsort((table.theta_out, table.theta_in))))
    if repeated:
        notes.append(
            f"{_count(repeated)} stood in the file twice with the same values and {_was(repeated)} taken once."
        )
    return table, [*notes, *_unit_of_angles(table), *_which_side(table)]


def _check_wavelengths(path: str, wavelengths: FloatArray) -> None:
    odd = wavelengths[~(wavelengths > 0) | ~np.isfinite(wavelengths)]
    if odd.size:
        raise DataFileError(f"{path}: {odd[0]:g} nm is no wavelength; it must be above 0.")
    low, high = float(wavelengths.min()), float(wavelengths.max())
    if low < SHORTEST or high > LONGEST:
        raise DataFileError(
            f"{path}: the wavelengths reach from {low:g} to {high:g} nm, but lie between {SHORTEST:g} and {LONGEST:g} "
            f"nm for any BRDF; see whether they are given in another unit."
        )
    values, times = np.unique(wavelengths, return_counts=True)
    if times.max() > 1:
        raise DataFileError(f"{path}: the wavelength {values[times.argmax()]:g} nm occurs twice; keep one of the two.")


def _check_points(path: str, table: MeasuredTable) -> None:
    bad = ~((np.abs(table.theta_in) < 90) & (np.abs(table.theta_out) < 90))
    if bad.any():
        i = int(np.argmax(bad))
        raise DataFileError(
            f"{path}, {table.places[i]}: theta_in = {table.theta_in[i]:g} and theta_out = {table.theta_out[i]:g} deg "
            f"are no directions above the surface; both lie between -90 and 90 deg."
        )
    bad = np.asarray(np.isinf(table.brdf).any(axis=1))
    if bad.any():
        raise DataFileError(
            f"{path}, {table.places[int(np.argmax(bad))]}: a BRDF cannot be infinite; leave out what was not measured."
        )
    if table.u is not None:
        bad = np.asarray((np.isfinite(table.brdf) & ~((table.u >= 0) & np.isfinite(table.u))).any(axis=1))
        if bad.any():
            raise DataFileError(
                f"{path}, {table.places[int(np.argmax(bad))]}: a value has no standard uncertainty, or a negative one; "
                f"state it for every value, in 1/sr, or leave out the column."
            )


def _without_copies(table: MeasuredTable) -> tuple[MeasuredTable, int]:
    """The sorted table without points that repeat the one before them number by number, and how many these were."""
    same = (np.diff(table.theta_in) == 0) & (np.diff(table.theta_out) == 0)
    copies = np.zeros(table.theta_in.size, dtype=bool)
    for i in np.flatnonzero(same) + 1:
        copies[i] = np.array_equal(table.brdf[i], table.brdf[i - 1], equal_nan=True)
    return table.take(~copies), int(copies.sum())


def _unit_of_angles(table: MeasuredTable) -> list[str]:
    """A doubt where all angles together are no more than a right angle in radians."""
    largest = float(np.max(np.abs([table.theta_in, table.theta_out])))
    if not 0 < largest <= math.pi / 2:
        return []
    return [f"No angle is larger than {largest:.2g} deg; if the file gives them in radians, import it again as such."]


def _which_side(table: MeasuredTable) -> list[str]:
    """A doubt where more light seems to go back into the lamp than into the mirror direction."""
    angles = np.unique(table.theta_in[table.theta_in >= _FAR])
    back = 0
    level = np.nanmedian(table.brdf, axis=1)
    for angle in angles:
        here = table.theta_in == angle
        forward, backward = here & (table.theta_out > 0), here & (table.theta_out < 0)
        back += bool(forward.any() and backward.any() and level[backward].max() > level[forward].max())
    if 2 * back <= angles.size:
        return []
    return [
        "At most incident angles the brightest direction lies on the side of the lamp; if the file counts theta_out "
        "the other way round, change its sign and import it again."
    ]


@dataclass(frozen=True)
class Grid:
    """Rows of one value each, put in order: every direction at every wavelength."""

    keys: FloatArray
    """[keys, points] what tells points apart, e.g. theta_in and theta_out, degrees."""
    wavelengths: FloatArray
    """[wavelengths] ascending, in the unit of the rows."""
    cell: Groups
    """[rows] place of each row in the flattened grid."""
    first: Groups
    """[points] number of the first row of each point."""

    def fill(self, values: FloatArray) -> FloatArray:
        """[points, wavelengths] the [rows] `values`; NaN where there is no row."""
        grid = np.full((self.keys.shape[1], self.wavelengths.size), np.nan)
        grid.ravel()[self.cell] = values
        return grid


def gridded(path: str, keys: FloatArray, wavelengths: FloatArray) -> Grid:
    """The grid of rows with [keys, rows] `keys` and [rows] `wavelengths`; `path` names the file in messages.

    Raises `DataFileError` where less than `LEAST_FILLED` of the grid would have a value.
    """
    points, first, of_point = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    columns, of_wavelength = np.unique(wavelengths, return_inverse=True)
    if wavelengths.size < LEAST_FILLED * points.shape[1] * columns.size:
        raise DataFileError(
            f"{path}: {wavelengths.size} rows are less than half of {points.shape[1]} directions times {columns.size} "
            f"wavelengths; bring all spectra to the same wavelengths first."
        )
    return Grid(points, columns, of_point.ravel() * columns.size + of_wavelength.ravel(), first)


def mirror_is_absent(table: MeasuredTable) -> bool:
    """Whether the mirror direction is missing at every large incident angle, where the way back was measured.

    A detector stands in its own light on the way back into the lamp, never in the mirror direction.
    """
    far = np.abs(table.theta_in) >= _FAR
    near_mirror = np.abs(table.theta_out - table.theta_in) < BLOCKED_HALF_WIDTH / 2
    near_lamp = np.abs(table.theta_out + table.theta_in) < BLOCKED_HALF_WIDTH / 2
    return bool((far & near_lamp).any() and not (far & near_mirror).any())


def _count(number: int) -> str:
    return "1 point" if number == 1 else f"{number} points"


def _was(number: int) -> str:
    return "was" if number == 1 else "were"
