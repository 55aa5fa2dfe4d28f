"""Renders materials in the vase's scene side by side, as Fig. 14 of the paper does, and compares what is seen.

Mitsuba runs in a process of its own, in the fastest variant that works on the computer: a vectorised one needs a
library of LLVM, and some versions of that end the process without a word, so it is tried on a small picture first.
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.colour import rgb_to_xyz
from analysis.errors import RenderError
from analysis.mitsuba.run import run_worker
from analysis.mitsuba.vase_scene import SceneFiles
from analysis.scenes.choose import p95_of, without_noise
from analysis.scenes.vertices import BRIGHT, DARK, Display, observer_white
from drivers.arrays import BoolArray, FloatArray

VARIANTS = ("llvm_ad_spectral", "scalar_spectral")
"""Of Mitsuba, the fastest first; the last one always works."""

SEEDS = (1, 2)
"""Every scene is rendered so many times; all materials with the same random numbers."""

_SHAPE, _SCENE = "vase", "scene.xml"


@dataclass(frozen=True)
class Variant:
    """How Mitsuba computes."""

    name: str
    refused: tuple[str, ...] = ()
    """What was tried before and does not work here, as sentences."""

    @property
    def vectorised(self) -> bool:
        """Whether a plugin in Python costs little."""
        return not self.name.startswith("scalar")


@dataclass(frozen=True)
class Pictures:
    """Scenes as they were rendered."""

    images: FloatArray
    """[seeds, scenes, rows, columns, 3] XYZ."""
    seconds: FloatArray
    """[seeds, scenes] that each took."""
    cpu_seconds: FloatArray
    """[seeds, scenes] of all processors together."""
    covered: BoolArray
    """[rows, columns] pixels that show nothing but the material."""


@dataclass(frozen=True)
class Comparison:
    """A picture of one material against that of another, CIEDE2000 over the pixels that show nothing but the material.

    Both are shown with one exposure, which maps the 99th percentile of Y of the first to 1; D65 is white.
    """

    display: Display
    first: FloatArray
    """[rows, columns, 3] XYZ."""
    second: FloatArray
    """[rows, columns, 3] XYZ."""
    covered: BoolArray
    """[rows, columns] where differences are taken."""
    difference: FloatArray
    """[rows, columns] dE00, NaN elsewhere; noise is in it."""
    mean: float
    """Without what the noise makes of it."""
    u_mean: float
    """Standard error of `mean` by the samples of the rendering."""
    p95: float
    """95th percentile, without what the noise makes of it."""
    clipped: float
    """Share of the pixels that are brighter than the display,"""
    dark: float
    """and of those in which a colour difference says little."""


def working_variant(scene: SceneFiles) -> Variant:
    """The fastest variant that renders a `scene`, which should be small. Raises `RenderError` where none does."""
    refused: list[str] = []
    for name in VARIANTS:
        try:
            found = render_scenes([scene], Variant(name), samples=1, seeds=(0,))
        except RenderError as error:
            if name == VARIANTS[-1]:
                raise
            refused.append(f"The variant {name} does not work here: {str(error).rstrip('.')}.")
            continue
        if np.isfinite(found.images).any():
            return Variant(name, tuple(refused))
        refused.append(f"The variant {name} renders no numbers here.")
    raise RenderError(" ".join(refused))


def render_scenes(scenes: list[SceneFiles], variant: Variant, samples: int, seeds: tuple[int, ...] = SEEDS) -> Pictures:
    """Pictures of scenes of one size, rendered by turns. Raises `RenderError` where Mitsuba is not there or fails."""
    with tempfile.TemporaryDirectory(prefix="goniometer-") as name:
        folder = Path(name)
        # each in a folder of its own, for files of two scenes may have one name
        for i, scene in enumerate(scenes):
            own = folder / str(i)
            own.mkdir()
            (own / _SCENE).write_text(scene.xml, encoding="utf-8")
            for file, content in scene.files.items():
                (own / file).write_bytes(content)
        job = {
            "variant": variant.name,
            "scenes": [f"{i}/{_SCENE}" for i in range(len(scenes))],
            "samples": samples,
            "seeds": seeds,
            "shape": _SHAPE,
        }
        (folder / "job.json").write_text(json.dumps(job))
        found = run_worker("analysis.mitsuba.vase_worker", folder)
        return Pictures(rgb_to_xyz(found["images"]), found["seconds"], found["cpu_seconds"], found["covered"])


def compare(pictures: Pictures, first: int = 0, second: int = 1) -> Comparison:
    """Two of the scenes of `pictures`, by their number.

    One exposure brings the 99th percentile of Y of the first to white. What the noise makes of mean and 95th percentile
    is told by the differences of single seeds and taken off in squares (`analysis.scenes.choose.without_noise`). Raises
    `RenderError` where no pixel shows nothing but the material.
    """
    images = pictures.images[:, [first, second]]
    whole = images.mean(axis=0)
    covered = pictures.covered & np.isfinite(images).all(axis=(0, 1, 4))
    if not covered.any():
        raise RenderError("No pixel shows nothing but the material; render more pixels.")
    seen = whole[0][covered]
    bright = float(np.percentile(seen[:, 1], BRIGHT))
    display = Display(1 / bright if bright > 0 else 1.0, observer_white())
    differences = display.difference(seen, whole[1][covered])
    parts = [display.difference(each[0][covered], each[1][covered]) for each in images]
    mean, noise = without_noise(float(differences.mean()), [float(part.mean()) for part in parts])
    p95, _ = without_noise(p95_of(differences), [p95_of(part) for part in parts])
    spread = float(np.std([part.mean() for part in parts]) / np.sqrt(len(parts)))
    picture = np.full(covered.shape, np.nan)
    picture[covered] = differences
    return Comparison(
        display=display,
        first=whole[0],
        second=whole[1],
        covered=covered,
        difference=picture,
        mean=mean,
        u_mean=float(np.hypot(spread, noise)),
        p95=p95,
        clipped=float(np.mean(display.shown(seen).max(axis=1) >= 1.0)),
        dark=float(np.mean(seen[:, 1] * display.exposure < DARK)),
    )
