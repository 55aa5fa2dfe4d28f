"""A written .bsdf file stands for the fitted model in a renderer that knows nothing of this project."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from analysis.directions import Directions
from analysis.errors import ExportError, OutOfRange
from analysis.export_mitsuba import BsdfReport, write_bsdf
from analysis.fresnel import Conductor, load_conductor
from analysis.measured_bsdf import evaluate, read_bsdf, sampling_density
from analysis.models import cook_torrance
from analysis.tensor_file import decode, encode
from drivers.arrays import FloatArray
from goniometer.errors import InputError

RENDERER = """
import json, sys
import mitsuba as mi
mi.set_variant("scalar_spectral")
job = json.load(open(sys.argv[1]))
bsdf = mi.load_dict({"type": "measured", "filename": job["bsdf"]})
context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
at.wavelengths = job["wavelengths"]
answer = {"eval": [], "pdf": [], "samples": []}
for incident, reflected in zip(job["incident"], job["reflected"]):
    at.wi = incident
    answer["eval"].append([float(v) for v in bsdf.eval(context, at, reflected)])
    answer["pdf"].append(float(bsdf.pdf(context, at, reflected)))
at.wi = job["lit_from"]
for sample in job["samples"]:
    found, weight = bsdf.sample(context, at, 0.5, sample)
    answer["samples"].append([*(float(v) for v in found.wo), float(found.pdf), *(float(v) for v in weight)])
