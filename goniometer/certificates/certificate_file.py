"""Files of certificates: CSV, UTF-8.

In front of the columns stand the lines `# serial_number: ...`, `# calibrated: YYYY-MM-DD` and
`# valid_until: YYYY-MM-DD`; other lines with `#` are comments. The column names tell the two kinds of certificate
apart. A laboratory usually delivers a bare table of wavelength and reflectance, and its uncertainty on paper. To make
a certificate of it, set the three lines and the line `wavelength_nm,reflectance,standard_uncertainty` before the
table, turn per cent into fractions, and give every row its third number: the expanded uncertainty on the paper
divided by its coverage factor (mostly 2), in the unit of the reflectance. Tabs may stand for the commas. Where the
paper names no last day of validity, decide on one: a year or two after the calibration is usual.
"""

import datetime
import itertools
import math
import re
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.certificates.certificate import BrdfTable, Certificate, PanelCertificate
from goniometer.errors import CertificateError

_HEADERS = ("serial_number", "calibrated", "valid_until")
_NEVER = "never"
"""Stands for the day of calibration of nominal values, which then have no last day."""
_REFLECTANCE_COLUMNS = ("wavelength_nm", "reflectance", "standard_uncertainty")
_BRDF_COLUMNS = ("theta_in", "theta_out", "wavelength_nm", "brdf", "standard_uncertainty")

_BRIGHTEST = 0.5
"""1/sr; a white panel has 1/pi, and more only where it shines towards grazing."""

_Rows = list[tuple[int, tuple[float, ...]]]
"""Line number and numbers of every row."""


