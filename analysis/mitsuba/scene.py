"""Scenes as Mitsuba 3 reads them, in which the material can be exchanged.

A scene is a file of Mitsuba's own, in which the BSDF of the material has the id "sample", or one of
`analysis.scenes.scene` written as such. `analysis.mitsuba.run` traces and renders them.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree  # nosec B405 # it only writes; what reads is defusedxml

import defusedxml
import defusedxml.ElementTree
import numpy as np

from analysis.colour import illuminant, observer
from analysis.errors import RenderError
from analysis.scenes.rays import WAVELENGTHS, tangents
from analysis.scenes.scene import Scene, Shape
from drivers.arrays import FloatArray
from goniometer.errors import InputError

PIXELS = 64
"""Most pixels of a side to which the film of a scene is reduced."""

CIE_Y = 106.856895
"""Integral of the observer's Y, nm, by which Mitsuba's XYZ are divided."""

STEP = float(WAVELENGTHS[1] - WAVELENGTHS[0])
"""Of these wavelengths, nm."""

_SKY_ROWS = 512

_DEEPEST = 50
"""Elements inside each other; scenes have about six."""

_OURS = '<bsdf type="measured" id="sample" />'


@dataclass(frozen=True)
class MitsubaScene:
    """A scene as Mitsuba reads it, its material exchangeable."""

    xml: str
    """With an empty BSDF in the place of the material."""
    resources: Path
    """Folder from which its files are named."""
    white: FloatArray
    """[wavelengths of `analysis.scenes.rays.WAVELENGTHS`] spectrum of what is white."""
    images: dict[str, FloatArray]
    """Pictures by file name that it needs besides, [rows, columns, 3]."""
    exposure: float | None

    def with_material(self, element: str) -> str:
        """Its text with `element` as the BSDF of the material."""
        return self.xml.replace(_OURS, element)


def read_mitsuba(path: Path) -> MitsubaScene:
    """A scene file of Mitsuba, its film made small and its samples those of `analysis.mitsuba.worker`.

    Raises `InputError` for a file that is none, or has no BSDF with the id "sample", no film or several cameras.
    """
    try:
        root = parsed_xml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: the scene cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path}: the scene is not valid XML: {error}") from None
    found = [element for element in root.iter("bsdf") if element.get("id") == "sample"]
    if len(found) != 1:
        raise InputError(
            f'{path}: {len(found)} BSDFs have the id "sample"; give it to the one that the material is to replace'
        )
    films = list(root.iter("film"))
    if len(films) != 1:
        raise InputError(f"{path}: a scene needs one sensor with one film, and has {len(films)}")
    defaults = {e.get("name"): e.get("value", "") for e in root.iter("default")}
    columns, rows = (_film_side(films[0], side, defaults, path) for side in ("width", "height"))
    factor = min(1.0, PIXELS / max(columns, rows))
    _become_ours(found[0])
    _small_film(films[0], max(round(columns * factor), 4), max(round(rows * factor), 4))
    return MitsubaScene(
        ElementTree.tostring(root, encoding="unicode"),
        path.resolve().parent,
        illuminant("D65", WAVELENGTHS),
        {},
        None,
    )


def parsed_xml(text: str) -> ElementTree.Element:
    """The root of a scene; raises `ValueError` for what is no XML, defines entities, or is nested without end."""
    try:
        root: ElementTree.Element = defusedxml.ElementTree.fromstring(text)
    except defusedxml.DefusedXmlException:
        raise ValueError("it defines entities, which are not read; write out what they stand for") from None
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from None
    inside = [root]
    for _ in range(_DEEPEST):
        inside = [each for element in inside for each in element]
    if inside:
        raise ValueError(f"its elements are nested deeper than {_DEEPEST} levels")
    return root


def _film_side(film: ElementTree.Element, side: str, defaults: dict[str | None, str], path: Path) -> int:
    given = next((e.get("value", "") for e in film if e.get("name") == side), "768" if side == "width" else "576")
    for name, value in defaults.items():
        given = given.replace(f"${name}", value)
    if not given.isdecimal() or int(given) == 0:
        raise InputError(f'{path}: the {side} of the film, "{given}", is no number of pixels')
    return int(given)


def _small_film(film: ElementTree.Element, columns: int, rows: int) -> None:
    film.clear()
    film.set("type", "hdrfilm")
    ElementTree.SubElement(film, "integer", name="width", value=str(columns))
    ElementTree.SubElement(film, "integer", name="height", value=str(rows))
    ElementTree.SubElement(film, "string", name="pixel_format", value="xyz")
    ElementTree.SubElement(film, "rfilter", type="box")


def _become_ours(element: ElementTree.Element) -> None:
    element.clear()
    element.set("type", "measured")
    element.set("id", "sample")


def write_mitsuba(scene: Scene) -> MitsubaScene:
    """A scene of `analysis.scenes.scene` for Mitsuba; light is scattered once, as there.

    Raises `RenderError` for a sky of another illuminant than D65, which Mitsuba has no pictures for.
    """
    root = ElementTree.Element("scene", version="3.0.0")
    integrator = ElementTree.SubElement(root, "integrator", type="direct")
    ElementTree.SubElement(integrator, "boolean", name="hide_emitters", value="true")
    sensor = ElementTree.SubElement(root, "sensor", type="perspective")
    camera = scene.camera
    ElementTree.SubElement(sensor, "float", name="fov", value=repr(camera.field_of_view))
    ElementTree.SubElement(sensor, "string", name="fov_axis", value="x")
    place = ElementTree.SubElement(sensor, "transform", name="to_world")
    ElementTree.SubElement(
        place, "lookat", origin=_list(camera.position), target=_list(camera.target), up=_list(camera.up)
    )
    _small_film(ElementTree.SubElement(sensor, "film"), *camera.pixels)
    _become_ours(ElementTree.SubElement(root, "bsdf"))
    black = ElementTree.SubElement(root, "bsdf", type="diffuse", id="black")
    ElementTree.SubElement(black, "spectrum", name="reflectance", value="0")
    for shapes, bsdf in ((scene.material, "sample"), (scene.blockers, "black")):
        for shape in shapes:
            ElementTree.SubElement(_shape(root, shape), "ref", id=bsdf)
    spectrum = illuminant(scene.illuminant, WAVELENGTHS)
    images = {}
    for number, light in enumerate(scene.lights):
        if light.sky is not None:
            if scene.illuminant != "D65":
                raise RenderError("Mitsuba can render a sky under D65 only; give the scene this illuminant.")
            images[f"sky{number}.exr"] = _sky(*light.sky)
            emitter = ElementTree.SubElement(root, "emitter", type="envmap")
            ElementTree.SubElement(emitter, "string", name="filename", value=f"sky{number}.exr")
            upright = ElementTree.SubElement(emitter, "transform", name="to_world")
            ElementTree.SubElement(upright, "rotate", x="1", angle="90")
            # of a picture, 1 is D65 with a Y of 1
            level = float(spectrum @ observer(WAVELENGTHS)[:, 1]) * STEP / CIE_Y
            ElementTree.SubElement(emitter, "float", name="scale", value=repr(level))
            continue
        if light.sun is not None:
            emitter, name = ElementTree.SubElement(root, "emitter", type="directional"), "irradiance"
            ElementTree.SubElement(emitter, "vector", name="direction", value=_list([-v for v in light.sun]))
            power = light.power
        elif light.lamp is not None:
            emitter, name = ElementTree.SubElement(root, "emitter", type="point"), "intensity"
            ElementTree.SubElement(emitter, "point", name="position", value=_list(light.lamp))
            power = light.power
        else:
            assert light.environment is not None  # one of the four is given
            emitter, name = ElementTree.SubElement(root, "emitter", type="constant"), "radiance"
            power = light.environment
        pairs = ", ".join(f"{w:g}:{v:.8g}" for w, v in zip(WAVELENGTHS, power * spectrum, strict=True))
        ElementTree.SubElement(emitter, "spectrum", name=name, value=pairs)
    return MitsubaScene(ElementTree.tostring(root, encoding="unicode"), Path.cwd(), spectrum, images, scene.exposure)


def _shape(root: ElementTree.Element, shape: Shape) -> ElementTree.Element:
    if shape.sphere is not None:
        element = ElementTree.SubElement(root, "shape", type="sphere")
        ElementTree.SubElement(element, "point", name="center", value=_list(shape.centre))
        ElementTree.SubElement(element, "float", name="radius", value=repr(shape.sphere))
        return element
    normal = np.asarray(shape.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    first, second = tangents(normal)
    if shape.disc is not None:
        kind, sides = "disk", (shape.disc, shape.disc)
    else:
        assert shape.rectangle is not None  # one of the three is given
        kind, sides = "rectangle", (shape.rectangle[0] / 2, shape.rectangle[1] / 2)
    element = ElementTree.SubElement(root, "shape", type=kind)
    turned = np.eye(4)
    turned[:3] = np.column_stack([first * sides[0], second * sides[1], normal, shape.centre])
    place = ElementTree.SubElement(element, "transform", name="to_world")
    ElementTree.SubElement(place, "matrix", value=" ".join(f"{v:.10g}" for v in turned.ravel()))
    return element


def _sky(zenith: float, horizon: float) -> FloatArray:
    """[rows, columns, 3] an environment map that is brighter above."""
    height = np.cos(math.pi * (np.arange(_SKY_ROWS) + 0.5) / _SKY_ROWS)
    radiance = np.where(height >= 0, horizon + (zenith - horizon) * height, 0.0)
    return np.asarray(np.broadcast_to(radiance[:, None, None], (_SKY_ROWS, 8, 3)))


def _list(values: Any) -> str:
    return ", ".join(f"{v:.10g}" for v in values)
