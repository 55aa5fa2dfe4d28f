"""The vertices of a scene, by casting rays: camera, first hit, and the way to every light.

A sun or a lamp needs one shadow ray; an environment is sampled twice, by the lobe that a material of about the right
roughness has and by a cosine, so that no model is missed that differs from it (Veach & Guibas 1995, balance heuristic
over both). Samples are Sobol points with a shift of their own in every pixel, its two halves being nets of their own.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from analysis.colour import illuminant
from analysis.errors import SceneError
from analysis.reflectance.directions import from_vectors
from analysis.reflectance.distributions import ndf
from analysis.scenes.scene import Camera, Light, Scene, Shape
from analysis.scenes.vertices import Vertices
from drivers.arrays import BoolArray, FloatArray

WAVELENGTHS = np.arange(360.0, 831.0, 5.0)
"""At which light is known, nm."""

NARROWEST_LOBE = 0.02
"""Roughness below which the proposal does not get narrower; a mirror is hit by many samples all the same."""

_EPSILON = 1e-4


@dataclass(frozen=True)
class _Hits:
    """Where rays meet a shape first; [rays] each."""

    distance: FloatArray
    """Infinite where nothing is met."""
    normal: FloatArray
    """[rays, 3]"""
    of_material: BoolArray


def trace(scene: Scene, alpha: float, samples: int = 64, seed: int = 1) -> Vertices:
    """The vertices of `scene` with `samples` of a pixel, a power of two; `alpha` is about the material's roughness.

    Raises `SceneError` where no pixel shows the material alone or no light falls on it, `OutOfRange` for an illuminant
    that is not known.
    """
    columns, rows = scene.camera.pixels
    pixel, half, numbers = _sample_numbers(rows * columns, samples, seed)
    origin, direction = _camera_rays(scene.camera, pixel, numbers[:, :2])
    hits = _first_hit(scene, origin, direction)
    hit = hits.of_material
    complete = np.bincount(pixel[hit], minlength=rows * columns) == samples
    if not complete.any():
        raise SceneError("No pixel of the scene shows the material alone; bring the camera nearer or take more pixels.")
    kept = hit & complete[pixel]
    place = (origin + hits.distance[:, None] * direction)[kept]
    normal, outgoing, numbers = hits.normal[kept], -direction[kept], numbers[kept]
    found = []
    width = max(alpha, NARROWEST_LOBE)
    ways = [way for light in scene.lights for way in _towards(light, place, normal, outgoing, numbers[:, 2:], width)]
    for incident, radiance, far in ways:
        cosine = np.sum(incident * normal, axis=1)
        lit = (cosine > 0) & (radiance > 0) & (np.sum(outgoing * normal, axis=1) > 0)
        lit[lit] &= ~_shadowed(scene, place[lit] + _EPSILON * normal[lit], incident[lit], far[lit])
        found.append((np.flatnonzero(lit), incident[lit], (radiance * cosine)[lit]))
    number = np.concatenate([each[0] for each in found])
    if number.size == 0:
        raise SceneError("No light of the scene falls on the material where the camera sees it.")
    frame = normal[number]
    spectrum = illuminant(scene.illuminant, WAVELENGTHS)
    return Vertices(
        rows=rows,
        columns=columns,
        pixel=pixel[kept][number],
        half=half[kept][number],
        directions=from_vectors(np.concatenate([each[1] for each in found]), outgoing[number], frame),
        weight=(np.concatenate([each[2] for each in found]) / (samples / 2))[:, None],
        wavelengths=WAVELENGTHS,
        light=spectrum[None],
        white=spectrum,
        target=complete,
        exposure=scene.exposure,
    )


def _sample_numbers(pixels: int, samples: int, seed: int) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """Pixel, half and six numbers in [0, 1) of every camera ray."""
    random = np.random.default_rng(seed)
    net = scipy.stats.qmc.Sobol(6, scramble=False).random(samples // 2)
    shifts = random.random((pixels, 2, 1, 6))
    numbers = (net + shifts) % 1.0
    pixel = np.repeat(np.arange(pixels), samples)
    half = np.tile(np.repeat([0, 1], samples // 2), pixels)
    return pixel, half, numbers.reshape(-1, 6)


def camera_frame(camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors [3] to the right, upwards and forwards.

    Raises `SceneError` for a camera that looks along its own up.
    """
    forward = _unit(np.subtract(camera.target, camera.position))
    up = np.asarray(camera.up, dtype=float)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * max(float(np.linalg.norm(up)), 1e-12):
        raise SceneError("The camera looks along its own up; give camera.up another direction.")
    right = _unit(right)
    return right, np.cross(right, forward), forward