def read_certificate(path: Path) -> str:
    """The text of a certificate file, unchecked; raises `CertificateError` where it is no readable text."""
    try:
        return path.read_text(encoding="utf-8-sig")  # spreadsheets begin their UTF-8 with a mark
    except OSError as error:
        raise CertificateError(f"{path}: the certificate cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise CertificateError(f"{path}: this is not a text file; a certificate is a CSV file in UTF-8") from error


def parse_certificate(text: str, path: str) -> PanelCertificate:
    """A certificate from the text of a CSV file; `path` names the file in messages.

    Below the header lines stand the column names `wavelength_nm,reflectance,standard_uncertainty` and wavelengths in
    ascending order for a `Certificate`, or `theta_in,theta_out,wavelength_nm,brdf,standard_uncertainty` (degrees, nm,
    1/sr) and a complete grid in any order for a `BrdfTable`. `# calibrated: never` without a `valid_until` marks
    nominal values. Raises `CertificateError`, with the number of the offending line where one line is at fault.
    """
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    serial_number, calibrated, valid_until = _read_headers(path, [line for line in lines if line[1].startswith("#")])
    columns, rows = _read_table(path, [line for line in lines if not line[1].startswith("#")])
    if columns == _REFLECTANCE_COLUMNS:
        return Certificate(serial_number, calibrated, valid_until, *_reflectance_columns(path, rows))
    return BrdfTable(serial_number, calibrated, valid_until, *_brdf_grid(path, rows))


def certificate_csv(certificate: PanelCertificate) -> str:
    """The text that `parse_certificate` makes this certificate of, to the last bit."""
    lines = [f"# serial_number: {certificate.serial_number}", f"# calibrated: {certificate.calibrated or _NEVER}"]
    if certificate.valid_until is not None:
        lines.append(f"# valid_until: {certificate.valid_until}")
    if isinstance(certificate, Certificate):
        lines.append(",".join(_REFLECTANCE_COLUMNS))
        table = [certificate.wavelengths, certificate.reflectance_8h, certificate.u_reflectance]
    else:
        lines.append(",".join(_BRDF_COLUMNS))
        grid = np.meshgrid(certificate.theta_in, certificate.theta_out, certificate.wavelengths, indexing="ij")
        table = [column.ravel() for column in (*grid, certificate.values, certificate.u_values)]
    lines += [",".join(map(repr, row)) for row in zip(*(column.tolist() for column in table), strict=True)]
    return "\n".join(lines) + "\n"


def _read_headers(path: str, lines: list[tuple[int, str]]) -> tuple[str, datetime.date | None, datetime.date | None]:
    """Serial number, day of calibration and last day; comments other than these are passed over."""
    headers: dict[str, tuple[int, str]] = {}
    for number, line in lines:
        name, _, value = (part.strip(", \t") for part in line[1:].partition(":"))  # spreadsheets fill up with commas
        if name not in _HEADERS:
            continue
        if not value:
            raise CertificateError(f"{path}, line {number}: {name} has no value")
        if name in headers:
            raise CertificateError(f"{path}, line {number}: {name} stands in line {headers[name][0]} already")
        headers[name] = number, value
    nominal = headers.get("calibrated", (0, ""))[1] == _NEVER
    missing = [name for name in _HEADERS[: 2 if nominal else 3] if name not in headers]
    if missing:
        raise CertificateError(f"{path}: a line '# {missing[0]}: ...' is missing before the columns")
    if nominal:
        if "valid_until" in headers:
            raise CertificateError(
                f"{path}, line {headers['valid_until'][0]}: what was never calibrated has no valid_until"
            )
        return headers["serial_number"][1], None, None
    calibrated, valid_until = (_date(path, *headers[name]) for name in ("calibrated", "valid_until"))
    if valid_until < calibrated:
        raise CertificateError(
            f"{path}, line {headers['valid_until'][0]}: valid until {valid_until}, which is before the calibration "
            f"on {calibrated}"
        )
    return headers["serial_number"][1], calibrated, valid_until


def _date(path: str, number: int, text: str) -> datetime.date:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError as error:
        raise CertificateError(f"{path}, line {number}: '{text}' is not a day; write it as YYYY-MM-DD") from error


def _read_table(path: str, lines: list[tuple[int, str]]) -> tuple[tuple[str, ...], _Rows]:
    """The column names and the rows of numbers below them, each as long as these."""
    columns = tuple(name.strip() for name in re.split("[,\t]", lines[0][1])) if lines else ()
    if columns not in (_REFLECTANCE_COLUMNS, _BRDF_COLUMNS):
        raise CertificateError(
            f"{path}, line {lines[0][0] if lines else 1}: the columns must be '{','.join(_REFLECTANCE_COLUMNS)}' or "
            f"'{','.join(_BRDF_COLUMNS)}'"
        )
    if len(lines) < 3:
        raise CertificateError(f"{path}, line {lines[-1][0]}: at least two rows of wavelengths are needed after it")
    rows: _Rows = []
    for number, line in lines[1:]:
        try:
            row = tuple(float(cell) for cell in re.split("[,\t]", line))
        except ValueError:
            row = ()
        if len(row) != len(columns):
            raise CertificateError(
                f"{path}, line {number}: '{line}' must be {len(columns)} numbers with commas between"
            )
        rows.append((number, row))
    return columns, rows


def _reflectance_columns(path: str, rows: _Rows) -> FloatArray:
    """[columns, rows] the checked table of a `Certificate`."""
    previous = 0.0
    for number, (wavelength, reflectance, uncertainty) in rows:
        if not previous < wavelength < math.inf:
            raise CertificateError(
                f"{path}, line {number}: {wavelength:g} nm is out of order; wavelengths must increase from row to row"
            )
        if not 0 < reflectance <= 1.05:
            raise CertificateError(
                f"{path}, line {number}: reflectance {reflectance:g} is impossible; it is a fraction between 0 and 1"
            )
        if not 0 <= uncertainty < 1:
            raise CertificateError(
                f"{path}, line {number}: standard uncertainty {uncertainty:g} is impossible; it is absolute, in the "
                "unit of the reflectance"
            )
        previous = wavelength
    return np.array([row for _, row in rows]).T


def _brdf_grid(path: str, rows: _Rows) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The three axes and both grids of a `BrdfTable`."""
    line_of: dict[tuple[float, ...], int] = {}
    for number, (theta_in, theta_out, wavelength, brdf, uncertainty) in rows:
        place = f"{path}, line {number}"
        if not (0 <= theta_in < 90 and -90 < theta_out < 90):
            raise CertificateError(
                f"{place}: theta_in = {theta_in:g} and theta_out = {theta_out:g} deg are no directions of the panel; "
                "they lie from 0 to 90 and between -90 and 90 deg"
            )
        if not 0 < wavelength < math.inf:
            raise CertificateError(f"{place}: {wavelength:g} nm is no wavelength; it must be above 0")
        if not 0 < brdf < math.inf:
            raise CertificateError(f"{place}: a BRDF of {brdf:g} 1/sr is impossible; it must be above 0")
        if not 0 <= uncertainty < brdf:
            raise CertificateError(
                f"{place}: standard uncertainty {uncertainty:g} is impossible; it is absolute, in 1/sr like the BRDF"
            )
        cell = theta_in, theta_out, wavelength
        if cell in line_of:
            raise CertificateError(f"{place}: the same angles and wavelength stand in line {line_of[cell]} already")
        line_of[cell] = number
    table = np.array([row for _, row in rows])
    axes = [np.unique(column) for column in table[:, :3].T]
    for name, axis in zip(_BRDF_COLUMNS, axes, strict=False):
        if len(axis) < 2:
            raise CertificateError(f"{path}: the column {name} has only the value {axis[0]:g}; two are needed at least")
    for cell in itertools.product(*(axis.tolist() for axis in axes)):
        if cell not in line_of:
            raise CertificateError(
                f"{path}: the row theta_in = {cell[0]:g} deg, theta_out = {cell[1]:g} deg, {cell[2]:g} nm is missing; "
                "the rows must make a complete grid"
            )
    if table[:, 3].min() > _BRIGHTEST:
        raise CertificateError(
            f"{path}: no BRDF is below {_BRIGHTEST:g} 1/sr, which no panel can have; divide radiance factors by pi"
        )
    values, u_values = table[np.lexsort(table[:, 2::-1].T), 3:].T.reshape(2, *map(len, axes))
    return axes[0], axes[1], axes[2], values, u_values
