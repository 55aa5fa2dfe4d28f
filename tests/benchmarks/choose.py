"""Predicted against rendered colour differences, and whether the chosen model is the simplest that will do.

    python -m tests.benchmarks.choose [SAMPLES]

needs Mitsuba. Six scenes, the last one of Mitsuba's own
with light that other surfaces scatter, and four materials: two whose truth is a formula, two that are known by the
table of a measurement alone. Of each the chosen model and the next cheaper one are rendered with SAMPLES (512) of a
pixel, twice.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.fits.by_name import fit_models, local_fit_for
from analysis.mitsuba.run import Material, trace_mitsuba
from analysis.mitsuba.scene import MitsubaScene, read_mitsuba, write_mitsuba
from analysis.mitsuba.verify import verify
from analysis.reflectance.directions import Directions
from analysis.reflectance.distributions import g1, ndf
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.models import cook_torrance, cosine_slope, shift, theta_m
from analysis.results import ModelFit
from analysis.scenes.brdf_table import BrdfTable, Reference, reference_table
from analysis.scenes.choose import NODES, choose
from analysis.scenes.ladder import METAL_FITS, roughness
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import Vertices
from drivers.arrays import FloatArray
from tests.analysis.conftest import _measure
from tests.analysis.test_choose import without_draws
from tests.benchmarks.figures import tell

TOLERANCE = 1.0
PIXELS = (20, 20)

CAMERA: dict[str, Any] = {"position": (0.0, -4.0, 1.0), "pixels": PIXELS, "field_of_view": 30.0}
BALL = [{"sphere": 1.0}]
SCENES: dict[str, dict[str, Any] | str] = {
    "sun": {"camera": CAMERA, "material": BALL, "lights": [{"sun": (1.0, -1.0, 1.0)}]},
    "lamps": {
        "camera": CAMERA,
        "material": BALL,
        "lights": [{"lamp": (1.5, -2.5, 2.0), "power": 10.0}, {"lamp": (-2.5, -1.0, 0.5), "power": 6.0}],
    },
    "grazing": {
        "camera": CAMERA | {"position": (0.0, -6.0, 1.2), "field_of_view": 15.0},
        "material": [{"rectangle": (8.0, 8.0)}],
        "lights": [{"sun": (0.3, 1.0, 0.35)}],
    },
    "environment": {"camera": CAMERA, "material": BALL, "lights": [{"environment": 1.0}]},
    "sky and sun": {
        "camera": CAMERA,
        "material": BALL,
        "blockers": [{"disc": 3.0, "centre": (0.0, 0.0, -1.0)}],
        "lights": [{"sky": (0.4, 0.8)}, {"sun": (-1.0, -0.6, 1.2), "power": 2.0}],
    },
    "room": """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="28"/>
    <transform name="to_world"><lookat origin="0,-4.5,1.5" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="20"/></film></sensor>
  <bsdf type="roughconductor" id="sample"/>
  <bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.6,0.1,0.1"/></bsdf>
  <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.7,0.7,0.7"/></bsdf>
  <shape type="sphere"><ref id="sample"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
    <ref id="white"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate y="1" angle="90"/>
    <translate x="-2.5"/></transform><ref id="red"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="0.8"/><rotate x="1" angle="180"/>
    <translate x="1.5" y="-1.5" z="3"/></transform>
    <emitter type="area"><spectrum name="radiance" type="d65"><float name="scale" value="12"/></spectrum></emitter>
  </shape>
  <emitter type="constant"><spectrum name="radiance" type="d65"><float name="scale" value="0.3"/></spectrum></emitter>
