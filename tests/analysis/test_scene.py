"""A scene asks what it says it asks: radiances as closed forms have them, and faults in one line."""

from pathlib import Path

import numpy as np
import pytest

from analysis.errors import SceneError
from analysis.reflectance.directions import Directions
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene, load_scene
from analysis.scenes.vertices import Vertices, display_for, image, observer_white
from drivers.arrays import FloatArray
from goniometer.errors import InputError

GREEN = np.array([550.0])

CAMERA = {"position": (0.0, 0.0, 5.0), "up": (0.0, 1.0, 0.0), "field_of_view": 10.0, "pixels": (8, 8)}


def _white(directions: Directions, wavelengths: FloatArray) -> FloatArray:
    """A Lambertian surface that reflects everything."""
    return np.full((directions.cos_i.size, wavelengths.size), 1 / np.pi)


def _scene(**content: object) -> Scene:
    return Scene.model_validate({"camera": CAMERA, "material": [{"disc": 5.0}]} | content)


def _luminance(vertices: Vertices) -> FloatArray:
    """[pixels] Y of a white surface."""
    return np.asarray(image(vertices, _white, GREEN).mean(axis=0)[:, 1])


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        ({"sun": (0.0, 0.0, 1.0)}, 1.0),
        ({"sun": (0.0, 1.0, 1.0)}, np.sqrt(0.5)),
        ({"sun": (0.0, 0.0, 1.0), "power": 1.0}, 1 / np.pi),
        ({"environment": 1.0}, 1.0),
        ({"sky": (1.0, 1.0)}, 1.0),
        # irradiance of a sky that grows as the cosine: 2 pi times the integral of cos^2 sin, over pi
        ({"sky": (1.0, 0.0)}, 2 / 3),
    ],
)
def test_a_white_plane_is_as_bright_as_its_irradiance_over_pi(light: dict[str, object], expected: float) -> None:
    found = _luminance(trace(_scene(lights=[light]), alpha=0.3, samples=256))
    assert found.size == 64
    assert found.mean() == pytest.approx(expected, rel=0.01)


def test_a_lamp_fades_with_distance_and_slant() -> None:
    lit = trace(_scene(lights=[{"lamp": (1.0, 0.0, 2.0), "power": 1.0}]), alpha=0.3, samples=64)
    side = 2 * 5 * np.tan(np.radians(5))
    across, down = np.meshgrid(((np.arange(8) + 0.5) / 8 - 0.5) * side, (0.5 - (np.arange(8) + 0.5) / 8) * side)
    distance2 = (across - 1) ** 2 + down**2 + 4
    expected = 2 / distance2**1.5 / np.pi
    np.testing.assert_allclose(_luminance(lit), expected.ravel(), rtol=0.01)


def test_the_mirror_direction_of_a_sphere_is_where_geometry_puts_it() -> None:
    # a far camera on z and a sun on x: the half vector is the normal at 45 degrees, x = z
    scene = _scene(
        camera=CAMERA | {"position": (0.0, 0.0, 100.0), "field_of_view": 1.2, "pixels": (32, 32)},
        material=[{"sphere": 1.0}],
        lights=[{"sun": (1.0, 0.0, 0.0)}],
    )
    vertices = trace(scene, alpha=0.1, samples=16)
    brightest = vertices.pixel[np.argmax(vertices.directions.cos_m)]
    side = 2 * 100 * np.tan(np.radians(0.6))
    assert ((brightest % 32 + 0.5) / 32 - 0.5) * side == pytest.approx(np.sqrt(0.5), abs=side / 32)
    assert abs((brightest // 32 + 0.5) / 32 - 0.5) * side < side / 32
    assert np.degrees(np.arccos(vertices.directions.cos_d)) == pytest.approx(45, abs=0.6)


def test_a_blocker_casts_its_shadow_and_hides_what_is_behind_it() -> None:
    free = trace(_scene(lights=[{"sun": (0.0, 0.0, 1.0)}]), alpha=0.3, samples=16)
    shaded = _scene(lights=[{"sun": (0.0, 1.0, 1.0)}], blockers=[{"disc": 0.2, "centre": (0.0, 1.0, 1.0)}])
    dark = trace(shaded, alpha=0.3, samples=16)
    assert free.target.all()
    assert dark.target.all()  # the blocker stands aside of the view
    assert _luminance(free).min() > 0.9
    assert _luminance(dark).min() == 0
    assert _luminance(dark).max() == pytest.approx(np.sqrt(0.5), rel=0.01)
    hidden = _scene(lights=[{"sun": (0.0, 0.0, 1.0)}], blockers=[{"disc": 0.2, "centre": (0.0, 0.0, 1.0)}])
    assert not trace(hidden, alpha=0.3, samples=16).target.all()


def test_white_is_white_under_any_illuminant() -> None:
    for name in ("D65", "A", "FL11"):
        vertices = trace(_scene(lights=[{"sun": (0.0, 0.0, 1.0)}], illuminant=name), alpha=0.3, samples=16)
        seen = image(vertices, _white, np.array([400.0, 700.0])).mean(axis=0)
        display = display_for(vertices, seen)
        np.testing.assert_allclose(display.shown(seen), 1.0, atol=1e-3)
        assert display.difference(seen, 0.9 * seen) == pytest.approx(2.0, abs=0.8)  # L falls by 4
    np.testing.assert_allclose(observer_white(), [0.9505, 1.0, 1.0888], atol=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1, 2]", "a mapping"),
        ("camera: {position: [0, -4, 1]}\nmaterial: []\nlights: [{sun: [0, 0, 1]}]", "material"),
        ("camera: {position: [0, -4, 1]}\nmaterial: [{sphere: 1, disc: 2}]\nlights: [{sun: [0, 0, 1]}]", "one of"),
        ("camera: {position: [0, -4, 1]}\nmaterial: [{sphere: 1}]\nlights: [{sunn: [0, 0, 1]}]", "sun"),
        ("camera: {position: [0, 0, 0]}\nmaterial: [{sphere: 1}]\nlights: [{sun: [0, 0, 1]}]", "stands where"),
        ("camera: {", "YAML"),
    ],
)
def test_a_scene_that_is_none_is_refused_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as fault:
        load_scene(path)
    assert "\n" not in str(fault.value)


def test_a_scene_without_the_material_or_without_light_says_so() -> None:
    aside = CAMERA | {"position": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 10.0)}
    with pytest.raises(SceneError, match="material alone"):
        trace(_scene(camera=aside, lights=[{"sun": (0.0, 0.0, 1.0)}]), alpha=0.3)
    with pytest.raises(SceneError, match="No light"):
        trace(_scene(lights=[{"sun": (0.0, 0.0, -1.0)}]), alpha=0.3)
    with pytest.raises(SceneError, match="own up"):
        trace(_scene(camera=CAMERA | {"up": (0.0, 0.0, 1.0)}, lights=[{"sun": (0.0, 0.0, 1.0)}]), alpha=0.3)
