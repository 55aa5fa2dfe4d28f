"""Pictures of two models side by side differ where and as much as the models do."""

from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest

from analysis.bsdf.export import write_bsdf
from analysis.colour import rgb_to_xyz
from analysis.errors import ExportError, RenderError
from analysis.fits.brdf_fit import form_of
from analysis.mitsuba.export_plugin import plugin_material, plugin_scene
from analysis.mitsuba.run import bsdf_element
from analysis.mitsuba.vase_render import VARIANTS, Pictures, Variant, compare, render_scenes, working_variant
from analysis.mitsuba.vase_scene import vase, vase_scene
from analysis.reflectance.fresnel import load_conductor
from analysis.scenes.ladder import Microfacet
from drivers.arrays import FloatArray

SCALAR = Variant("scalar_spectral")


def _metal(*shift: float) -> Microfacet:
    name = "cook-torrance-shift" if shift else "cook-torrance"
    return Microfacet(form_of(name, load_conductor(), "ggx"), np.array([0.364, *shift]), None)


def test_the_vase_is_closed_and_smooth_and_its_normals_point_outwards() -> None:
    vertices, normals, triangles = vase()
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(across, axis=1)
    real = sizes > 1e-12  # at the top they shrink to a point
    flat = across[real] / sizes[real, None]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    assert np.einsum("ij,ikj->ik", flat, normals[triangles[real]]).min() > 0.9
    # every edge is shared by two triangles, which run along it in opposite ways, but at the floor and the top
    edges = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    ways = {tuple(edge) for edge in edges.tolist()}
    assert len(ways) == len(edges)
    open_ones = [(a, b) for a, b in ways if (b, a) not in ways]
    ends = vertices[np.array(open_ones)]
    on_axis = np.linalg.norm(ends[..., :2], axis=-1) < 1e-9
    assert np.all(on_axis | (ends[..., 2] == 0))


def _pictures(images: FloatArray) -> Pictures:
    times = np.ones(images.shape[:2])
    return Pictures(rgb_to_xyz(images), times, times, np.ones(images.shape[2:4], dtype=bool))


def test_a_difference_is_that_of_the_displayed_colours() -> None:
    grey, tinted = np.array([0.5, 0.5, 0.5]), np.array([0.55, 0.5, 0.42])
    images = np.broadcast_to(np.stack([grey, tinted])[None, :, None, None], (2, 2, 8, 8, 3))
    found = compare(_pictures(images))
    # the first is shown as white, and what is brighter is cut
    white = found.display.white[:2] / found.display.white.sum()
    one, other = (colour.XYZ_to_Lab(rgb_to_xyz(np.minimum(rgb / 0.5, 1)), white) for rgb in (grey, tinted))
    expected = float(colour.delta_E(one, other, method="CIE 2000"))
    assert found.mean == pytest.approx(expected, rel=1e-3)
    np.testing.assert_allclose(found.difference, expected, rtol=1e-3)


def test_noise_alone_is_not_told_as_a_difference() -> None:
    rng = np.random.default_rng(1)
    images = 0.4 * (1 + 0.01 * rng.standard_normal((2, 2, 64, 64, 3)))
    found = compare(_pictures(images))
    told = np.nanmean(found.difference)
    assert told > 0.5
    assert found.mean < 0.6 * told
    assert found.mean < 2 * found.u_mean


def test_pixels_that_came_out_as_no_number_are_left_out() -> None:
    images = np.full((2, 2, 8, 8, 3), 0.5)
    images[1, 0, 3, 3] = np.nan
    found = compare(_pictures(images))
    assert np.isnan(found.difference[3, 3])
    assert np.isfinite(found.mean)
    with pytest.raises(RenderError, match="more pixels"):
        compare(replace(_pictures(images), covered=np.zeros((8, 8), dtype=bool)))


def test_a_table_looks_like_the_exact_model_within_the_error_that_its_file_states(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    scenes, stated = [], []
    for i, model in enumerate((_metal(), _metal(1.6, 2.3))):
        report = write_bsdf(tmp_path / f"{i}.bsdf", model)
        stated.append(report.written)
        table = vase_scene(bsdf_element("measured", '<string name="filename" value="x.bsdf"/>'), 24, depth=2)
        content = {"x.bsdf": (tmp_path / f"{i}.bsdf").read_bytes()}
        scenes += [vase_scene(plugin_material(model), 24, depth=2), replace(table, files=table.files | content)]
    # light that is reflected once leaves no noise but that of where a pixel is met
    found = render_scenes(scenes, SCALAR, samples=8, seeds=(1,))
    whole = found.images[0, :, found.covered]
    assert found.covered.sum() > 100
    for i, error in enumerate(stated):
        exact, tabulated = whole[:, 2 * i], whole[:, 2 * i + 1]
        lit = exact[:, 1] > 0.01 * exact[:, 1].max()
        relative = np.abs(tabulated[lit, 1] / exact[lit, 1] - 1)
        # some pixels show more grazing angles than the 80 degrees up to which the file states its error
        assert np.percentile(relative, 90) < error.error.p99
        assert tabulated[lit, 1].sum() == pytest.approx(exact[lit, 1].sum(), rel=0.005)
        assert np.median(relative) < 3 * error.error.median
        assert compare(found, 2 * i, 2 * i + 1).mean < 0.3
    # and what was rendered is not one scene four times
    assert compare(found, 0, 2).mean > 1
    assert compare(found, 1, 3).mean > 1


def test_without_a_library_of_llvm_the_scalar_variant_renders_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    found = working_variant(vase_scene(plugin_material(_metal()), 8))
    assert found.name == VARIANTS[-1] == "scalar_spectral"
    assert not found.vectorised
    assert len(found.refused) == 1
    assert "llvm_ad_spectral does not work here" in found.refused[0]


def test_where_mitsuba_is_missing_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ModuleNotFoundError(\"No module named 'mitsuba'\")")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    with pytest.raises(RenderError, match=r"goniometer\[render\]") as fault:
        working_variant(vase_scene(plugin_material(_metal()), 8))
    assert "\n" not in str(fault.value)


def test_a_model_that_the_plugin_does_not_have_is_refused() -> None:
    beckmann = Microfacet(form_of("cook-torrance", load_conductor(), "beckmann"), np.array([0.3]), None)
    with pytest.raises(ExportError, match="neither Beckmann"):
        plugin_material(beckmann)


def test_an_exported_scene_says_what_it_is_of_whatever_the_sample_is_called() -> None:
    scene = plugin_scene(_metal(1.6, 2.3), "Fitted model of sample a --> b--c.")
    comment = scene.xml.split("<!--")[1].split("-->")[0]
    assert "a - -> b- -c" in comment
    assert "--" not in comment
    assert set(scene.files) == {"vase.ply", "ggx_shift.py"}
