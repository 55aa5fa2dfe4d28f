"""A choice put to the test: the scene rendered by Mitsuba with the measurement, and with the models beside it."""

import math
from dataclasses import dataclass

import numpy as np

from analysis.mitsuba.run import Material, render
from analysis.mitsuba.scene import MitsubaScene
from analysis.scenes.choose import NODES, Choice, Judged, p95_of, without_noise
from analysis.scenes.ladder import Lambert, Rung
from analysis.scenes.vertices import Reflectance
from drivers.arrays import BoolArray, FloatArray

SAMPLES = 256
"""Of a pixel, each time that a scene is rendered."""

SEEDS = (1, 2)
"""Every scene is rendered so many times; all materials with the same random numbers."""

_FLAT = 1.0


@dataclass(frozen=True)
class Verified:
    """One model, as predicted and as rendered; CIEDE2000 over the pixels that show the material."""

    judged: Judged
    mean: float
    """Rendered."""
    p95: float
    u_render: float
    """Standard error of `mean` by the samples of the rendering."""


@dataclass(frozen=True)
class Verification:
    """Rendered images and what they say."""

    models: tuple[Verified, ...]
    """The chosen model first, and the next cheaper one, where there are any."""
    reference: FloatArray
    """[target pixels, 3] XYZ rendered with the measurement."""
    chosen: FloatArray
    """[target pixels, 3] XYZ rendered with the chosen model."""
    valid: BoolArray
    """[target pixels] False where the renderer gave no number."""


def verify(
    scene: MitsubaScene, choice: Choice, reference: Reflectance, alpha: float, samples: int = SAMPLES
) -> Verification | None:
    """Render a scene with the measurement, the chosen model and the next cheaper one; None where none was chosen.

    `reference` is what the choice was made by, and `alpha` about its roughness. Raises `RenderError`.
    """
    if choice.chosen is None:
        return None
    judged = [choice.chosen, *cheaper(choice)[-1:]]
    materials = [
        Material(reference, NODES, alpha),
        *(material_of(each.rung, each.wavelengths, alpha) for each in judged),
    ]
    seeds = [render(scene, materials, samples, seed) for seed in SEEDS]
    images = np.array([[image[choice.vertices.target] for image in of_seed] for of_seed in seeds])
    valid = np.isfinite(images).all(axis=(0, 1, 3))
    display, whole = choice.picture.display, images.mean(axis=0)
    verified = []
    for number, each in enumerate(judged, start=1):
        differences = display.difference(whole[0][valid], whole[number][valid])
        parts = [display.difference(of_seed[0][valid], of_seed[number][valid]) for of_seed in images]
        mean, noise = without_noise(float(differences.mean()), [float(part.mean()) for part in parts])
        p95, _ = without_noise(p95_of(differences), [p95_of(part) for part in parts])
        u_render = math.hypot(0.5 * float(parts[0].mean() - parts[1].mean()), noise)
        verified.append(Verified(each, mean, p95, u_render))
    return Verification(tuple(verified), whole[0], whole[1], valid)


def cheaper(choice: Choice) -> list[Judged]:
    """The rungs below the chosen one."""
    if choice.chosen is None:
        return list(choice.judged)
    names = [judged.rung.name for judged in choice.judged]
    return list(choice.judged[: names.index(choice.chosen.rung.name)])


def material_of(rung: Rung, wavelengths: FloatArray, alpha: float) -> Material:
    """A rung at `wavelengths`, nm, as it is rendered; `alpha` is about the roughness of the sample."""
    return Material(rung.model, wavelengths, _FLAT if isinstance(rung.model, Lambert) else alpha)
