"""Mitsuba, which knows nothing of this project, renders what was predicted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.bsdf.fields import bsdf_content
from analysis.bsdf.measured_bsdf import evaluate, read_bsdf
from analysis.errors import RenderError
from analysis.mitsuba.run import Material, render, trace_mitsuba
from analysis.mitsuba.scene import read_mitsuba, write_mitsuba
from analysis.reflectance.directions import Directions, from_vectors
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cook_torrance
from analysis.scenes.choose import NODES
from analysis.scenes.ladder import Lambert, Tinted
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import display_for, image
from drivers.arrays import FloatArray
from goniometer.errors import InputError

UP = np.array([0.0, 0.0, 1.0])


def _metal(directions: Directions, wavelengths: FloatArray) -> FloatArray:
    return cook_torrance(directions, wavelengths, 0.209, load_conductor(), 1.35, 3.0)


SCENE = {
    "camera": {"position": (0.0, -4.0, 1.0), "pixels": (12, 12), "field_of_view": 30.0},
    "material": [{"sphere": 1.0}, {"rectangle": (6.0, 6.0), "centre": (0.0, 0.0, -1.0)}],
    "blockers": [{"disc": 0.4, "centre": (0.8, -0.8, 1.0), "normal": (1.0, -1.0, 1.0)}],
    "lights": [{"sun": (1.0, -1.0, 1.0)}, {"lamp": (-2.0, -2.0, 2.0), "power": 5.0}, {"sky": (0.3, 0.1)}],
}

FILE = """<scene version="3.0.0">
  <sensor type="perspective">
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0,-4,1" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/></film>
  </sensor>
  <bsdf type="diffuse" id="sample"/>
  <shape type="sphere"><ref id="sample"/></shape>
  <emitter type="constant"><spectrum name="radiance" type="d65"/></emitter>
</scene>"""


@pytest.mark.parametrize(
    ("reflectance", "alpha"), [(_metal, 0.209), (Lambert(NODES, np.linspace(0.2, 0.8, NODES.size)), 1.0)]
)
def test_the_file_of_any_reflectance_stands_for_it(
    reflectance: Callable[[Directions, FloatArray], FloatArray], alpha: float
) -> None:
    tables = read_bsdf(bsdf_content(reflectance, alpha, np.array([450.0, 550.0, 650.0])))
    rng = np.random.default_rng(1)
    cos, phi = rng.uniform(0.2, 1, (2, 300)), rng.uniform(0, 2 * np.pi, (2, 300))
    incident, reflected = (
        np.stack([np.sqrt(1 - c**2) * np.cos(p), np.sqrt(1 - c**2) * np.sin(p), c], axis=-1)
        for c, p in zip(cos, phi, strict=True)
    )
    wavelengths = np.array([450.0, 650.0])
    found = evaluate(tables, incident, reflected, wavelengths) / reflected[:, 2:]
    error = np.abs(found / reflectance(from_vectors(incident, reflected, UP), wavelengths) - 1)
    assert np.median(error) < 0.005
    assert np.percentile(error, 95) < 0.03


@pytest.mark.slow
def test_a_rendering_shows_what_was_predicted() -> None:
    pytest.importorskip("mitsuba")
    scene = Scene.model_validate(SCENE)
    vertices = trace(scene, 0.209, 256)
    tinted = Tinted(0.209, "ggx", NODES, np.linspace(0.7, 0.95, NODES.size))
    few = np.array([450.0, 550.0, 650.0])
    found = render(write_mitsuba(scene), [Material(_metal, few, 0.209), Material(tinted, few, 0.209)], 512)
    rendered = [xyz[vertices.target] for xyz in found]
    predicted = [image(vertices, reflectance, few).mean(axis=0) for reflectance in (_metal, tinted)]
    display = display_for(vertices, predicted[0])
    for mine, theirs in zip(predicted, rendered, strict=True):
        np.testing.assert_allclose(mine.mean(axis=0), theirs.mean(axis=0), rtol=0.04)
    difference, of_rendering = display.difference(*predicted), display.difference(*rendered)
    assert of_rendering.mean() == pytest.approx(difference.mean(), rel=0.1, abs=0.05)
    assert np.percentile(of_rendering, 95) == pytest.approx(np.percentile(difference, 95), rel=0.15, abs=0.05)


@pytest.mark.slow
def test_a_scene_of_mitsuba_asks_the_same_as_ours(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    path = tmp_path / "scene.xml"
    path.write_text(FILE)
    few = np.array([450.0, 550.0, 650.0])
    theirs = trace_mitsuba(read_mitsuba(path), Material(_metal, few, 0.209), samples=64)
    own = {"camera": SCENE["camera"], "material": [{"sphere": 1.0}], "lights": [{"environment": 1.0}]}
    ours = trace(Scene.model_validate(own), 0.209, 256)
    both = ours.target & theirs.target
    assert both.sum() > 0.9 * ours.target.sum()
    mine, found = (image(v, _metal, few).mean(axis=0)[both[v.target]] for v in (ours, theirs))
    # each has its own white: of ours 1 is the illuminant, of theirs 1 is D65 with Y = 1
    np.testing.assert_allclose(
        found.mean(axis=0) / found[:, 1].mean(), mine.mean(axis=0) / mine[:, 1].mean(), rtol=0.01
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('id="sample"', 'id="other"'), "0 BSDFs"),
        (("</scene>", ""), "XML"),
        (('value="12"', 'value="many"'), "no number of pixels"),
        (("film", "fllm"), "one film"),
    ],
)
def test_a_scene_of_mitsuba_that_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, change: tuple[str, str], says: str
) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(FILE.replace(*change))
    with pytest.raises(InputError, match=says) as fault:
        read_mitsuba(path)
    assert "\n" not in str(fault.value)


def test_a_sky_of_another_colour_is_not_rendered_as_if_it_were_day() -> None:
    with pytest.raises(RenderError, match="D65 only"):
        write_mitsuba(Scene.model_validate(SCENE | {"illuminant": "A"}))