</scene>""",
}

Truth = Callable[[Directions, FloatArray], FloatArray]


@dataclass(frozen=True)
class Formula(BrdfTable):
    """A reference that is a formula; the table beside it is only the ladder's last rung."""

    truth: Truth

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr."""
        return self.truth(directions, wavelengths)


def _shifted(alpha: float, h: float, w: float) -> Truth:
    return lambda directions, wavelengths: cook_torrance(directions, wavelengths, alpha, load_conductor(), h, w)


def _of_normals(distribution: Callable[[FloatArray], FloatArray], alpha: float, h: float, w: float) -> Truth:
    """A lobe that no rung can represent."""

    def truth(directions: Directions, wavelengths: FloatArray) -> FloatArray:
        cos_i, cos_o = (np.maximum(c, 1e-6) for c in (directions.cos_i, directions.cos_o))
        lobe = distribution(np.maximum(directions.cos_m, 1e-3)) * g1(cos_i, alpha) * g1(cos_o, alpha)
        lobe = lobe / (4 * cos_i * cos_o) * ((directions.cos_i > 0) & (directions.cos_o > 0))
        fresnel = fresnel_conductor(directions.cos_d[..., None], *load_conductor().index(wavelengths))
        return np.asarray(lobe[..., None] * fresnel * shift(cosine_slope(theta_m(directions), h, w), wavelengths))

    return truth


MATERIALS: dict[str, tuple[float, Truth, bool]] = {
    "sample 3": (0.209, _shifted(0.209, 1.35, 3.0), False),
    "sample 5": (0.113, _shifted(0.113, 0.9, 4.5), False),
    "GGX and Beckmann": (
        0.2,
        _of_normals(lambda c: 0.5 * ndf(c, 0.15) + 0.5 * ndf(c, 0.3, "beckmann"), 0.2, 1.0, 3.0),
        True,
    ),
    "two lobes": (0.2, _of_normals(lambda c: 0.3 * ndf(c, 0.08) + 0.7 * ndf(c, 0.35), 0.3, 1.0, 3.0), True),
}
"""About which roughness, the truth, and whether it is known as a table only."""


def known(alpha: float, truth: Truth, *, as_table: bool) -> tuple[Reference, tuple[ModelFit, ...]]:
    """A material as it was measured, and the fits to that."""
    dataset = _measure(alpha, brdf=truth, wavelength_step=9.0, noise=1e-3, incident=tuple(range(0, 81, 10)))
    local = local_fit_for(dataset, METAL_FITS)
    fits = fit_models(dataset, local, METAL_FITS)
    reference = without_draws(reference_table(dataset, roughness(fits)))
    if as_table:
        return reference, fits
    table = reference.table
    formula = Formula(table.theta_h, table.theta_d, table.wavelengths, table.log_q, table.guide, truth)
    return replace(reference, table=formula), fits


def tracer(
    scene: dict[str, Any] | str, reference: Reference, alpha: float, folder: Path
) -> tuple[MitsubaScene, Callable[[int], Vertices]]:
    """A scene for Mitsuba, and how its vertices are found."""
    if isinstance(scene, str):
        path = folder / "room.xml"
        path.write_text(scene)
        room = read_mitsuba(path)
        return room, lambda samples: trace_mitsuba(room, Material(reference.table, NODES, alpha), 4 * samples)
    own = Scene.model_validate(scene)
    return write_mitsuba(own), lambda samples: trace(own, alpha, 4 * samples)


def main(samples: int = 512) -> None:
    """Print a row for each scene and material."""
    print(
        "scene        material          model                  nm  predicted       rendered          agree  "
        "next cheaper          predicted  rendered"
    )
    agree = right = count = 0
    with tempfile.TemporaryDirectory() as name:
        for material, (_, truth, as_table) in MATERIALS.items():
            reference, fits = known(MATERIALS[material][0], truth, as_table=as_table)
            alpha = roughness(fits)
            for title, scene in SCENES.items():
                count += 1
                for_mitsuba, trace_it = tracer(scene, reference, alpha, Path(name))
                choice = choose(trace_it, reference, fits, load_conductor(), TOLERANCE)
                found = verify(for_mitsuba, choice, reference.table, alpha, samples)
                if found is None or choice.chosen is None:
                    print(f"{title:<12} {material:<17} undetermined or none")
                    continue
                best, *others = found.models
                score = best.judged.score
                close = all(
                    abs(each.mean - each.judged.score.mean) <= max(0.1 * each.mean, 0.05)
                    and abs(each.p95 - each.judged.score.p95) <= max(0.15 * each.p95, 0.05)
                    for each in found.models
                )
                simplest = best.mean <= TOLERANCE and all(each.mean > TOLERANCE for each in others)
                agree, right = agree + close, right + simplest
                rest = "  ".join(
                    f"{o.judged.rung.name:<20} {o.judged.score.mean:5.2f} {o.judged.score.p95:5.2f}  "
                    f"{o.mean:5.2f} ±{o.u_render:.2f} {o.p95:5.2f}"
                    for o in others
                )
                print(
                    f"{title:<12} {material:<17} {best.judged.rung.name:<22} {best.judged.wavelengths.size:2d}  "
                    f"{score.mean:.3f} {score.p95:.3f}  {best.mean:.3f} ±{best.u_render:.3f} {best.p95:.3f}  "
                    f"{'yes' if close else 'NO':<5}  {rest}  {'' if simplest else 'NOT THE SIMPLEST'}",
                    flush=True,
                )
    of_all, because = f"of {count}", f"noise of {samples} samples a pixel"
    tell("predicted and rendered dE00 agree: mean in 10 %, p95 in 15 %, or 0.05", agree, of_all, f"= {count}", because)
    tell("the chosen model meets the tolerance, the next cheaper one fails it", right, of_all, f"= {count}", because)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
