"""The plugin for Mitsuba 3 is the fitted model, samples as it says, and never makes light."""

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import analysis.mitsuba.vase_scene
from analysis.colour import xyz_to_rgb, xyz_weights
from analysis.reflectance.directions import Directions, from_vectors
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.models import cook_torrance, cosine_slope, dielectric, shift, theta_m
from drivers.arrays import FloatArray

# looked for and not loaded: only the processes that render need it
pytestmark = pytest.mark.skipif(find_spec("mitsuba") is None, reason="Mitsuba is not installed")

N, K, ALPHA, ETA, H, W = 0.73, 5.75, 0.3, 1.5, 1.6, 2.3
WAVELENGTHS = np.array([420.0, 520.0, 600.0, 700.0])
ALBEDO = 0.4
ALPHAS = (0.1, 0.3, 0.8)
FURNACE_ANGLES = (0.0, 40.0, 70.0, 82.0, 88.0)
STRONG = {"alpha": 0.3, "h": 4.0, "w": 1.0}

WORKER = """
import json, sys
import numpy as np
import mitsuba as mi
import analysis.mitsuba.ggx_shift
job = json.load(open(sys.argv[1]))
mi.set_variant(job["variant"])
mi.set_log_level(mi.LogLevel.Error)
context = mi.BSDFContext()

def made(parameters):
    spectra = {"eta", "k", "diffuse_reflectance"}
    return mi.load_dict({n: {"type": "uniform", "value": v} if n in spectra else v for n, v in parameters.items()})

def at(wi):
    si = mi.SurfaceInteraction3f()
    si.wi = wi
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(*job["wavelengths"])
    return si

answer = {}
for name, (what, parameters, incident, others) in job["tasks"].items():
    bsdf = made(parameters)
    if what == "eval":
        seen = (bsdf.eval_pdf(context, at(i), mi.Vector3f(o)) for i, o in zip(incident, others))
        answer[name] = [[*value, density] for value, density in seen]
    else:
        found = []
        for i in incident:
            si = at(i)
            drawn = (bsdf.sample(context, si, a, mi.Point2f(b, c)) for a, b, c in others)
            found.append([[*s.wo, s.pdf, *weight] for s, weight in drawn])
        answer[name] = found
with open(sys.argv[2], "w") as file:
    json.dump(answer, file)
"""


def _metal(**more: float) -> dict[str, Any]:
    return {"type": "ggx_shift", "alpha": ALPHA, "eta": N, "k": K, **more}


def _dielectric(albedo: float = ALBEDO, **more: float) -> dict[str, Any]:
    return {"type": "ggx_shift", "alpha": ALPHA, "int_ior": ETA, "diffuse_reflectance": albedo, **more}