def _camera_rays(camera: Camera, pixel: NDArray[np.intp], jitter: FloatArray) -> tuple[FloatArray, FloatArray]:
    columns, rows = camera.pixels
    right, up, forward = camera_frame(camera)
    width = 2 * math.tan(math.radians(camera.field_of_view) / 2)
    across = ((pixel % columns + jitter[:, 0]) / columns - 0.5) * width
    down = ((pixel // columns + jitter[:, 1]) / rows - 0.5) * width * rows / columns
    direction = _unit(forward + across[:, None] * right - down[:, None] * up)
    return np.broadcast_to(np.asarray(camera.position, dtype=float), direction.shape), direction


def _first_hit(scene: Scene, origin: FloatArray, direction: FloatArray) -> _Hits:
    distance = np.full(len(direction), np.inf)
    normal, of_material = np.zeros_like(direction), np.zeros(len(direction), dtype=bool)
    for shapes, is_material in ((scene.material, True), (scene.blockers, False)):
        for shape in shapes:
            t, n = _meet(shape, origin, direction)
            nearer = t < distance
            distance, of_material = np.where(nearer, t, distance), np.where(nearer, is_material, of_material)
            normal = np.where(nearer[:, None], n, normal)
    # the back of a flat shape is black
    seen = np.sum(normal * direction, axis=1) < 0
    return _Hits(distance, normal, of_material & seen & np.isfinite(distance))


def _shadowed(scene: Scene, origin: FloatArray, direction: FloatArray, far: FloatArray) -> BoolArray:
    blocked = np.zeros(len(direction), dtype=bool)
    for shape in (*scene.material, *scene.blockers):
        blocked |= _meet(shape, origin, direction)[0] < far
    return blocked


def _meet(shape: Shape, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[rays] distance to the first hit in front, infinite without one, and the outward normal there."""
    centre = np.asarray(shape.centre, dtype=float)
    if shape.sphere is not None:
        to = origin - centre
        b = np.sum(to * direction, axis=1)
        # in the form that stays exact far away: distance of the centre from the ray
        aside = to - b[:, None] * direction
        d = shape.sphere**2 - np.sum(aside**2, axis=1)
        root = np.sqrt(np.maximum(d, 0))
        t = np.where(-b - root > _EPSILON, -b - root, -b + root)
        t = np.where((d > 0) & (t > _EPSILON), t, np.inf)
        normal = (to + np.where(np.isfinite(t), t, 0.0)[:, None] * direction) / shape.sphere
        return t, normal
    normal = _unit(np.asarray(shape.normal, dtype=float))
    slope = direction @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.asarray(((centre - origin) @ normal) / slope)
    t = np.where(np.isfinite(t) & (t > _EPSILON), t, np.inf)
    at = origin + np.where(np.isfinite(t), t, 0.0)[:, None] * direction - centre
    if shape.disc is not None:
        inside = np.sum(at**2, axis=1) <= shape.disc**2
    else:
        assert shape.rectangle is not None  # one of the three is given
        first, second = tangents(normal)
        along, across = (side / 2 for side in shape.rectangle)
        inside = (np.abs(at @ first) <= along) & (np.abs(at @ second) <= across)
    return np.where(inside, t, np.inf), np.broadcast_to(normal, direction.shape)


_Way = tuple[FloatArray, FloatArray, FloatArray]
"""Directions to a light [rays, 3], its radiance over the density of the direction, and how far away it is."""


def _towards(
    light: Light, place: FloatArray, normal: FloatArray, outgoing: FloatArray, numbers: FloatArray, alpha: float
) -> list[_Way]:
    """One way to a sun or a lamp, two to what is all around."""
    count = len(place)
    if light.sun is not None:
        direction = np.broadcast_to(_unit(np.asarray(light.sun, dtype=float)), place.shape)
        return [(direction, np.full(count, light.power), np.full(count, np.inf))]
    if light.lamp is not None:
        to = np.asarray(light.lamp, dtype=float) - place
        far = np.linalg.norm(to, axis=1)
        return [(to / far[:, None], light.power / far**2, far)]
    ways = []
    for direction in _proposals(normal, outgoing, numbers, alpha):
        density = _density(normal, outgoing, direction, alpha)
        if light.environment is not None:
            radiance = np.full(count, light.environment)
        else:
            assert light.sky is not None  # one of the four is given
            zenith, horizon = light.sky
            height = direction[:, 2]
            radiance = np.where(height >= 0, horizon + (zenith - horizon) * height, 0.0)
        ways.append((direction, radiance / np.maximum(density, 1e-300), np.full(count, np.inf)))
    return ways


def _proposals(normal: FloatArray, outgoing: FloatArray, numbers: FloatArray, alpha: float) -> list[FloatArray]:
    """Incident directions [rays, 3] that follow a lobe, and such that follow a cosine; `numbers` [rays, 4]."""
    first, second = tangents(normal)

    def around(sine: FloatArray, turn: FloatArray) -> FloatArray:
        cosine = np.sqrt(np.maximum(1 - sine**2, 0.0))
        across = np.cos(2 * np.pi * turn)[:, None] * first + np.sin(2 * np.pi * turn)[:, None] * second
        return np.asarray(sine[:, None] * across + cosine[:, None] * normal)

    u, v, share, turn = numbers.T
    facet = around(alpha * np.sqrt(u) / np.sqrt(np.maximum(1 - u + alpha**2 * u, 1e-300)), v)
    return [2 * np.sum(outgoing * facet, axis=1, keepdims=True) * facet - outgoing, around(np.sqrt(share), turn)]


def _density(normal: FloatArray, outgoing: FloatArray, direction: FloatArray, alpha: float) -> FloatArray:
    """[rays] sum of the densities of both proposals, 1/sr."""
    half = _unit(direction + outgoing)
    cos_m, cos_d = np.abs(np.sum(half * normal, axis=1)), np.abs(np.sum(half * outgoing, axis=1))
    of_lobe = ndf(cos_m, alpha) * cos_m / (4 * np.maximum(cos_d, 1e-9))
    return np.asarray(np.maximum(np.sum(direction * normal, axis=1), 0.0) / np.pi + of_lobe)


def tangents(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors [..., 3] across unit vectors `normal` [..., 3], after Duff et al. 2017."""
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        np.stack([b, sign + y * y * a, -y], axis=-1),
    )


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))
