"""A written .bsdf file stands for the fitted model in a renderer that knows nothing of this project."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from analysis.bsdf.energy import clamp
from analysis.bsdf.export import BsdfReport, report_content, report_lines, write_bsdf, write_fit
from analysis.bsdf.measured_bsdf import evaluate, read_bsdf, sampling_density
from analysis.bsdf.search import Budget
from analysis.errors import ExportError, OutOfRange
from analysis.fits.analyse import analyse
from analysis.reflectance.directions import from_vectors, in_plane
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reflectance.microfacet import Form
from analysis.results import Albedo
from analysis.scenes.brdf_table import BrdfTable
from analysis.scenes.ladder import Lambert, Microfacet, Model, Tinted
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

RENDERER = """
import json, sys
import mitsuba as mi
mi.set_variant("scalar_spectral")
job = json.load(open(sys.argv[1]))
context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
at.wavelengths = job["wavelengths"]

def values(bsdf, material):
    evaluated, density = [], []
    for incident, reflected in zip(material["incident"], material["reflected"]):
        at.wi = incident
        evaluated.append([float(v) for v in bsdf.eval(context, at, reflected)])
        density.append(float(bsdf.pdf(context, at, reflected)))
    return {"eval": evaluated, "pdf": density}

answer = {}
for name, material in job["materials"].items():
    bsdf = mi.load_dict({"type": "measured", "filename": material["bsdf"]})
    answer[name] = values(bsdf, material)
    at.wi = job["lit_from"]
    samples = []
    for sample in job["samples"]:
        found, weight = bsdf.sample(context, at, 0.5, sample)
        samples.append([*(float(v) for v in found.wo), float(found.pdf), *(float(v) for v in weight)])
    answer[name]["samples"] = samples
    if "builtin" in material:
        answer[name]["builtin"] = values(mi.load_dict(material["builtin"]), material)["eval"]
with open(sys.argv[2], "w") as file:
    json.dump(answer, file)