def _directions(count: int, seed: int, largest: float = 85.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    cos, phi = rng.uniform(np.cos(np.radians(largest)), 1, count), rng.uniform(-np.pi, np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def _at(degrees: float) -> list[float]:
    return [float(np.sin(np.radians(degrees))), 0.0, float(np.cos(np.radians(degrees)))]


def _grid(side: int) -> FloatArray:
    """Even samples of the unit square, with a third number before them."""
    even = (np.arange(side) + 0.5) / side
    two = np.stack(np.meshgrid(even, even), axis=-1).reshape(-1, 2)
    return np.column_stack([np.arange(side**2) * 0.6180339887 % 1, two])


INCIDENT, REFLECTED = _directions(150, 1), _directions(150, 2)
OFF_MIRROR = np.random.default_rng(3).normal(0, 0.2, (75, 3))
REFLECTED[:75] = INCIDENT[:75] * [-1, -1, 1] + OFF_MIRROR
REFLECTED[:75] /= np.linalg.norm(REFLECTED[:75], axis=-1, keepdims=True)
REFLECTED[:, 2] = np.abs(REFLECTED[:, 2])
LIT_FROM = _at(50)
RANDOM = np.random.default_rng(4).random((4000, 3))
CELLS = (16, 32)  # of cos theta and azimuth


def _hemisphere() -> tuple[FloatArray, FloatArray]:
    """Directions [nodes, 3] of one half of a hemisphere, and twice their solid angles [nodes]."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cos, phi = np.meshgrid((nodes + 1) / 2, np.pi * (np.arange(24) + 0.5) / 24, indexing="ij")
    sin = np.sqrt(1 - cos**2)
    solid_angle = np.repeat(weights / 2, 24) * 2 * np.pi / 24
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1).reshape(-1, 3), solid_angle


def _cells() -> FloatArray:
    """[cells x points, 3] directions at which a density is integrated, 4 x 4 in each cell."""
    rows, columns = (4 * side for side in CELLS)
    cos, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, 2 * np.pi * (np.arange(columns) + 0.5) / columns - np.pi)
    cos, phi = cos.T, phi.T
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1).reshape(-1, 3)


SAMPLED = {f"metal {alpha}": _metal(h=H, w=W) | {"alpha": alpha} for alpha in ALPHAS} | {
    f"dielectric {alpha}": _dielectric(h=H, w=W) | {"alpha": alpha} for alpha in ALPHAS
}
FURNACES = {
    "strong shift": {"type": "ggx_shift", "eta": N, "k": K, **STRONG},
    "bright dielectric": _dielectric(0.93, h=H, w=W),
}


def _asked(variant: str, tasks: dict[str, Any], folder: Path) -> dict[str, FloatArray]:
    (folder / "job.json").write_text(
        json.dumps({"variant": variant, "wavelengths": WAVELENGTHS.tolist(), "tasks": tasks})
    )
    answer = folder / "answer.json"
    subprocess.run([sys.executable, "-c", WORKER, str(folder / "job.json"), str(answer)], check=True)
    return {name: np.array(values) for name, values in json.loads(answer.read_text()).items()}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    """What the plugin says of everything that the tests below ask, in one process."""
    pairs = INCIDENT.tolist(), REFLECTED.tolist()
    own = {"type": "roughconductor", "distribution": "ggx", "alpha": ALPHA, "eta": N, "k": K}
    few = _grid(8).tolist()
    tasks: dict[str, Any] = {
        "metal": ("eval", _metal(), *pairs),
        "Mitsuba's own": ("eval", own, *pairs),
        "metal with shift": ("eval", _metal(h=H, w=W), *pairs),
        "dielectric with shift": ("eval", _dielectric(h=H, w=W), *pairs),
        "samples": ("sample", _metal(), INCIDENT[:10].tolist(), few),
        "Mitsuba's own samples": ("sample", own, INCIDENT[:10].tolist(), few),
    }
    for name, parameters in SAMPLED.items():
        cells = _cells()
        tasks[f"{name}: drawn"] = ("sample", parameters, [LIT_FROM], RANDOM.tolist())
        tasks[f"{name}: density"] = ("eval", parameters, [LIT_FROM] * len(cells), cells.tolist())
    for name, parameters in FURNACES.items():
        sky = _hemisphere()[0].tolist()
        for angle in FURNACE_ANGLES:
            tasks[f"{name}: {angle}"] = ("eval", parameters, [_at(angle)] * len(sky), sky)
        tasks[f"{name}: there"] = ("eval", parameters, *pairs)
        tasks[f"{name}: back"] = ("eval", parameters, *pairs[::-1])
    return _asked("scalar_spectral", tasks, tmp_path_factory.mktemp("plugin"))


def _between() -> Directions:
    return from_vectors(INCIDENT, REFLECTED, np.array([0.0, 0.0, 1.0]))


METAL = Conductor("test", np.array([300.0, 900.0]), np.full(2, N), np.full(2, K))


def test_the_plugin_renders_the_fitted_metal(told: dict[str, FloatArray]) -> None:
    model = cook_torrance(_between(), WAVELENGTHS, ALPHA, METAL, H, W) * REFLECTED[:, 2:]
    np.testing.assert_allclose(told["metal with shift"][:, :4], model, rtol=2e-5, atol=1e-9)


def test_the_plugin_renders_the_fitted_dielectric(told: dict[str, FloatArray]) -> None:
    model = dielectric(_between(), WAVELENGTHS, ALPHA, ETA, np.full(4, ALBEDO), H, W) * REFLECTED[:, 2:]
    np.testing.assert_allclose(told["dielectric with shift"][:, :4], model, rtol=2e-5, atol=1e-9)


def test_without_shift_the_plugin_is_mitsubas_rough_conductor(told: dict[str, FloatArray]) -> None:
    np.testing.assert_allclose(told["metal"], told["Mitsuba's own"], rtol=3e-6)
    ours, theirs = told["samples"], told["Mitsuba's own samples"]
    lit = theirs[..., 2] > 0  # Mitsuba gives directions below the horizon a density, but no light
    np.testing.assert_allclose(ours[lit], theirs[lit], rtol=1e-5, atol=1e-6)
    assert np.all(ours[~lit][:, 4:] == 0)


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_are_as_dense_as_the_plugin_says(told: dict[str, FloatArray], name: str) -> None:
    drawn, density = told[f"{name}: drawn"][0], told[f"{name}: density"][:, -1]
    kept = drawn[drawn[:, 2] > 0]
    row = (kept[:, 2] * CELLS[0]).astype(int).clip(0, CELLS[0] - 1)
    column = ((np.arctan2(kept[:, 1], kept[:, 0]) / (2 * np.pi) + 0.5) * CELLS[1]).astype(int).clip(0, CELLS[1] - 1)
    found = np.bincount(row * CELLS[1] + column, minlength=CELLS[0] * CELLS[1])
    solid_angle = 2 * np.pi / (16 * found.size)
    each = density.reshape(CELLS[0], 4, CELLS[1], 4).sum(axis=(1, 3)).ravel() * solid_angle
    expected = each * len(drawn)
    # cells of few samples are one, and those that fall below the horizon are another
    many = expected >= 8
    seen = np.array([*found[many], found[~many].sum(), len(drawn) - len(kept)])
    wanted = np.array([*expected[many], expected[~many].sum(), len(drawn) - expected.sum()])
    statistic = np.sum((seen - wanted) ** 2 / np.maximum(wanted, 1.0))
    assert chi2.sf(statistic, len(seen) - 1) > 1e-3
    weight = kept[:, 4:]
    assert np.isfinite(weight).all()


@pytest.mark.parametrize("name", FURNACES)
def test_no_material_reflects_more_light_than_falls_in(told: dict[str, FloatArray], name: str) -> None:
    solid_angle = _hemisphere()[1]
    albedo = np.array([solid_angle @ told[f"{name}: {angle}"][:, :4] for angle in FURNACE_ANGLES])
    assert albedo.max() < 1.001
    # it has been limited, and by no more than it takes
    assert albedo.max() > 0.98


@pytest.mark.parametrize("name", FURNACES)
def test_a_limited_material_is_still_reciprocal(told: dict[str, FloatArray], name: str) -> None:
    there = told[f"{name}: there"][:, :4] / REFLECTED[:, 2:]
    back = told[f"{name}: back"][:, :4] / INCIDENT[:, 2:]
    np.testing.assert_allclose(there, back, rtol=2e-5, atol=1e-9)


def test_in_rgb_a_shift_has_the_colour_of_its_spectrum(tmp_path: Path) -> None:
    pairs = INCIDENT.tolist(), REFLECTED.tolist()
    tasks = {"plain": ("eval", _metal(), *pairs), "shifted": ("eval", _metal(h=0.8, w=W), *pairs)}
    told = _asked("scalar_rgb", tasks, tmp_path)
    wavelengths = np.arange(360.0, 781.0)
    slope = cosine_slope(theta_m(_between()), 0.8, W)
    colour = xyz_to_rgb(shift(slope, wavelengths) @ xyz_weights(wavelengths))
    bright = told["plain"][:, 0] > 1e-6
    ratio = told["shifted"][bright, :3] / told["plain"][bright, :3]
    np.testing.assert_allclose(ratio, colour[bright], rtol=1e-4)


REFUSED: list[tuple[str, dict[str, float], str]] = [
    ("scalar_rgb", {"alpha": 0.3}, "either eta and k"),
    ("scalar_rgb", {"eta": 1.0, "k": 2.0, "int_ior": 1.5}, "either eta and k"),
    ("scalar_rgb", {"eta": 1.0, "k": 2.0, "h": 1.0}, "both h and w"),
    ("scalar_rgb", {"eta": 1.0, "k": 2.0, "diffuse_reflectance": 0.5}, "a metal has none"),
    ("scalar_spectral_polarized", {"eta": 1.0, "k": 2.0}, "not polarized"),
]


def test_parameters_that_make_no_sense_are_refused_with_a_reason() -> None:
    code = """
import sys, json
import mitsuba as mi
import analysis.mitsuba.ggx_shift
for variant, parameters, _ in json.loads(sys.argv[1]):
    mi.set_variant(variant)
    try:
        mi.load_dict({"type": "ggx_shift", **parameters})
        print("taken")
    except RuntimeError as error:
        print(str(error).splitlines()[-1])
"""
    done = subprocess.run([sys.executable, "-c", code, json.dumps(REFUSED)], capture_output=True, text=True, check=True)
    for line, (_, _, says) in zip(done.stdout.splitlines(), REFUSED, strict=True):
        assert line.startswith("ValueError: ggx_shift")
        assert says in line


def test_the_file_of_the_plugin_renders_a_scene_where_nothing_else_of_ours_is(tmp_path: Path) -> None:
    plugin = Path(analysis.mitsuba.vase_scene.__file__).with_name("ggx_shift.py")
    shutil.copy(plugin, tmp_path)
    material = '<bsdf type="ggx_shift" id="sample"><float name="int_ior" value="1.5"/></bsdf>'
    scene = analysis.mitsuba.vase_scene.vase_scene(material, pixels=8, samples=2)
    (tmp_path / "scene.xml").write_text(scene.xml)
    for name, content in scene.files.items():
        (tmp_path / name).write_bytes(content)
    command = [sys.executable, "-I", "ggx_shift.py", "scene.xml", "image.exr"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert (tmp_path / "image.exr").stat().st_size > 0


@pytest.mark.slow
def test_where_a_vectorised_variant_works_mitsuba_accepts_the_samples_and_differentiates() -> None:
    code = """
import drjit as dr
import mitsuba as mi
import analysis.mitsuba.ggx_shift
mi.set_variant("llvm_ad_rgb")
from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain
uniform = lambda value: {"type": "uniform", "value": value}
for parameters in ({"eta": uniform(0.73), "k": uniform(5.75)}, {"int_ior": 1.5, "diffuse_reflectance": uniform(0.4)}):
    for alpha in (0.1, 0.4):
        bsdf = {"type": "ggx_shift", "alpha": alpha, "h": 1.6, "w": 2.3, **parameters}
        sample, pdf = BSDFAdapter("ggx_shift", bsdf, wi=[0.766, 0.0, 0.6428])
        test = ChiSquareTest(SphericalDomain(), sample, pdf, sample_dim=3, ires=16, sample_count=200000)
        assert test.run(test_count=4, quiet=True), test.messages

bsdf = mi.load_dict({"type": "ggx_shift", "eta": uniform(0.73), "k": uniform(5.75), "h": 0.4, "w": 2.3})
at, parameters = mi.SurfaceInteraction3f(), mi.traverse(bsdf)
at.wi = [0.6, 0, 0.8]
red = lambda: bsdf.eval(mi.BSDFContext(), at, mi.Vector3f(-0.5, 0, 0.866))[0]
before = red()
parameters["h"] = mi.Float(0.5)
parameters.update()
change = (red() - before) / 0.1
dr.enable_grad(parameters["h"])
parameters.update()
value = red()
dr.forward(parameters["h"])
assert abs(dr.grad(value)[0] / change[0] - 1) < 1e-3
print("accepted")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode < 0 or "LLVM" in done.stderr:
        pytest.skip("no vectorised variant of Mitsuba works here")
    assert done.stdout.strip().endswith("accepted"), done.stderr
