"""Renders scenes by turns with Mitsuba, in a process of its own: `python -m analysis.render_worker FOLDER`.

The folder holds the scenes and `job.json`; `out.npz` is left in it: of every scene its pictures and how long they took,
and which pixels show nothing but the material. A vectorised variant may end the process without a word.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import mitsuba
import numpy as np

import analysis.ggx_shift  # noqa: F401  (makes its plugin known to the variant)
from drivers.arrays import BoolArray, FloatArray

mi: Any = mitsuba

_AT_ONCE = 2**21
"""Most ways of light that are followed at once; a vectorised variant keeps all of them in memory."""

_COVERAGE_SAMPLES = 16


def _picture(scene: Any, samples: int, seed: int) -> FloatArray:
    """[rows, columns, 3] linear BT.709."""
    columns, rows = scene.sensors()[0].film().crop_size()
    at_once = max(min(samples, _AT_ONCE // (rows * columns)), 1)
    passes = -(-samples // at_once)
    total: Any = 0.0
    for number in range(passes):
        total = total + np.array(mi.render(scene, spp=-(-samples // passes), seed=seed * passes + number))[..., :3]
    return np.asarray(total / passes, dtype=float)


def _covered(scene: Any, shape: str) -> BoolArray:
    """[rows, columns] pixels in which every sample of the camera meets a shape, which nothing may hide."""
    alone = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "aov", "aovs": "which:shape_index"},
            "sensor": scene.sensors()[0],
            "shape": next(each for each in scene.shapes() if each.id() == shape),
        }
    )
    # some number where the shape is met, which differs by variant, and zero elsewhere
    found = np.array(mi.render(alone, spp=_COVERAGE_SAMPLES))[..., -1]
    return np.asarray((found > 0) & (found > found.max() - 1e-3))


def main(folder: Path) -> None:
    """Do what `job.json` says."""
    job = json.loads((folder / "job.json").read_text())
    mi.set_variant(job["variant"])
    scenes = [mi.load_file(str(folder / name)) for name in job["scenes"]]
    for scene in scenes:
        _picture(scene, 1, 0)  # a vectorised variant compiles it now
    images, seconds = [], []
    for turn, seed in enumerate(job["seeds"]):
        row: list[tuple[FloatArray, float]] = [(np.empty(0), 0.0)] * len(scenes)
        order = range(len(scenes)) if turn % 2 == 0 else reversed(range(len(scenes)))
        for i in order:
            start = time.perf_counter()
            image = _picture(scenes[i], job["samples"], seed)
            row[i] = image, time.perf_counter() - start
        images.append([image for image, _ in row])
        seconds.append([taken for _, taken in row])
    np.savez(
        folder / "out.npz",
        images=np.array(images),
        seconds=np.array(seconds),
        covered=_covered(scenes[0], job["shape"]),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
