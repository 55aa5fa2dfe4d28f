"""What Mitsuba makes of a scene: its vertices, and what it looks like with a material, and how long that takes.

Mitsuba runs in a process of its own, for it may be missing, and a fault in it must not end this one. Light is traced
with all that the scene scatters; its spectrum is known at four wavelengths and taken as that of D65 times what is
linear between these, which lamps with lines in their spectrum are not.
"""

import json
import subprocess  # nosec B404 # runs this Python only
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from analysis.bsdf.fields import bsdf_content
from analysis.colour import observer
from analysis.errors import RenderError, SceneError
from analysis.mitsuba.scene import CIE_Y, STEP, MitsubaScene
from analysis.reflectance.directions import from_vectors
from analysis.scenes.rays import WAVELENGTHS
from analysis.scenes.vertices import Reflectance, Vertices
from drivers.arrays import FloatArray

LIGHT_NODES = np.array([440.0, 515.0, 590.0, 665.0])
"""Wavelengths at which the light of a traced scene is known, nm; those of `analysis.mitsuba.worker`."""

Variant = Literal["scalar_spectral", "scalar_rgb"]
"""Whether light is four wavelengths of a spectrum, or red, green and blue; neither needs a compiler."""


@dataclass(frozen=True)
class Material:
    """A reflectance as Mitsuba is to render it."""

    reflectance: Reflectance
    nodes: FloatArray
    """[nodes] wavelengths, nm, between which it is linear and beyond which it is constant."""
    alpha: float
    """Roughness of its lobe; 1 where it has none."""
    variant: ClassVar[Variant] = "scalar_spectral"

    def content(self) -> bytes:
        """The file that the plugin `measured` reads."""
        if self.nodes.size > 1:
            return bsdf_content(self.reflectance, self.alpha, self.nodes)
        # the plugin wants two wavelengths
        return bsdf_content(
            lambda directions, two: self.reflectance(directions, np.repeat(self.nodes, two.size)),
            self.alpha,
            np.array([500.0, 600.0]),
        )

    def element(self, file: Path) -> str:
        """The BSDF in a scene, its tables written to `file`."""
        file.write_bytes(self.content())
        return bsdf_element("measured", f'<string name="filename" value="{file}"/>')


@dataclass(frozen=True)
class Plugin:
    """A BSDF that Mitsuba has a formula for."""

    name: str
    settings: str
    """Its parameters as elements of XML."""
    variant: Variant = "scalar_spectral"

    def element(self, _: Path) -> str:
        """The BSDF in a scene."""
        return bsdf_element(self.name, self.settings)


def bsdf_element(kind: str, inside: str) -> str:
    """The material of a scene, in XML: a plugin of Mitsuba with its parameters."""
    return f'<bsdf type="{kind}" id="sample">{inside}</bsdf>'


def trace_mitsuba(scene: MitsubaScene, stand_in: Material, samples: int = 64) -> Vertices:
    """The vertices of a Mitsuba scene, light that other surfaces scatter included.

    `stand_in` is the material where its own light comes back to it, and its lobe tells where light is looked for.
    Raises `RenderError` where Mitsuba is not there or fails, and `SceneError` where the scene shows nothing of the
    material.
    """
    job = {"what": "trace", "samples": samples, "seed": 1, "alpha": stand_in.alpha}
    found = _run(scene, job, [stand_in])
    if not found["complete"].any():
        raise SceneError('No pixel of the scene shows the material "sample" alone, directly and from its front.')
    inside = found["complete"][found["pixel"]]
    if not inside.any():
        raise SceneError("No light of the scene falls on the material where the camera sees it.")
    rows, columns = (int(v) for v in found["size"])
    up = np.array([0.0, 0.0, 1.0])
    hats = np.stack([np.interp(WAVELENGTHS, LIGHT_NODES, row) for row in np.eye(LIGHT_NODES.size)])
    at_nodes = np.interp(LIGHT_NODES, WAVELENGTHS, scene.white)
    return Vertices(
        rows=rows,
        columns=columns,
        pixel=found["pixel"][inside].astype(np.intp),
        half=found["half"][inside].astype(np.intp),
        directions=from_vectors(found["wo"][inside].astype(float), found["wi"][inside].astype(float), up),
        weight=found["weight"][inside].astype(float),
        wavelengths=WAVELENGTHS,
        light=hats * (scene.white / at_nodes[:, None]),
        white=scene.white,
        target=found["complete"],
        exposure=scene.exposure,
    )


