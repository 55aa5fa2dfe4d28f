"""The file that describes a series of photographs, and how it is read and written.

TOML. Every picture is listed with the angle of the light and its exposure time; nothing is taken from what cameras
write into their files, and nothing is guessed. docs/photos.toml shows every key. The smallest series that can be read:

    sample = "Sample 1"
    white = {file = "spectralon.nef", angle = 0, exposure = "1/60"}
    frames = [
      {file = "DSC_0001.nef", angle = -20, exposure = 0.5},
      {file = "DSC_0002.nef", angle = 20, exposure = "1/125"},
    ]
"""

import re
import tomllib
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from goniometer.campaigns.campaign import Words
from goniometer.campaigns.quantities import Angle, Duration
from goniometer.errors import DataFileError
from goniometer.wording import describe


def _fraction(value: object) -> object:
    """1/60 as photographers write it."""
    parts = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*s?\s*", value) if isinstance(value, str) else None
    return int(parts[1]) / int(parts[2]) if parts and int(parts[2]) else value


Exposure = Annotated[Duration, BeforeValidator(_fraction), Field(gt=0)]
"""Seconds."""
Row = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Shot(_Strict):
    """One photograph."""

    file: str = Field(min_length=1, description="A raw file or a TIFF; relative to the series file.")
    angle: Angle = Field(
        gt=-90,
        lt=90,
        description="Of the light to the surface normal, degrees; it is that of the camera in the mirror direction.",
    )
    exposure: Exposure = Field(description="Exposure time, seconds; a text may give it as a fraction.")


class Series(_Strict):
    """A sample under light from many angles, seen by a camera that never moved."""

    sample: Words
    camera_angle: Angle = Field(default=45.0, gt=-90, lt=90, description="To the surface normal, degrees, signed.")
    encoding: Literal["linear", "srgb"] | None = Field(
        default=None, description="What the numbers of a TIFF are: proportional to the light, or sRGB for a display."
    )
    black_level: float = Field(default=0.0, ge=0, description="Counts without light, of a linear TIFF.")
    white_level: float | None = Field(
        default=None, gt=0, description="Counts at which a linear TIFF is saturated; None is all that it can hold."
    )
    pixel_um: float | None = Field(
        default=None, gt=0, description="How much of the sample a pixel sees across the plane of incidence, um."
    )
    colour_matrix: tuple[Row, Row, Row] | None = Field(
        default=None,
        description="From white-balanced RGB of the camera to linear sRGB; None takes the one as the other.",
    )
    white: Shot = Field(description="A Spectralon panel in place of the sample, under the same light.")
    frames: tuple[Shot, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        angle, count = Counter(shot.angle for shot in self.frames).most_common(1)[0]
        if count > 1:
            raise ValueError(f"there are {count} frames at {angle:g} degrees; keep one")
        if self.white_level is not None and self.white_level <= self.black_level:
            raise ValueError("the white level must be above the black level")
        if self.encoding == "srgb" and (self.black_level or self.white_level is not None):
            raise ValueError("black_level and white_level are for linear files; leave them out with srgb")
        if self.colour_matrix is not None and any(abs(sum(row) - 1) > 1e-3 for row in self.colour_matrix):
            raise ValueError("each row of the colour matrix must add up to 1, so that white stays white")
        return self


def load_series(path: Path) -> Series:
    """Read and check the description of a series; raises `DataFileError`, one line that says what is wrong where."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataFileError(f"{path}: the series cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise DataFileError(f"{path}: a series is described in a TOML file, and this one is not UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise DataFileError(f"{path}: the series is not valid TOML: {error}") from None
    except RecursionError:
        raise DataFileError(f"{path}: the series is nested too deeply; it needs two levels") from None
    try:
        return Series.model_validate(content)
    except ValidationError as error:
        raise DataFileError(f"{path}: {describe(error, Series)}") from None


def series_text(series: Series) -> str:
    """The file that `load_series` reads back to `series`."""
    given = series.model_dump(exclude={"white", "frames"}, exclude_defaults=True)
    lines = [f"{key} = {_toml(value)}" for key, value in given.items()]
    shots = [f"  {_shot(shot)}," for shot in series.frames]
    return "\n".join([*lines, f"white = {_shot(series.white)}", "frames = [", *shots, "]"]) + "\n"


def _shot(shot: Shot) -> str:
    return "{" + ", ".join(f"{key} = {_toml(value)}" for key, value in shot.model_dump().items()) + "}"


def _toml(value: object) -> str:
    if isinstance(value, str):
        # TOML's basic strings take the escapes of the characters that they do not allow
        plain = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in plain) + '"'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
