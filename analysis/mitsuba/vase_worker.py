"""Renders scenes by turns with Mitsuba, in a process of its own: `python -m analysis.mitsuba.vase_worker FOLDER`.

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

import analysis.mitsuba.ggx_shift  # noqa: F401  (makes its plugin known to the variant)
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
    shape = (len(job["seeds"]), len(scenes))
    images: list[list[Any]] = [[None] * shape[1] for _ in range(shape[0])]
    seconds, cpu_seconds = np.empty(shape), np.empty(shape)
    for turn, seed in enumerate(job["seeds"]):
        order = range(len(scenes))
        for i in order if turn % 2 == 0 else reversed(order):
            start, cpu_start = time.perf_counter(), time.process_time()
            images[turn][i] = _picture(scenes[i], job["samples"], seed)
            seconds[turn, i] = time.perf_counter() - start
            cpu_seconds[turn, i] = time.process_time() - cpu_start
    np.savez(
        folder / "out.npz",
        images=np.array(images),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        covered=_covered(scenes[0], job["shape"]),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
