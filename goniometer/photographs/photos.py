"""A series of photographs of one sample under light from many angles (paper, section 3.3), white-balanced.

The light in each channel is divided by the exposure time and by what the Spectralon panel sent, so that a value of 1
is as bright as the panel was, and grey has three equal values; Spectralon is taken as neutral, which it is to one per
cent over the visible. The panel counts by its mean over the same centre of the frame. There is no flat field: the spot
of the lamp changes its shape with the angle, so the panel's would be wrong at all angles but its own; how uneven the
panel was is told instead.

What lies outside the centre, the inset, is kept as a smaller picture to look at.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import DataFileError, InputError
from goniometer.photographs.files import Frame, Pixels, read_frame
from goniometer.photographs.series import Shot, load_series

OVERVIEW = 360
"""Pixels along the longer side of the smaller picture, about."""

SMALLEST_INSET = 16
"""Pixels along the side of an inset; fewer say nothing of a speckle pattern."""

SATURATED = 1e-3
"""Part of an inset that may be saturated before a photograph takes no part in results."""


@dataclass(frozen=True)
class Photo:
    """One photograph, in units of the panel."""

    angle: float
    """Of the light to the surface normal, degrees; it equals the camera's in the mirror direction."""
    exposure: float
    """Seconds."""
    inset: Pixels
    """[y, x, 3] white-balanced red, green, blue of the square in the centre."""
    saturated: BoolArray
    """[y, x] pixels of the inset that were saturated: there `inset` is a lower limit."""
    overview: Pixels
    """[y, x, 3] the whole photograph, smaller."""

    @property
    def overexposed(self) -> bool:
        """Whether so much of the inset is saturated that its mean is not known."""
        return float(self.saturated.mean()) > SATURATED


@dataclass(frozen=True)
class PhotoSeries:
    """All photographs of a sample, the angle of the light ascending."""

    sample: str
    camera_angle: float
    """To the surface normal, degrees, signed."""
    photos: tuple[Photo, ...]
    gains: tuple[float, float, float]
    """By which red, green and blue were multiplied to make the panel white, relative to green."""
    unevenness: float
    """Standard deviation of the panel's brightness over the inset, in eight by eight fields, relative to its mean."""
    inset_side: float
    """Side of the inset over the shorter side of a photograph."""
    pixel_um: float | None
    """How much of the sample a pixel sees across the plane of incidence, um, where that was stated."""
    colour_matrix: FloatArray | None
    """[3, 3] from white-balanced red, green and blue to linear sRGB, where that was stated."""


def read_series(path: Path, inset: float = 0.5) -> PhotoSeries:
    """Of the series that the file at `path` describes; `inset` is the side of the centre over the shorter side.

    Raises `DataFileError` for files that cannot be used, and `InputError` where the extra is not installed or the inset
    is too small.
    """
    if not 0 < inset <= 1:
        raise InputError(f"The inset is a part of the shorter side of a photograph, between 0 and 1, not {inset:g}.")
    series = load_series(path)
    white = read_frame(path.parent / series.white.file, series)
    centre = _centre(white, inset, path.parent / series.white.file)
    panel = _panel(white, centre, path.parent / series.white.file)
    rate = panel.mean(axis=(0, 1), dtype=float) / series.white.exposure
    photos = []
    for shot in sorted(series.frames, key=lambda shot: shot.angle):
        frame = read_frame(path.parent / shot.file, series)
        if frame.light.shape != white.light.shape:
            raise DataFileError(
                f"{path.parent / shot.file}: has {_size(frame)} pixels, but the panel's photograph has {_size(white)}; "
                f"all must be taken alike."
            )
        photos.append(_photo(shot, frame, centre, rate))
    return PhotoSeries(
        sample=series.sample,
        camera_angle=series.camera_angle,
        photos=tuple(photos),
        gains=(float(rate[1] / rate[0]), 1.0, float(rate[1] / rate[2])),
        unevenness=_unevenness(panel),
        inset_side=inset,
        pixel_um=series.pixel_um,
        colour_matrix=None if series.colour_matrix is None else np.array(series.colour_matrix),
    )


def _photo(shot: Shot, frame: Frame, centre: tuple[slice, slice], rate: FloatArray) -> Photo:
    scale = (1 / (shot.exposure * rate)).astype(np.float32)
    return Photo(
        angle=shot.angle,
        exposure=shot.exposure,
        inset=frame.light[centre] * scale,
        saturated=frame.saturated[centre],
        overview=_smaller(frame.light) * scale,
    )


def _centre(frame: Frame, inset: float, path: Path) -> tuple[slice, slice]:
    height, width = frame.saturated.shape
    side = round(inset * min(height, width))
    if side < SMALLEST_INSET:
        raise InputError(
            f"{path}: an inset of {side} x {side} pixels says nothing; it needs {SMALLEST_INSET}, so make it at least "
            f"{SMALLEST_INSET / min(height, width):.2g} of the shorter side, or take larger photographs."
        )
    top, left = (height - side) // 2, (width - side) // 2
    return slice(top, top + side), slice(left, left + side)


def _panel(frame: Frame, centre: tuple[slice, slice], path: Path) -> Pixels:
    """[y, x, 3] the panel within the inset; raises `DataFileError` where it is no measure of white."""
    if frame.saturated[centre].any():
        share = float(frame.saturated[centre].mean())
        raise DataFileError(
            f"{path}: the panel is saturated in {100 * share:.2g} % of the inset and is no measure of white; expose it "
            f"for a shorter time."
        )
    panel = frame.light[centre]
    darkest = float(panel.mean(axis=(0, 1)).min())
    if darkest < 0.01:
        raise DataFileError(
            f"{path}: the darkest channel of the panel is at {100 * darkest:.2g} % of saturation, too dark for a white "
            f"balance; expose it for longer."
        )
    return panel


def _unevenness(panel: Pixels) -> float:
    fields = _block_means(panel.mean(axis=-1, keepdims=True), max(1, panel.shape[0] // 8))
    return float(fields.std() / fields.mean())


def _smaller(light: Pixels) -> Pixels:
    return _block_means(light, max(1, max(light.shape[:2]) // OVERVIEW))


def _block_means(light: Pixels, side: int) -> Pixels:
    """[y, x, channels] means of squares of `side` pixels; what is left over at the edges is cut off."""
    height, width = (length // side * side for length in light.shape[:2])
    blocks = light[:height, :width].reshape(height // side, side, width // side, side, light.shape[2])
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def _size(frame: Frame) -> str:
    height, width = frame.saturated.shape
    return f"{width} x {height}"