def render(scene: MitsubaScene, materials: list[Material], samples: int, seed: int = 1) -> list[FloatArray]:
    """[rows x columns, 3] XYZ of a scene with each material, the white having Y = 1, all with the same random numbers.

    Pixels that came out as no number are NaN. Raises `RenderError` where Mitsuba is not there or fails.
    """
    found = _run(scene, {"what": "render", "samples": samples, "seed": seed}, materials)
    return [_xyz(scene, found[str(i)]).reshape(-1, 3) for i in range(len(materials))]


@dataclass(frozen=True)
class RenderTimes:
    """What it took to render a scene with one material."""

    low: float
    """Lower quartile of the rounds, s."""
    middle: float
    """Median, s."""
    high: float
    """Upper quartile, s."""
    halves: FloatArray
    """[2, rows x columns, 3] XYZ as of `render`, from half of the samples of all rounds each."""


def time_renders(
    scene: MitsubaScene, materials: Sequence[Material | Plugin], samples: int, rounds: int
) -> list[RenderTimes]:
    """Render a scene with each of `materials` by turns, `rounds` times after a first one that does not count.

    An image has `samples` of a pixel, in two halves. What is timed is the rendering alone: neither the start of the
    process nor the reading of the scene. Raises `RenderError` where Mitsuba is not there or fails.
    """
    found = _run(scene, {"what": "time", "samples": samples, "rounds": rounds}, materials)
    return [
        RenderTimes(float(low), float(middle), float(high), _xyz(scene, found[str(i)]).reshape(2, -1, 3))
        for i, (low, middle, high) in enumerate(found["seconds"])
    ]


def _xyz(scene: MitsubaScene, image: FloatArray) -> FloatArray:
    """Mitsuba's XYZ as those of which white has Y = 1."""
    white = float(scene.white @ observer(WAVELENGTHS)[:, 1]) * STEP
    return np.asarray(image.astype(float) * (CIE_Y / white))


def _run(scene: MitsubaScene, job: dict[str, Any], materials: Sequence[Material | Plugin]) -> dict[str, Any]:
    """Let the worker do a job, and return what it leaves."""
    with tempfile.TemporaryDirectory(prefix="goniometer-") as name:
        folder = Path(name)
        for i, material in enumerate(materials):
            with_material = scene.with_material(material.element(folder / f"{i}.bsdf"))
            (folder / f"{i}.xml").write_text(with_material, encoding="utf-8")
        for image, values in scene.images.items():
            np.save(folder / f"{image}.npy", values)
        whole = job | {
            "variants": [material.variant for material in materials],
            "resources": str(scene.resources),
            "images": list(scene.images),
        }
        (folder / "job.json").write_text(json.dumps(whole))
        return run_worker("analysis.mitsuba.worker", folder)


def run_worker(module: str, folder: Path) -> dict[str, Any]:
    """Arrays by name that a worker leaves in `out.npz` of a folder with its job.

    Raises `RenderError` where Mitsuba is not there or fails.
    """
    command = [sys.executable, "-m", module, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # nosec B603 # nothing of it is foreign
    if done.returncode < 0:
        raise RenderError(f"Mitsuba ended by signal {-done.returncode}.")
    if done.returncode != 0:
        raise RenderError(_why(done.stderr))
    with np.load(folder / "out.npz", allow_pickle=False) as arrays:
        return {key: arrays[key] for key in arrays.files}


def _why(told: str) -> str:
    """What is wrong, from the last words of the worker."""
    last = next((line.strip() for line in reversed(told.splitlines()) if line.strip()), "it said nothing")
    if "No module named 'mitsuba'" in told:
        return 'Mitsuba is not installed; install the extra "render": pip install "goniometer[render]".'
    return f"Mitsuba failed: {last}"