json.dump(answer, open(sys.argv[2], "w"))
"""


def _written(tmp_path: Path, alpha: float, h: float, w: float) -> BsdfReport:
    return write_bsdf(tmp_path / f"{alpha}.bsdf", alpha, load_conductor(), h, w)


def _directions(count: int, seed: int, largest: float = 80.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    cos = rng.uniform(np.cos(np.radians(largest)), 1, count)
    phi = rng.uniform(-np.pi, np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def _model(
    incident: FloatArray, reflected: FloatArray, wavelengths: FloatArray, alpha: float, h: float, w: float
) -> FloatArray:
    half = incident + reflected
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cosines = Directions(incident[:, 2], reflected[:, 2], half[:, 2], np.sum(incident * half, axis=-1))
    return cook_torrance(cosines, wavelengths, alpha, load_conductor(), h, w)


@pytest.fixture(params=[(0.364, 1.6, 2.3), (0.18, 1.2, 3.4), (0.0045, 0.0, 0.0)], ids=["rough", "smooth", "mirror"])
def sample(request: pytest.FixtureRequest) -> tuple[float, float, float]:
    return request.param  # type: ignore[no-any-return]


@pytest.mark.slow
def test_an_unmodified_mitsuba_renders_the_fitted_model(tmp_path: Path, sample: tuple[float, float, float]) -> None:
    pytest.importorskip("mitsuba")
    alpha, h, w = sample
    report = _written(tmp_path, alpha, h, w)
    count = 500
    wavelengths = np.array([420.0, 530, 610, 700])
    incident, reflected = _directions(count, 1), _directions(count, 2)
    # half of the directions lie in the lobe, where the light goes
    share = np.random.default_rng(3).random(count // 2)
    normal = _directions(count // 2, 4)
    tangent = alpha * np.sqrt(share / (1 - share))
    sideways = normal[:, :2] / np.linalg.norm(normal[:, :2], axis=-1, keepdims=True)
    normal = np.concatenate([sideways * tangent[:, None], np.ones((count // 2, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    mirrored = 2 * np.sum(incident[: count // 2] * normal, axis=-1, keepdims=True) * normal - incident[: count // 2]
    lit = mirrored[:, 2] > np.cos(np.radians(80))
    reflected[: count // 2][lit] = mirrored[lit]

    side = 100
    grid = (np.arange(side) + 0.5) / side
    samples = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    lit_from = [np.sin(np.radians(40)), 0.0, np.cos(np.radians(40))]
    job = {
        "bsdf": str(report.path),
        "wavelengths": wavelengths.tolist(),
        "incident": incident.tolist(),
        "reflected": reflected.tolist(),
        "lit_from": lit_from,
        "samples": samples.tolist(),
    }
    (tmp_path / "job.json").write_text(json.dumps(job))
    subprocess.run(
        [sys.executable, "-c", RENDERER, str(tmp_path / "job.json"), str(tmp_path / "answer.json")], check=True
    )
    answer = {name: np.array(values) for name, values in json.loads((tmp_path / "answer.json").read_text()).items()}

    model = _model(incident, reflected, wavelengths, alpha, h, w)
    error = np.abs(answer["eval"] / reflected[:, 2:] / model - 1)
    assert np.median(error) < 0.005
    assert np.percentile(error, 99) < 0.02
    assert error.max() < 0.04

    # our own account of the renderer is what the report's error rests on; it computes in double precision
    tables = read_bsdf(report.path.read_bytes())
    np.testing.assert_allclose(evaluate(tables, incident, reflected, wavelengths), answer["eval"], rtol=3e-4)
    np.testing.assert_allclose(sampling_density(tables, incident, reflected), answer["pdf"], rtol=2e-3)

    # sampling: the mean weight is the albedo, here against a quadrature of the model in half-vector coordinates
    above = answer["samples"][:, 2] > 0
    albedo = np.where(above[:, None], answer["samples"][:, 4:], 0).mean(axis=0)
    t = (np.arange(400) + 0.5) / 400
    phi = 2 * np.pi * (np.arange(180) + 0.5) / 180
    theta = np.arctan(alpha * np.tan(t * np.pi / 2))[:, None]
    dtheta = alpha / (np.cos(t * np.pi / 2) ** 2 + (alpha * np.sin(t * np.pi / 2)) ** 2) * (np.pi / 2 / 400)
    m = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1)
    cos_d = m @ np.array(lit_from)
    o = 2 * cos_d[..., None] * m - lit_from
    solid_angle = np.sin(theta) * dtheta[:, None] * (2 * np.pi / 180) * 4 * np.maximum(cos_d, 0)
    keep = (o[..., 2] > 0) & (cos_d > 0)
    lit_model = _model(np.broadcast_to(lit_from, o[keep].shape), o[keep], wavelengths, alpha, h, w)
    expected = np.sum(lit_model * (o[..., 2] * solid_angle)[keep][:, None], axis=0)
    np.testing.assert_allclose(albedo, expected, rtol=0.01)
    # and the sampling density integrates to one, but for samples lost below the horizon
    density = sampling_density(tables, np.broadcast_to(lit_from, o[keep].shape), o[keep])
    assert np.sum(density * solid_angle[keep]) == pytest.approx(above.mean(), abs=0.01)
    assert above.mean() > 0.9


def test_the_file_says_how_far_it_is_from_the_model(tmp_path: Path) -> None:
    report = _written(tmp_path, 0.18, 1.2, 3.4)
    assert report.size < 10e6
    assert report.size == report.path.stat().st_size
    assert report.error == report.errors[report.layout]
    assert report.error.p99 == min(e.p99 for e in report.errors.values())
    assert report.error.p99 < 0.03
    assert report.colour_error <= 0.05
    text = read_bsdf(report.path.read_bytes()).description
    assert f"maximum {report.error.maximum:.2g}" in text
    assert text == report.description


def test_another_reader_of_the_container_finds_every_field(tmp_path: Path) -> None:
    content = encode({"flag": np.ones(1, np.uint8), "values": np.arange(6.0).reshape(2, 3)})
    assert content[:18] == b"tensor_file\0\x01\x00" + struct.pack("<I", 2)
    name, shape_at = content.index(b"values"), content.index(b"values") + 6
    assert struct.unpack_from("<H", content, name - 2) == (6,)
    dimensions, dtype, offset, rows, columns = struct.unpack_from("<HBQQQ", content, shape_at)
    assert (dimensions, dtype, rows, columns) == (2, 10, 2, 3)
    assert offset % 8 == 0
    assert struct.unpack_from("<6f", content, offset) == (0, 1, 2, 3, 4, 5)
    np.testing.assert_array_equal(decode(content)["values"], [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize("damage", [slice(0, 8), slice(0, 40), slice(0, -4), slice(3, None)])
def test_a_damaged_file_is_refused_in_one_sentence(damage: slice) -> None:
    content = encode({"values": np.arange(6.0)})
    with pytest.raises(InputError, match="tensor file"):
        decode(content[damage])


def test_a_metal_that_is_not_tabulated_over_the_visible_range_is_refused(tmp_path: Path) -> None:
    short = Conductor("short", np.array([500.0, 600]), np.ones(2), np.ones(2))
    with pytest.raises(OutOfRange, match="500 to 600 nm"):
        write_bsdf(tmp_path / "x.bsdf", 0.2, short)
    assert not (tmp_path / "x.bsdf").exists()


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"nowhere/x\.bsdf"):
        _ = write_bsdf(tmp_path / "nowhere" / "x.bsdf", 0.2, load_conductor())
