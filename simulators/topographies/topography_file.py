"""Topographies from files: what microscopes write, and the `.npz` of `goniometer simulate surface --output`.

A measured map is levelled by least squares, what it lacks is filled as by a membrane, and where its points are not
equally far apart along x and y it is interpolated to the finer distance with cubic splines. Each of these stands in the
origin of the topography.
"""

import hashlib
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np
import scipy

from drivers.arrays import FloatArray
from goniometer.errors import DataFileError
from simulators.npz_file import read_bytes, read_npz
from simulators.topographies.heights import HeightField, filled, levelled
from simulators.topographies.nms_file import read_nms

ALIKE = 1e-4
"""Relative difference up to which distances along x and y count as equal; scales of microscopes are no better."""

MOST_MISSING = 0.5
"""Share of heights that may be missing; what remains of a map that lacks more is no surface."""

_MOST_UNEQUAL = 10.0
"""How many times further apart points may be along x than along y, or the other way round."""

_UNREADABLE = (
    OSError,
    ValueError,
    LookupError,
    ArithmeticError,
    TypeError,
    AttributeError,
    AssertionError,
    EOFError,
    RuntimeError,
    SyntaxError,
    MemoryError,
)
"""What the readers of other formats raise for files that they do not understand, besides their own errors."""


def read_topography(path: Path) -> tuple[HeightField, dict[str, object]]:
    """The complete, levelled height map in a file, and how it was obtained, for the lineage of what is computed.

    Raises `DataFileError` for a file that cannot be read, that has no map of heights, or that leaves its units open,
    and if SurfaceTopography, which reads all formats but .nms and .npz, is not installed; `UnfitTopography` for a map
    of fewer than three heights.
    """
    try:
        content = read_bytes(path)
    except OSError as error:
        raise DataFileError(f"{path} cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise DataFileError(f"{path} cannot be read: {error}.") from None
    origin: dict[str, object] = {"file": path.name, "sha256": hashlib.sha256(content).hexdigest()}
    suffix = path.suffix.lower()
    if suffix == ".npz":
        field = _read_npz(path, content)
        heights, pitches, periodic = field.heights_um, (field.pitch_um, field.pitch_um), field.periodic
    else:
        heights, pitches = read_nms(path, content) if suffix == ".nms" else _read_others(path)
        periodic = False
    if not 1 / _MOST_UNEQUAL <= pitches[0] / pitches[1] <= _MOST_UNEQUAL:
        raise DataFileError(
            f"{path} states points {pitches[0]:g} um apart along x and {pitches[1]:g} um along y; "
            f"at most {_MOST_UNEQUAL:g} times as far along one as along the other is read."
        )
    missing = float(np.isnan(heights).mean())
    if missing > MOST_MISSING:
        raise DataFileError(
            f"{path} lacks {100 * missing:.0f} % of its heights; at most {100 * MOST_MISSING:.0f} % can be filled."
        )
    rows, columns = heights.shape
    pitch = min(pitches)
    # Neither levelling nor filling asks how far the points are apart.
    field = filled(levelled(HeightField(heights, pitch, periodic)))
    steps = ["mean removed" if periodic else "levelled by a least-squares plane"]
    if missing:
        steps.append(f"{100 * missing:.2g} % of the heights were missing and were filled as by a membrane")
    if abs(pitches[0] / pitches[1] - 1) > ALIKE:
        field = HeightField(_resampled(field.heights_um, pitches), pitch, periodic)
        steps.append(f"interpolated by cubic splines from {pitches[0]:.6g} x {pitches[1]:.6g} um to {pitch:.6g} um")
    return field, origin | {
        "points": [columns, rows],
        "pitch_um": [float(p) for p in pitches],
        "missing": missing,
        "periodic": periodic,
        "steps": steps,
    }


def write_topography(path: Path, field: HeightField) -> None:
    """Write a height map to a NumPy archive: `heights_um` [y, x], `pitch_um` and `periodic`."""
    with path.open("wb") as file:
        np.savez_compressed(file, heights_um=field.heights_um, pitch_um=field.pitch_um, periodic=field.periodic)


def _read_npz(path: Path, content: bytes) -> HeightField:
    """The height map that `write_topography` wrote."""
    wanted = "heights_um [y, x], pitch_um and periodic"
    try:
        heights, pitch, periodic = read_npz(content, ("heights_um", "pitch_um", "periodic")).values()
    except (zipfile.BadZipFile, zlib.error, tokenize.TokenError, *_UNREADABLE) as error:
        raise DataFileError(f"{path} is no NumPy archive with {wanted}.") from error
    if heights.dtype.kind not in "fiu" or pitch.shape or pitch.dtype.kind not in "fiu" or periodic.shape:
        raise DataFileError(f"{path} should hold {wanted}: numbers, one number, and true or false.")
    return HeightField(np.asarray(heights, dtype=float), float(pitch), bool(periodic))


def _read_others(path: Path) -> tuple[FloatArray, tuple[float, float]]:
    """[y, x] heights, um, NaN where none was measured, and distances along x and y, um, as SurfaceTopography reads."""
    try:
        from SurfaceTopography import open_topography  # noqa: PLC0415  (an extra, and slow to import)
        from SurfaceTopography.Exceptions import ReadFileError  # noqa: PLC0415
    except ImportError as error:
        raise DataFileError(
            f'{path} is read with SurfaceTopography, which is not installed; try: pip install "goniometer[topography]".'
        ) from error
    try:
        with open_topography(str(path)) as reader:
            channel = next((c for c in reader.channels if c.dim == 2 and c.is_height_channel), None)
            if channel is None:
                raise DataFileError(f"{path} holds no map of heights.")
            if channel.unit is None or channel.physical_sizes is None:
                raise DataFileError(f"{path} does not say how large its map is, or in which unit its heights are.")
            if not channel.is_uniform and channel.is_uniform is not None:
                raise DataFileError(f"{path} has points that lie on no grid.")
            read = channel.topography().to_unit("µm")
            heights: FloatArray = np.ma.filled(np.ma.asarray(read.heights(), dtype=float), np.nan)
    except (ReadFileError, struct.error, zipfile.BadZipFile, zlib.error, *_UNREADABLE) as error:
        raise DataFileError(f"{path} is in no format that SurfaceTopography reads, or is damaged.") from error
    x, y = (float(size) / points for size, points in zip(read.physical_sizes, heights.shape, strict=True))
    return np.ascontiguousarray(heights.T), (x, y)


def _resampled(heights: FloatArray, pitches: tuple[float, float]) -> FloatArray:
    """[y, x] heights at the smaller of both pitches, along x and y, by cubic splines."""
    axis, coarse = (1, pitches[0]) if pitches[0] > pitches[1] else (0, pitches[1])
    places = coarse * np.arange(heights.shape[axis])
    wanted = np.arange(0, places[-1] * (1 + 1e-12), min(pitches))
    spline = scipy.interpolate.make_interp_spline(places, heights, k=min(3, places.size - 1), axis=axis)
    return np.asarray(spline(np.minimum(wanted, places[-1])))
