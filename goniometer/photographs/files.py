"""Photographs as numbers proportional to the light: raw files of cameras, and TIFFs.

Of a raw file the counts of the sensor are read as they are, below the camera's white balance, tone curve and colours: a
pixel here is a square of the colour filter with its red, two green and blue sites, so nothing is interpolated and an
image has half the pixels along each side. The camera's orientation is left alone.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import BoolArray
from goniometer.errors import DataFileError, InputError
from goniometer.photographs.series import Series

Pixels = NDArray[np.float32]

_TIFF = {".tif", ".tiff"}
_LARGEST = 2_000_000_000
"""Bytes of a picture, unpacked; a camera of 150 megapixels has half of it."""


@dataclass(frozen=True)
class Frame:
    """What one file holds."""

    light: Pixels
    """[y, x, 3] red, green, blue, in proportion to the light: 0 without, 1 where the pixel is saturated. Noise makes
    some values negative."""
    saturated: BoolArray
    """[y, x] whether any of its channels is saturated, so that the pixel may have been brighter."""


def read_frame(path: Path, series: Series) -> Frame:
    """Of a raw file or a TIFF of `series`.

    Raises `DataFileError` for a file that cannot be read as such, and `InputError` where the extra is not installed.
    """
    if not path.is_file():
        raise DataFileError(f"{path}: there is no such file, but the series lists it.")
    return _read_tiff(path, series) if path.suffix.lower() in _TIFF else _read_raw(path)


def write_tiff(path: Path, counts: NDArray[np.uint16]) -> None:
    """Write [y, x, 3] counts as a TIFF; raises `InputError` where the extra is not installed."""
    try:
        import tifffile  # noqa: PLC0415  (an optional extra)
    except ImportError:
        raise _extra_missing("tifffile") from None
    tifffile.imwrite(path, counts, photometric="rgb")


def _read_tiff(path: Path, series: Series) -> Frame:
    try:
        import tifffile  # noqa: PLC0415  (an optional extra)
    except ImportError:
        raise _extra_missing("tifffile") from None
    if series.encoding is None:
        raise DataFileError(
            f'{path}: a TIFF does not say what its numbers are; write encoding = "linear" or encoding = "srgb" into '
            f"the series."
        )
    try:
        with tifffile.TiffFile(path) as file:
            stated = file.series[0]
            if stated.size * stated.dtype.itemsize > _LARGEST:
                raise ValueError(f"it states a picture of {stated.shape} values, more than {_LARGEST / 1e9:g} GB")
            counts = np.asarray(stated.asarray())
    except (tifffile.TiffFileError, ValueError, OSError, KeyError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataFileError(f"{path}: this TIFF cannot be read: {reason}; save it without compression.") from None
    if counts.ndim != 3 or counts.shape[2] != 3 or counts.dtype not in (np.uint8, np.uint16):
        raise DataFileError(
            f"{path}: a photograph has red, green and blue in 8 or 16 bits, but this file has the shape "
            f"{counts.shape} of {counts.dtype}; save it as RGB without transparency."
        )
    full = float(np.iinfo(counts.dtype).max)
    if series.encoding == "srgb":
        encoded = (counts / full).astype(np.float32)
        light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        return Frame(light.astype(np.float32), np.any(counts >= full, axis=-1))
    white = full if series.white_level is None else series.white_level
    if not series.black_level < white <= full:
        raise DataFileError(
            f"{path}: a black level of {series.black_level:g} and a white level of {white:g} counts do not fit a file "
            f"of at most {full:g} counts."
        )
    light = (counts.astype(np.float32) - series.black_level) / (white - series.black_level)
    return Frame(np.minimum(light, 1).astype(np.float32), np.any(counts >= white, axis=-1))


def _read_raw(path: Path) -> Frame:
    try:
        import rawpy  # noqa: PLC0415  (an optional extra)
    except ImportError:
        raise _extra_missing("rawpy") from None
    try:
        with rawpy.imread(str(path)) as raw:
            sites = np.asarray(raw.raw_image_visible).copy()
            colours = np.asarray(raw.raw_colors_visible).copy()
            names = raw.color_desc.decode("ascii")
            black = np.array(raw.black_level_per_channel, dtype=float)
            white = np.array(raw.camera_white_level_per_channel or [raw.white_level] * 4, dtype=float)
    except rawpy.LibRawError as error:
        told = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise DataFileError(f"{path}: is neither a TIFF nor a raw file that LibRaw can read ({told}).") from None
    if sites.ndim != 2 or sorted(names[c] for c in colours[:2, :2].ravel()) != ["B", "G", "G", "R"]:
        raise DataFileError(
            f"{path}: only sensors whose colour filter repeats red, two greens and blue in squares can be read; "
            f"develop it to a linear 16-bit TIFF."
        )
    height, width = (length // 2 for length in sites.shape)
    light = np.zeros((height, width, 3), dtype=np.float32)
    saturated = np.zeros((height, width), dtype=bool)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        colour = int(colours[row, column])
        here = sites[row : 2 * height : 2, column : 2 * width : 2]
        channel = "RGB".index(names[colour])
        share = 0.5 if channel == 1 else 1.0
        level = (here.astype(np.float32) - black[colour]) / (white[colour] - black[colour])
        light[..., channel] += share * np.minimum(level, 1)
        saturated |= here >= white[colour]
    return Frame(light, saturated)


def _extra_missing(library: str) -> InputError:
    return InputError(f"Photographs need {library}, which is not installed; run: pip install goniometer[photo].")
