"""Mitsuba 3, which shares no code with this project, computes the same microfacet models and Fresnel reflectances."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from analysis.choices import Distribution
from analysis.reflectance.directions import Directions
from analysis.reflectance.fresnel import Conductor, fresnel_conductor, fresnel_dielectric
from analysis.reflectance.models import cook_torrance
from drivers.arrays import FloatArray

# looked for and not loaded: only the processes that render need it
pytestmark = pytest.mark.skipif(find_spec("mitsuba") is None, reason="Mitsuba is not installed")

RENDERER = """
import json, sys
import mitsuba as mi
mi.set_variant("scalar_rgb")
job = json.load(sys.stdin)
context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
index = lambda value: {"type": "uniform", "value": value}
lobes = []
for distribution, alpha, n, k in job["metals"]:
    bsdf = mi.load_dict({"type": "roughconductor", "distribution": distribution, "alpha": alpha,
                         "eta": index(n), "k": index(k)})
    values = []
    for incident, reflected in zip(job["incident"], job["reflected"]):
        at.wi = incident
        values.append(float(bsdf.eval(context, at, reflected)[0]))
    lobes.append(values)
json.dump({
    "lobes": lobes,
    "dielectric": [[mi.fresnel(c, eta)[0] for c in job["cosines"]] for eta in job["etas"]],
    "conductor": [[mi.fresnel_conductor(c, mi.Complex2f(n, k)) for c in job["cosines"]] for n, k in job["indices"]],
}, sys.stdout)
"""

COSINES = np.linspace(0.02, 1, 50)
ETAS = (1.0, 1.3, 1.5, 2.4)
INDICES = ((0.7308, 5.7568), (0.18, 3.0), (2.9, 3.1), (1.5, 0.01))
METALS = [(d, alpha, *INDICES[i]) for d in get_args(Distribution) for i, alpha in enumerate((0.1, 0.18, 0.4, 0.9))]


def _directions(count: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    cos, phi = rng.uniform(np.cos(np.radians(85)), 1, count), rng.uniform(-np.pi, np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


INCIDENT, REFLECTED = _directions(300, 1), _directions(300, 2)
# half of the pairs are near the mirror direction, where the lobes are
REFLECTED[:150] = INCIDENT[:150] * [-1, -1, 1] + np.random.default_rng(3).normal(0, 0.1, (150, 3))
REFLECTED[:150] /= np.linalg.norm(REFLECTED[:150], axis=-1, keepdims=True)
REFLECTED[:, 2] = np.abs(REFLECTED[:, 2])


@pytest.fixture(scope="module")
def mitsuba(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    job = {
        "metals": METALS,
        "incident": INCIDENT.tolist(),
        "reflected": REFLECTED.tolist(),
        "cosines": COSINES.tolist(),
        "etas": ETAS,
        "indices": INDICES,
    }
    answer = Path(tmp_path_factory.mktemp("mitsuba") / "answer.json")
    with answer.open("w") as out:
        subprocess.run([sys.executable, "-c", RENDERER], input=json.dumps(job), text=True, stdout=out, check=True)
    return {name: np.array(values) for name, values in json.loads(answer.read_text()).items()}


def test_a_rough_metal_is_as_bright_as_mitsuba_renders_it(mitsuba: dict[str, FloatArray]) -> None:
    half = INCIDENT + REFLECTED
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    directions = Directions(INCIDENT[:, 2], REFLECTED[:, 2], half[:, 2], np.sum(INCIDENT * half, axis=-1))
    wavelengths = np.array([550.0])
    for (distribution, alpha, n, k), rendered in zip(METALS, mitsuba["lobes"], strict=True):
        metal = Conductor("test", np.array([500.0, 600]), np.full(2, n), np.full(2, k))
        ours = cook_torrance(directions, wavelengths, alpha, metal, distribution=distribution)[:, 0]
        # it computes in single precision, and what is below its smallest density it calls zero
        ours, seen = ours * REFLECTED[:, 2], rendered > 1e-9
        assert seen.sum() > 100
        np.testing.assert_allclose(ours[seen], rendered[seen], rtol=1e-5, err_msg=f"{distribution} {alpha}")


def test_dielectrics_reflect_as_mitsuba_says(mitsuba: dict[str, FloatArray]) -> None:
    ours = [fresnel_dielectric(COSINES, eta) for eta in ETAS]
    np.testing.assert_allclose(ours, mitsuba["dielectric"], rtol=1e-5, atol=1e-8)


def test_metals_reflect_as_mitsuba_says(mitsuba: dict[str, FloatArray]) -> None:
    ours = [fresnel_conductor(COSINES, np.array(n), np.array(k)) for n, k in INDICES]
    np.testing.assert_allclose(ours, mitsuba["conductor"], rtol=1e-5)
