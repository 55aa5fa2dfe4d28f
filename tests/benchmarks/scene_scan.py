"""Points and minutes of scans that are driven by a scene, beside those of a scan of all directions.

    python -m tests.benchmarks.scene_scan [TOLERANCE [MATERIAL ...]]

All materials are known exactly
(`sampling_materials`) and are measured as in `sampling`. The scan of all directions is that of a campaign without any
wish (0.005 and dE00 0.2); the same with the scene's TOLERANCE (0.5) alone stands beside it. The error of both is that
of the scene's image: mean dE00 between the material and what its scan tells of it. The weights of a scene are those of
the material itself, as of an earlier measurement.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from analysis.reflectance.directions import in_plane
from analysis.scenes.asked import asked, scene_weights
from analysis.scenes.brdf_table import BrdfTable, Visibility, folded, table_nodes
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import Vertices, display_for, to_pixels, xyz_of_vertices
from drivers.arrays import FloatArray
from goniometer.interpolation.interpolant import predict_values
from goniometer.plans.plan import Measured, interpolation, next_points, reached
from goniometer.plans.plan_spec import PlanSpec
from simulators.costs.scans import bench_minutes
from tests.benchmarks.choose import CAMERA
from tests.benchmarks.choose import SCENES as OF_CHOICE
from tests.benchmarks.figures import tell
from tests.benchmarks.sampling import SPEC, measure
from tests.benchmarks.sampling_materials import BANDS, MATERIALS, Truth

SCENES = OF_CHOICE | {
    "table top": {
        "camera": CAMERA | {"position": (0.0, -5.0, 4.0), "field_of_view": 20.0},
        "material": [{"rectangle": (8.0, 8.0)}],
        "lights": [{"sun": (0.3, 1.0, 0.9)}],
    }
}
DIRECTIONAL = ("sun", "lamps", "table top")
AROUND = ("environment", "sky and sun")
CHOSEN = ("GGX 0.05", "GGX 0.126", "GGX 0.25", "GGX 0.41", "two lobes", "GGX and Beckmann")
VISIBLE = BANDS[:3]


def scan(truth: Truth, spec: PlanSpec) -> tuple[list[Measured], str]:
    """Measure until the plan wants no more."""
    random = np.random.default_rng(5)
    measured: list[Measured] = []
    while batch := next_points(spec, measured):
        measured += measure(truth, batch, random)
    return measured, str(reached(spec, measured).stopped)


def table(truth: Truth, values: Any) -> BrdfTable:
    """A table of cos(theta_in) f [points, bands] that `values` gives of theta_in and theta_out [points]."""
    theta_h, theta_d = table_nodes(truth.alpha)
    theta_in, theta_out = folded(*(grid.ravel() for grid in np.meshgrid(theta_h, theta_d, indexing="ij")))
    cosine: FloatArray = values(theta_in, theta_out)[:, : VISIBLE.size]
    brdf = np.maximum(cosine, 1e-9) / np.cos(np.radians(theta_in))[:, None]
    guide = Visibility(truth.alpha)
    log_q = np.log(brdf / guide(in_plane(theta_in, theta_out), VISIBLE))
    return BrdfTable(theta_h, theta_d, VISIBLE, log_q.reshape(theta_h.size, theta_d.size, -1), guide)


def error(vertices: Vertices, truth: BrdfTable, spec: PlanSpec, measured: Sequence[Measured], of: Truth) -> float:
    """Mean dE00 of the image."""
    process = interpolation(spec, measured)
    assert process is not None  # every scan has points enough
    told = table(of, lambda theta_in, theta_out: predict_values(process, theta_in, theta_out)[0])
    exact, read = (to_pixels(vertices, xyz_of_vertices(vertices, t, VISIBLE)).mean(axis=0) for t in (truth, told))
    return float(display_for(vertices, exact).difference(exact, read).mean())


def main(tolerance: float = 0.5, names: Sequence[str] = CHOSEN) -> None:
    """Print a row for each material and scene, and the medians."""
    print(
        "material          scene         points min   error      all: points min   error   same tolerance: points error"
    )
    ratios: dict[str, list[float]] = {"directional": [], "around": []}
    alone_ratios: dict[str, list[float]] = {"directional": [], "around": []}
    met = count = 0
    for name in names:
        truth = MATERIALS[name]
        exact = table(truth, truth)
        alone_spec = replace(SPEC, tolerance=math.inf, colour_tolerance=tolerance)
        full, _ = scan(truth, SPEC)
        alone, _ = scan(truth, alone_spec)
        for title in (*DIRECTIONAL, *AROUND):
            scene = Scene.model_validate(SCENES[title])
            vertices = trace(scene, truth.alpha, 64)
            xyz = xyz_of_vertices(vertices, exact, VISIBLE)
            found = asked(vertices, xyz, display_for(vertices, to_pixels(vertices, xyz).mean(axis=0)))
            weights = scene_weights(found, title)
            spec = replace(
                SPEC,
                tolerance=math.inf,
                colour_tolerance=tolerance,
                importance=weights.importance,
                colour_slope=weights.colour_slope,
            )
            measured, stopped = scan(truth, spec)
            mine = error(vertices, exact, spec, measured, truth)
            kind = "directional" if title in DIRECTIONAL else "around"
            ratios[kind].append(len(measured) / len(full))
            alone_ratios[kind].append(len(measured) / len(alone))
            met, count = met + (mine <= tolerance), count + 1
            print(
                f"{name:<17} {title:<13} {len(measured):4d} {bench_minutes(measured):6.1f} {mine:6.3f} {stopped:<9}"
                f" {len(full):5d} {bench_minutes(full):6.1f} {error(vertices, exact, SPEC, full, truth):6.3f}"
                f" {len(alone):10d} {error(vertices, exact, alone_spec, alone, truth):6.3f}"
                f"   not measurable {1 - found.measurable:.1%}",
                flush=True,
            )
    kinds = {"directional": ("directional lights", "<= 0.25"), "around": ("environments", "<= 0.667")}
    for kind, (lights, aim) in kinds.items():
        alone_ratio = f"({np.median(alone_ratios[kind]):.2f} of one of the same tolerance)"
        what = f"{lights}, dE00 {tolerance:g}: points over those of a scan of all directions, median"
        tell(what, np.median(ratios[kind]), alone_ratio, aim)
    tell("scans that reach the tolerance in their scene", met, f"of {count}", f"= {count}")


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]), *([sys.argv[2:]] if sys.argv[2:] else []))