"""

ALL = np.array([300.0, 900.0])
UP = np.array([0.0, 0.0, 1.0])
COLOURS = np.array([420.0, 530, 610, 700])
BUDGET = Budget(0.03, 0.75)
LIT_FROM = np.array([np.sin(np.radians(40)), 0.0, np.cos(np.radians(40))])


def metal(alpha: float, *shift: float, distribution: str = "ggx") -> Microfacet:
    """Aluminium; `shift` are h and w, all six of two components, or nothing."""
    kind = {0: "none", 2: "cosine", 6: "two-component"}[len(shift)]
    form = Form(load_conductor(), kind, distribution)
    return Microfacet(form, np.array([alpha, *shift]), None)


def paint(alpha: float, *shift: float) -> Microfacet:
    """A dielectric that is dark in the blue."""
    kind = {0: "none", 2: "cosine", 6: "two-component"}[len(shift)]
    colour = Albedo(ALL, np.array([0.05, 0.4]), np.zeros(2))
    return Microfacet(Form(None, kind), np.array([alpha, 1.5, *shift]), colour)


GLOSS = Microfacet(Form(None, "none"), np.array([0.1, 1.5]), Albedo(ALL, np.array([0.3, 0.95]), np.zeros(2)))
"""Brighter than white paper, and what its surface reflects on top."""

MATERIALS: dict[str, tuple[Model, float]] = {
    "rough": (metal(0.364, 1.0, 2.3), 0.364),
    "smooth": (metal(0.1, 0.7, 4.5), 0.1),
    "mirror": (metal(0.005), 0.005),
    "two components": (metal(0.2, 0.8, 3.0, 0.1, 0.8, 4.0, 0.2), 0.2),
    "beckmann": (metal(0.18, 0.6, 3.0, distribution="beckmann"), 0.18),
    "paint": (paint(0.15, 1.0, 3.0), 0.15),
    "glossy paint": (paint(0.03, 0.3, 3.0, -0.1, 0.8, 4.0, 0.2), 0.03),
    "lambert": (Lambert(ALL, np.array([0.2, 0.6])), 1.0),
    "tinted": (Tinted(0.25, "ggx", ALL, np.array([0.5, 0.9])), 0.25),
}


@dataclass(frozen=True)
class Rendered:
    """A file, and what Mitsuba makes of it."""

    report: BsdfReport
    incident: FloatArray
    reflected: FloatArray
    answer: dict[str, FloatArray]


def directions(count: int, seed: int, largest: float = 80.0) -> FloatArray:
    """Unit vectors [count, 3], uniform in solid angle up to `largest` degrees."""
    rng = np.random.default_rng(seed)
    cos = rng.uniform(np.cos(np.radians(largest)), 1, count)
    phi = rng.uniform(-np.pi, np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def pairs(alpha: float, count: int = 240) -> tuple[FloatArray, FloatArray]:
    """Directions, half of them in the lobe, where the light goes."""
    incident, reflected = directions(count, 1), directions(count, 2)
    share = np.random.default_rng(3).random(count // 2)
    normal = directions(count // 2, 4)
    sideways = normal[:, :2] / np.linalg.norm(normal[:, :2], axis=-1, keepdims=True)
    tangent = alpha * np.sqrt(share / (1 - share))
    normal = np.concatenate([sideways * tangent[:, None], np.ones((count // 2, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    mirrored = 2 * np.sum(incident[: count // 2] * normal, axis=-1, keepdims=True) * normal - incident[: count // 2]
    lit = mirrored[:, 2] > np.cos(np.radians(80))
    reflected[: count // 2][lit] = mirrored[lit]
    return incident, reflected


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rendered]:
    """All materials, written and evaluated by one process of Mitsuba."""
    pytest.importorskip("mitsuba")
    folder = tmp_path_factory.mktemp("bsdf")
    grid = (np.arange(36) + 0.5) / 36
    samples = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    reports, asked = {}, {}
    for name, (model, alpha) in MATERIALS.items():
        reports[name] = write_bsdf(folder / f"{name}.bsdf", model, BUDGET)
        incident, reflected = pairs(alpha)
        asked[name] = {
            "bsdf": str(reports[name].path),
            "incident": incident.tolist(),
            "reflected": reflected.tolist(),
        }
    aluminium = load_conductor()
    steps = np.linspace(360, 830, 471)
    n, k = aluminium.index(steps)
    asked["mirror"]["builtin"] = {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha": 0.005,
        "eta": {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": ",".join(map(str, n))},
        "k": {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": ",".join(map(str, k))},
    }
    job = {
        "materials": asked,
        "wavelengths": COLOURS.tolist(),
        "lit_from": LIT_FROM.tolist(),
        "samples": samples.tolist(),
    }
    (folder / "job.json").write_text(json.dumps(job))
    subprocess.run([sys.executable, "-c", RENDERER, str(folder / "job.json"), str(folder / "out.json")], check=True)
    answers = json.loads((folder / "out.json").read_text())
    return {
        name: Rendered(
            reports[name],
            np.array(asked[name]["incident"]),
            np.array(asked[name]["reflected"]),
            {key: np.array(values) for key, values in answers[name].items()},
        )
        for name in MATERIALS
    }


def exact(name: str, found: Rendered) -> FloatArray:
    """[pairs, wavelengths] f cos(theta_o) of the model itself."""
    cosines = from_vectors(found.incident, found.reflected, UP)
    return np.asarray(MATERIALS[name][0](cosines, COLOURS) * found.reflected[:, 2:])


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS)
def test_an_unmodified_mitsuba_renders_the_fitted_model(rendered: dict[str, Rendered], name: str) -> None:
    found = rendered[name]
    assert found.report.within_budget
    assert not found.report.clamped  # of these; so the model itself is what the file has to have
    model = exact(name, found)
    error = np.abs(found.answer["eval"] - model) / np.maximum(model, 1e-6)
    assert np.median(error) < 0.01
    assert np.percentile(error, 98) < BUDGET.error
    assert error.max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS)
def test_the_error_that_is_stated_is_the_renderers(rendered: dict[str, Rendered], name: str) -> None:
    found = rendered[name]
    tables = read_bsdf(found.report.path.read_bytes())
    own = evaluate(tables, found.incident, found.reflected, COLOURS)
    np.testing.assert_allclose(own, found.answer["eval"], rtol=5e-4, atol=1e-7)  # which computes in single precision
    density = sampling_density(tables, found.incident, found.reflected)
    np.testing.assert_allclose(density, found.answer["pdf"], rtol=5e-3, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS)
def test_sampling_brings_back_all_the_light_and_little_noise(rendered: dict[str, Rendered], name: str) -> None:
    found, (model, alpha) = rendered[name], MATERIALS[name]
    above = found.answer["samples"][:, 2] > 0
    weight = np.where(above[:, None], found.answer["samples"][:, 4:], 0)
    # the albedo, by a quadrature in half-vector coordinates
    t = (np.arange(400) + 0.5) / 400
    phi = 2 * np.pi * (np.arange(180) + 0.5) / 180
    theta = np.arctan(alpha * np.tan(t * np.pi / 2))[:, None]
    dtheta = alpha / (np.cos(t * np.pi / 2) ** 2 + (alpha * np.sin(t * np.pi / 2)) ** 2) * (np.pi / 2 / 400)
    m = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1)
    cos_d = m @ LIT_FROM
    o = 2 * cos_d[..., None] * m - LIT_FROM
    solid_angle = np.sin(theta) * dtheta[:, None] * (2 * np.pi / 180) * 4 * np.maximum(cos_d, 0)
    keep = (o[..., 2] > 0) & (cos_d > 0)
    lit = model(from_vectors(np.broadcast_to(LIT_FROM, o[keep].shape), o[keep], UP), COLOURS)
    albedo = np.sum(lit * (o[..., 2] * solid_angle)[keep][:, None], axis=0)
    np.testing.assert_allclose(weight.mean(axis=0), albedo, rtol=0.02)
    assert np.all(weight.std(axis=0) / weight.mean(axis=0) < 0.6)
    assert above.mean() > 0.9


@pytest.mark.slow
def test_without_shift_the_file_is_mitsubas_own_rough_conductor(rendered: dict[str, Rendered]) -> None:
    found = rendered["mirror"]
    error = np.abs(found.answer["eval"] / found.answer["builtin"] - 1)
    assert np.percentile(error, 99) < BUDGET.error


def test_a_smaller_budget_is_kept_by_a_larger_file(tmp_path: Path) -> None:
    model = metal(0.02, 0.5, 4.5)
    loose, usual, tight = (
        write_bsdf(tmp_path / f"{error}.bsdf", model, Budget(error, 25 * error)) for error in (0.08, 0.03, 0.01)
    )
    assert loose.size < usual.size < tight.size < 3e6
    for report in (loose, usual, tight):
        assert report.within_budget
        assert report.written.error.p99 <= report.budget.error
        assert report.written.colour <= report.budget.colour
        assert report.size == report.path.stat().st_size
        assert report.size < 1.1 * report.written.size + 4000


def test_the_file_and_the_command_say_how_far_it_is_from_the_model(tmp_path: Path) -> None:
    report = write_bsdf(tmp_path / "x.bsdf", metal(0.01), about="Of a disc.")
    text = read_bsdf(report.path.read_bytes()).description
    assert text == report.description
    assert text.startswith("Of a disc.")
    assert f"maximum {report.written.error.maximum:.2g}" in text
    assert "is kept" in text
    told = " ".join(report_lines(report))
    assert f"99 of 100 directions below {report.written.error.p99:.2%}" in told
    content = json.loads(json.dumps(report_content(report)))
    assert content["layouts"][content["layout"]]["error"]["p99"] == report.written.error.p99
    assert content["budget"] == {"p99": 0.02, "dE00": 0.5, "kept": True}


def test_a_budget_that_no_file_keeps_is_said_not_to_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("analysis.bsdf.export.LARGEST_SIZE", 100_000)
    report = write_bsdf(tmp_path / "x.bsdf", metal(0.2), Budget(0.01))
    assert report.size < 110_000
    assert not report.within_budget
    assert "NOT kept" in report.description
    assert "NOT kept" in " ".join(report_lines(report))
    assert not report_content(report)["budget"]["kept"]


def furnace(path: Path, angle: float) -> FloatArray:
    """[wavelengths] albedo of a file, by a sum over even steps of theta_o and phi."""
    theta, phi = np.meshgrid((np.arange(450) + 0.5) / 450 * np.pi / 2, (np.arange(180) + 0.5) / 180 * np.pi)
    o = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)
    i = np.broadcast_to([-np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))], o.shape)
    tables = read_bsdf(path.read_bytes())
    each = np.sin(theta).ravel() * 2 * (np.pi / 2 / 450) * (np.pi / 180)
    return np.asarray(each @ evaluate(tables, i, o, tables.wavelengths))


@pytest.mark.parametrize("model", [metal(0.1, 1.8, 2.0), GLOSS], ids=["metal", "paint"])
def test_no_file_gives_back_more_light_than_it_gets(tmp_path: Path, model: Microfacet) -> None:
    report = write_bsdf(tmp_path / "x.bsdf", model, Budget(0.06, 1.5))
    for angle in (0.0, 33.0, 61.0, 78.0, 86.0):
        assert furnace(report.path, angle).max() < 1 + 1e-3
    assert report.written.albedo < 1 + 1e-3
    assert report.clamped
    assert report.clamped in report.description
    assert report.clamped in report_lines(report)
    assert "830 nm" in report.clamped


def test_clamping_keeps_reciprocity_and_leaves_alone_what_need_not_be_clamped() -> None:
    model = metal(0.2, 1.8, 2.0)
    clamped = clamp(model, 0.2, np.linspace(360, 830, 48))
    assert clamped is not None
    i, o = directions(500, 5, 88), directions(500, 6, 88)
    there, back = (clamped(from_vectors(a, b, UP), COLOURS) for a, b in ((i, o), (o, i)))
    np.testing.assert_allclose(there, back, rtol=1e-12)
    whole = model(from_vectors(i, o, UP), COLOURS)
    np.testing.assert_array_equal(there[:, :2], whole[:, :2])  # below 600 nm the shift takes light away
    assert clamp(metal(0.2, 0.3, 2.0), 0.2, np.linspace(360, 830, 48)) is None


def test_a_fit_is_exported_with_its_albedo_and_what_it_was_fitted_to(
    tmp_path: Path, measure: Callable[..., Dataset]
) -> None:
    dataset = measure(0.2, incident=(10, 40, 70), wavelength_step=12.0)
    analysis = analyse(dataset, models=("dielectric", "global"))
    report = write_fit(tmp_path / "x.bsdf", analysis.model("dielectric"), dataset, load_conductor(), Budget(0.1, 2))
    assert "r_d / pi" in report.description
    assert dataset.content_hash in report.description
    assert "an in-plane scan cannot fill a hemisphere" in report.description
    with pytest.raises(ExportError, match="no brightness"):
        write_fit(tmp_path / "y.bsdf", analysis.model("global"), dataset, load_conductor())


def test_a_table_of_the_measurement_is_exported_too(tmp_path: Path) -> None:
    theta_h, theta_d = np.linspace(0, 90, 72), np.linspace(0, 90, 31)
    lobe = 0.5 * np.exp(-((theta_h / 25) ** 2))[:, None, None] + 0.02 + np.zeros((72, 31, 3))
    nodes = np.array([390.0, 550, 710])
    one = Lambert(nodes, np.full(nodes.size, np.pi))
    table = BrdfTable(theta_h, theta_d, nodes, np.log(lobe), one)
    report = write_bsdf(tmp_path / "x.bsdf", table, Budget(0.05, 1.0))
    assert report.within_budget
    assert report.wavelengths[[0, -1]].tolist() == [390.0, 710.0]
    seen = in_plane(np.array([30.0]), np.array([50.0]))
    i = np.array([[-0.5, 0, np.sqrt(0.75)]])
    o = np.array([[np.sin(np.radians(50)), 0, np.cos(np.radians(50))]])
    found = evaluate(read_bsdf(report.path.read_bytes()), i, o, COLOURS) / o[:, 2:]
    np.testing.assert_allclose(found, table(seen, COLOURS), rtol=0.05)


def test_a_model_that_is_not_known_over_the_visible_range_is_refused(tmp_path: Path) -> None:
    short = Conductor("short", np.array([500.0, 600]), np.ones(2), np.ones(2))
    with pytest.raises(OutOfRange, match="500 to 600 nm"):
        write_bsdf(tmp_path / "x.bsdf", Microfacet(Form(short, "none"), np.array([0.2]), None))
    assert not (tmp_path / "x.bsdf").exists()


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"nowhere/x\.bsdf"):
        write_bsdf(tmp_path / "nowhere" / "x.bsdf", metal(0.02))
