"""Traces, renders and times a Mitsuba scene, in a process of its own: `python -m analysis.mitsuba.worker FOLDER`.

The folder holds a scene for each material, `0.xml` and so on, what these need, and `job.json`; `out.npz` is left in it.
The material is the BSDF with the id "sample". Only scalar variants are used, which need no compiler on the computer.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from analysis.tradeoff import Candidate, race

NODES = (440.0, 515.0, 590.0, 665.0)
"""Wavelengths at which the light of a traced scene is known, nm; as many as a spectral ray of Mitsuba has."""

COSINE_SHARE = 0.25
"""Of the samples that do not follow the lobe, so that other lobes are not missed."""

NARROWEST_LOBE = 0.02
"""Roughness below which these samples do not get narrower."""

SAMPLE = "sample"
"""Id of the BSDF that stands for the material."""


class Proposal:
    """Directions in which to look for light, in the local frame: a lobe and a cosine."""

    def __init__(self, alpha: float) -> None:
        self._lobe = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, max(alpha, NARROWEST_LOBE), False)

    def draw(self, wi: Any, sampler: Any) -> Any:
        """One direction."""
        choice, two = sampler.next_1d(), sampler.next_2d()
        if choice < COSINE_SHARE:
            return mi.warp.square_to_cosine_hemisphere(two)
        normal, _ = self._lobe.sample(wi, two)
        return mi.reflect(wi, normal)

    def density(self, wi: Any, wo: Any) -> float:
        """By solid angle; zero below the horizon."""
        if wo.z <= 0:
            return 0.0
        total = wi + wo
        length = math.sqrt(total.x**2 + total.y**2 + total.z**2)
        half = total / length
        cos_d = wo.x * half.x + wo.y * half.y + wo.z * half.z
        of_lobe = self._lobe.pdf(wi, half) / (4 * max(cos_d, 1e-9))
        return float(COSINE_SHARE * wo.z / math.pi + (1 - COSINE_SHARE) * of_lobe)


class Tracer:
    """Looks from the camera for the light that reaches the material, all that the scene scatters included."""

    def __init__(self, scene: Any, alpha: float) -> None:
        self._scene = scene
        self._proposal = Proposal(alpha)
        self._path = mi.load_dict({"type": "path", "max_depth": 6, "hide_emitters": True})

    def towards_emitter(self, si: Any, sampler: Any) -> tuple[Any, Any] | None:
        """Local direction and radiance x share x cosine / density of a sample of the emitters."""
        ds, radiance = self._scene.sample_emitter_direction(si, sampler.next_2d(), True)
        wo = si.to_local(ds.d)
        if ds.pdf == 0 or wo.z <= 0:
            return None
        share = 1.0 if ds.delta else ds.pdf / (ds.pdf + self._proposal.density(si.wi, wo))
        return wo, radiance * (share * wo.z)

    def as_reflected(self, si: Any, ray: Any, sampler: Any) -> tuple[Any, Any] | None:
        """The same of a sample of where the material may reflect, with light that came from other surfaces."""
        wo = self._proposal.draw(si.wi, sampler)
        density = self._proposal.density(si.wi, wo)
        if density == 0:
            return None
        onward = si.spawn_ray(si.to_world(wo))
        onward.wavelengths = ray.wavelengths
        there = self._scene.ray_intersect(onward)
        emitter = there.emitter(self._scene)
        light = mi.Spectrum(0.0)
        if emitter is not None:
            ds = mi.DirectionSample3f(self._scene, there, si)
            other = self._scene.pdf_emitter_direction(si, ds)
            light += emitter.eval(there) * (density / (density + other))
        if there.is_valid():
            scattered, _, _ = self._path.sample(self._scene, sampler, mi.RayDifferential3f(onward))
            light += scattered
        return wo, light * (wo.z / density)


def trace(scene: Any, samples: int, seed: int, alpha: float) -> dict[str, Any]:
    """All ways of light to the material that the camera sees directly, from its front."""
    sensor = scene.sensors()[0]
    columns, rows = (int(v) for v in sensor.film().crop_size())
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, 1)
    tracer = Tracer(scene, alpha)
    complete = np.ones(rows * columns, dtype=bool)
    found: list[tuple[float, ...]] = []
    for pixel in range(rows * columns):
        for number in range(samples):
            two = sampler.next_2d()
            at = mi.Point2f((pixel % columns + two.x) / columns, (pixel // columns + two.y) / rows)
            ray, _ = sensor.sample_ray_differential(0.0, 0.5, at, sampler.next_2d())
            ray.wavelengths = mi.Spectrum(NODES)
            si = scene.ray_intersect(ray)
            if not si.is_valid() or si.bsdf().id() != SAMPLE or si.wi.z <= 0:
                complete[pixel] = False
                break
            si.wavelengths = ray.wavelengths
            for way in (tracer.towards_emitter(si, sampler), tracer.as_reflected(si, ray, sampler)):
                if way is None:
                    continue
                wo, light = way
                found.append((pixel, 2 * number // samples, *si.wi, *wo, *light))
    table = np.array(found, dtype=float).reshape(-1, 12)
    light = table[:, 8:] / (samples / 2)
    kept = np.isfinite(light).all(axis=1) & (light > 0).any(axis=1)
    kept &= complete[table[:, 0].astype(int)]
    return {
        "pixel": table[kept, 0].astype(int),
        "half": table[kept, 1].astype(int),
        "wi": table[kept, 2:5],
        "wo": table[kept, 5:8],
        "weight": light[kept],
        "complete": complete,
        "size": np.array([rows, columns]),
    }


def rendered(scene: Any, samples: int, seed: Any) -> Any:
    """[rows, columns, 3]"""
    return np.array(mi.render(scene, spp=samples, seed=seed))[..., :3]


def timed(scenes: list[tuple[str, Any]], samples: int, rounds: int) -> dict[str, Any]:
    """Seconds [scenes, quartiles] of rendering `scenes`, each of a variant, by turns, and their halves of an image."""

    def way(number: int, variant: str, scene: Any) -> Candidate:
        def run(of_round: int) -> Any:
            mi.set_variant(variant)
            return np.stack([rendered(scene, samples // 2, 2 * of_round + half) for half in (0, 1)])

        return Candidate(str(number), "", variant, run)

    found = race([way(number, *scene) for number, scene in enumerate(scenes)], rounds)
    images = {each.candidate.name: np.mean(each.results, axis=0) for each in found}
    return images | {"seconds": np.array([[each.low, each.middle, each.high] for each in found])}


def main(folder: Path) -> None:
    """Do what `job.json` says."""
    job = json.loads((folder / "job.json").read_text())
    mi.set_variant("scalar_spectral")
    for place in (job["resources"], str(folder)):
        mi.file_resolver().append(place)  # type: ignore[operator]  # its stub calls it an object
    for image in job["images"]:
        mi.Bitmap(np.load(folder / f"{image}.npy", allow_pickle=False).astype(np.float32)).write(str(folder / image))
    scenes = []
    for number, variant in enumerate(job["variants"]):
        mi.set_variant(variant)
        scenes.append((variant, mi.load_file(str(folder / f"{number}.xml"))))
    if job["what"] == "trace":
        results = trace(scenes[0][1], job["samples"], job["seed"], job["alpha"])
    elif job["what"] == "time":
        results = timed(scenes, job["samples"], job["rounds"])
    else:
        results = {str(n): rendered(scene, job["samples"], job["seed"]) for n, (_, scene) in enumerate(scenes)}
    np.savez(folder / "out.npz", **results)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
