"""A scene in which a material is to be seen: lights, a camera and shapes, read from a YAML file.

The smallest scene, a sphere in the sun:

    camera: {position: [0, -4, 1]}
    material: [{sphere: 1}]
    lights: [{sun: [1, -1, 1]}]

Lengths have any one unit, z is up. All lights have the spectrum of one illuminant. Light goes from a lamp over the
material into the camera, once reflected: shapes cast shadows but do not light each other.
"""

from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from goniometer.errors import InputError
from goniometer.wording import describe
from goniometer.yaml_text import parsed_yaml

Number = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Camera(_Model):
    """A pinhole camera."""

    position: Vector = Field(description="Where it stands.")
    target: Vector = Field(default=(0.0, 0.0, 0.0), description="What it looks at.")
    up: Vector = Field(default=(0.0, 0.0, 1.0), description="Which way is up in the image.")
    field_of_view: Number = Field(default=40.0, gt=0, lt=170, description="From left to right, degrees.")
    pixels: tuple[Annotated[int, Field(ge=4, le=256)], Annotated[int, Field(ge=4, le=256)]] = Field(
        default=(48, 48), description="Columns and rows."
    )


class Shape(_Model):
    """A sphere of a radius, or a flat disc or rectangle with its normal."""

    sphere: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(default=None, description="Radius.")
    disc: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(default=None, description="Radius.")
    rectangle: tuple[Number, Number] | None = Field(default=None, description="Its two sides.")
    centre: Vector = Field(default=(0.0, 0.0, 0.0), description="Where its centre is.")
    normal: Vector = Field(default=(0.0, 0.0, 1.0), description="Of a disc or rectangle: the side that is seen.")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(given is not None for given in (self.sphere, self.disc, self.rectangle)) != 1:
            raise ValueError("a shape is one of sphere, disc or rectangle")
        if not any(self.normal):
            raise ValueError("the normal has no length: give a direction")
        if self.rectangle is not None and min(self.rectangle) <= 0:
            raise ValueError("the sides of a rectangle must be above 0")
        return self


class Light(_Model):
    """The sun, a lamp at a point, an even environment, or a sky that is brighter above."""

    sun: Vector | None = Field(default=None, description="Direction towards a light that is far away.")
    lamp: Vector | None = Field(default=None, description="Place of a small lamp.")
    environment: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, description="Radiance that comes from everywhere, the illuminant's white being 1."
    )
    sky: tuple[Number, Number] | None = Field(
        default=None, description="Radiance at the zenith and at the horizon; the lower half is black."
    )
    power: Annotated[float, Field(gt=0, allow_inf_nan=False)] = Field(
        default=3.141592653589793,
        description="Of a sun: irradiance across its way; of a lamp: intensity. White is lit to 1 by pi.",
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [value for value in (self.sun, self.lamp, self.environment, self.sky) if value is not None]
        if len(given) != 1:
            raise ValueError("a light is one of sun, lamp, environment or sky")
        if self.sun is not None and not any(self.sun):
            raise ValueError("the direction towards the sun has no length")
        if self.sky is not None and (min(self.sky) < 0 or max(self.sky) == 0):
            raise ValueError("the sky must not be negative, nor black")
        return self


class Scene(_Model):
    """A scene; see above."""

    camera: Camera = Field(description="Who looks.")
    material: tuple[Shape, ...] = Field(min_length=1, description="Shapes made of the material.")
    lights: tuple[Light, ...] = Field(min_length=1, description="What lights them.")
    blockers: tuple[Shape, ...] = Field(default=(), description="Black shapes that only cast shadows and hide.")
    illuminant: str = Field(default="D65", description="Spectrum of all lights, by its CIE name.")
    exposure: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, description="By which radiances are multiplied; none: the brightest pixels become white."
    )


def load_scene(path: Path) -> Scene:
    """Read and check a scene; raises `InputError`, one line with the file, the key and what would be right."""
    try:
        content = parsed_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: the scene cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: the scene is not UTF-8 text") from None
    except ValueError as error:
        raise InputError(f"{path}: the scene {error}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: a scene is a mapping with the keys camera, material and lights")
    try:
        scene = Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error, Scene)}") from None
    camera = scene.camera
    towards = [t - p for t, p in zip(camera.target, camera.position, strict=True)]
    if not any(towards):
        raise InputError(f"{path}: camera.target: the camera stands where it looks; move one of the two")
    return scene
