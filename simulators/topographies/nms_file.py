"""Height maps of NanoFocus microscopes (µsurf): .nms files of the version OM_MS_2.0, little-endian.

| byte | type | content |
|---|---|---|
| 0, 4 | i32 | 2 for heights as unsigned shorts, 1 for an area |
| 8, 12 | i32 | counts of the lowest and of the highest height |
| 16, 24 | f64 | the lowest and the highest height, um |
| 32 | text | version |
| 1368, 1372 | i32 | points along x and along y |
| 1376, 1384 | f64 | their distances along x and along y, **nm** |
| 1416 | i32 | whether an image of the intensity follows the heights |
| 3468 | u16 | counts, row by row, then u8 intensity, zero where no height was measured |

The file is read here because SurfaceTopography 1.27.1 takes the distances for millimetres, a million times too large,
and what was not measured for measured. That they are nanometres shows in the field of view: 512 points at 312.5 are
the 160 um of a common lens. surfalize 0.19.2 reads the same distances.
"""

import struct
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.errors import DataFileError

_HEADER = 3468
_VERSION = b"OM_MS_2.0"
_SHORTS_OF_AN_AREA = (2, 1)
_PITCH_NM = (10.0, 1e5)
"""Distances of points that a light microscope can have."""


def read_nms(path: Path, content: bytes) -> tuple[FloatArray, tuple[float, float]]:
    """[y, x] heights, um, NaN where none was measured, and the distances of points along x and along y, um.

    `content` is that of the file at `path`. Raises `DataFileError` for a file that is none, is cut short, or whose
    distances are not in nanometres.
    """
    if len(content) < _HEADER or content[32 : 32 + len(_VERSION)] != _VERSION:
        raise DataFileError(f"{path} is no NanoFocus file of the version {_VERSION.decode()}; export it as .sur.")
    kind = struct.unpack_from("<2i", content, 0)
    if kind != _SHORTS_OF_AN_AREA:
        raise DataFileError(f"{path} holds no area of heights as short integers (its kind is {kind[0]}, {kind[1]}).")
    counts = struct.unpack_from("<2i", content, 8)
    low, high = struct.unpack_from("<2d", content, 16)
    columns, rows = struct.unpack_from("<2i", content, 1368)
    pitch_nm = struct.unpack_from("<2d", content, 1376)
    with_intensity = struct.unpack_from("<i", content, 1416)[0] > 0
    if not all(_PITCH_NM[0] <= pitch <= _PITCH_NM[1] for pitch in pitch_nm):
        raise DataFileError(
            f"{path} states points {pitch_nm[0]:g} and {pitch_nm[1]:g} nm apart; a light microscope has "
            f"{_PITCH_NM[0]:g} to {_PITCH_NM[1]:g} nm."
        )
    if counts[0] >= counts[1] or not (np.isfinite([low, high]).all() and low <= high):
        raise DataFileError(f"{path} states heights of {low:g} to {high:g} um at {counts[0]} to {counts[1]} counts.")
    size = rows * columns
    if min(rows, columns) < 2 or len(content) < _HEADER + (3 if with_intensity else 2) * size:
        raise DataFileError(f"{path} should hold {columns} x {rows} heights, but ends before them.")
    stored = np.frombuffer(content, "<u2", size, _HEADER).astype(float)
    heights = low + (high - low) * (stored - counts[0]) / (counts[1] - counts[0])
    if with_intensity:
        heights[np.frombuffer(content, np.uint8, size, _HEADER + 2 * size) == 0] = np.nan
    return heights.reshape(rows, columns), (1e-3 * pitch_nm[0], 1e-3 * pitch_nm[1])
