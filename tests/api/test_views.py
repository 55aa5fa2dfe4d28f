"""What a person is shown of a dataset agrees with what is in it."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import colour
import numpy as np
import pytest

from analysis.fits.analyse import analyse
from analysis.fits.by_name import fitted_slope
from analysis.fits.fit_json import analysis_to_json, fit_to_json
from analysis.reflectance.directions import in_plane
from analysis.results import SampleAnalysis
from api.bodies.calibration import Drift
from api.bodies.plots import InPlaneMap
from api.views.curves import distributions
from api.views.in_plane_map import in_plane_map
from api.views.ladder import ladder
from api.views.lineage import lineage
from api.views.listing import detail
from api.views.opened import Datasets, Fill, Opened, filled_content
from api.views.slopes import slopes
from api.views.spectra import point_spectrum
from goniometer.datasets.budget import by_part
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.datasets.fill import TELLS
from goniometer.errors import NotInStore
from goniometer.radiometry.drift import REFERENCE_WAVELENGTH
from goniometer.storage.catalogue import Wanted
from goniometer.storage.store import Store
from simulators.choices import ABOUT
from simulators.stability.regimes import REGIMES
from tests.drawn_dataset import drawn_dataset

Shown = tuple[Store, Datasets, Opened, SampleAnalysis]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """A dataset in a database with its fits, as it opens, and the analysis that made these."""
    folder = tmp_path_factory.mktemp("views")
    store = Store.open(folder / "bench.db")
    dataset = flagged(drawn_dataset("sample-4"))
    number = store.add_dataset(None, dataset)
    analysis = analyse(dataset)
    for fit in analysis.models:
        text = fit_to_json(fit, dataset, analysis.differences[fit.model], analysis.conductor)
        store.add_fit(number, fit.model, text)
    store.add_fit(number, "analysis", analysis_to_json(analysis, analysis.conductor))
    datasets = Datasets(store, folder / "cache", here(store))
    return store, datasets, datasets.open(number), analysis


def here(store: Store) -> Fill:
    """Fills in this process."""
    return lambda number, _: filled_content(store.dataset(number))


def flagged(dataset: Dataset) -> Dataset:
    """The same with a point that is flagged."""
    flags = dataset.flags.copy()
    flags[3] |= int(Flag.CLIPPED)
    return replace(dataset, flags=flags)


def test_a_cell_has_the_colour_and_luminance_of_its_spectrum(shown: Shown) -> None:
    _, _, opened, _ = shown
    data, found = opened.dataset, in_plane_map(opened, None)
    assert found.exposure is not None
    for i in (0, 11, len(found.cells) - 1):
        spectrum = colour.SpectralDistribution(
            dict(zip(data.wavelengths, data.brdf[i] * np.cos(np.radians(data.theta_in[i])), strict=True))
        ).align(colour.SpectralShape(360, 780, 1))
        xyz = colour.sd_to_XYZ(spectrum, illuminant=colour.SDS_ILLUMINANTS["D65"]) / 100
        cell = found.cells[i]
        assert cell.luminance == pytest.approx(float(xyz[1]), rel=0.01)
        rgb = np.clip(colour.XYZ_to_sRGB(found.exposure * xyz), 0, 1)
        assert cell.colour is not None
        own = [int(cell.colour[k : k + 2], 16) for k in (1, 3, 5)]
        np.testing.assert_allclose(own, 255 * rgb, atol=3)


def test_cells_neither_overlap_nor_reach_into_the_blocked_sector(shown: Shown) -> None:
    found = in_plane_map(shown[2], None)
    for sector in found.blocked:
        for cell in (each.edges for each in found.cells if each.edges.bottom == sector.bottom):
            assert cell.right <= sector.left + 1e-9 or cell.left >= sector.right - 1e-9
    row = sorted((c.edges for c in found.cells if c.edges.bottom == found.cells[0].edges.bottom), key=lambda e: e.left)
    assert all(a.right <= b.left + 1e-9 for a, b in pairwise(row))


def test_the_difference_of_every_cell_is_that_of_the_fit_itself(shown: Shown) -> None:
    _, _, opened, analysis = shown
    found = in_plane_map(opened, None)
    assert found.difference_model == "cook-torrance-shift"
    own = analysis.differences["cook-torrance-shift"].absolute
    np.testing.assert_array_equal(np.array([cell.dE00 for cell in found.cells], dtype=float), own)


def test_a_point_shows_its_numbers_its_local_fit_and_its_flags(shown: Shown) -> None:
    store, _, opened, analysis = shown
    found = point_spectrum(store, opened, 3)
    np.testing.assert_array_equal(found.brdf, opened.dataset.brdf[3])
    parts = by_part(opened.dataset)
    np.testing.assert_allclose(found.u, np.sqrt(sum(part[3] ** 2 for part in parts.values())), rtol=1e-12)
    assert found.local is not None
    np.testing.assert_allclose(found.local.fitted, analysis.local.fitted[3], rtol=1e-9)
    np.testing.assert_allclose(found.modelled, analysis.model("cook-torrance-shift").fitted[3], rtol=1e-12)
    assert found.flags == ["clipped"]
    with pytest.raises(NotInStore, match="no point 10000"):
        point_spectrum(store, opened, 10_000)


def test_slopes_are_those_of_the_local_fit_and_curves_those_of_the_models(shown: Shown) -> None:
    _, _, opened, analysis = shown
    found = slopes(opened)
    own_slopes = np.array([p.slope_per_um for p in found.points], dtype=float)
    np.testing.assert_array_equal(own_slopes, analysis.local.slope)
    assert [p.reliable for p in found.points] == analysis.local.reliable.tolist()
    curve = next(model for model in found.models if model.model == "global").curves[1]
    theta = np.array(found.theta_out_deg)
    own = fitted_slope(analysis.model("global"), in_plane(np.full_like(theta, curve.theta_in_deg), theta))
    np.testing.assert_allclose(curve.slope_per_um, own, rtol=1e-12)


def test_a_distribution_at_a_measured_wavelength_is_what_was_measured(shown: Shown) -> None:
    data = shown[2].dataset
    column = data.wavelengths.size // 2
    for curve in distributions(shown[2], float(data.wavelengths[column]), None).curves:
        np.testing.assert_allclose(curve.brdf, data.brdf[curve.points, column], rtol=1e-12)
        np.testing.assert_allclose(curve.u, data.u[curve.points, column], rtol=1e-9)
        assert curve.theta_out_deg == sorted(curve.theta_out_deg)


def test_the_luminance_of_a_grey_sample_is_its_brdf(shown: Shown) -> None:
    grey = replace(shown[2].dataset, brdf=np.full_like(shown[2].dataset.brdf, 0.25))
    for curve in distributions(Opened(shown[2].entry, grey, ()), None, None).curves:
        np.testing.assert_allclose(curve.brdf, 0.25, rtol=1e-9)


def test_the_ladder_says_what_the_fits_said(shown: Shown) -> None:
    _, _, opened, analysis = shown
    found = {model.model: model for model in ladder(opened).models}
    assert list(found) == ["global", "cook-torrance", "cook-torrance-shift"]
    for fit in analysis.models:
        told = found[fit.model]
        assert told.trusted == fit.verdict.trusted
        assert tuple(told.reasons) == fit.verdict.reasons
        assert [p.value for p in told.parameters] == [p.value for p in fit.parameters]
        assert told.absolute.mean == analysis.differences[fit.model].statistics("absolute")["mean"]


def test_what_was_filled_is_kept_for_the_next_who_asks_to_the_last_bit(shown: Shown, tmp_path: Path) -> None:
    store, _, opened, _ = shown
    datasets = Datasets(store, tmp_path, here(store))
    first, again = datasets.filled(opened), datasets.filled(opened)
    assert first is not None
    assert again is not None
    assert (first.by, first.points) == (again.by, again.points)
    for name in ("theta_in", "theta_out", "wavelengths", "brdf", "u"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])  # a copy that was cut short is made anew
    assert datasets.filled(opened) is not None
    found = in_plane_map(opened, first)
    assert len(found.filled) == int(first.tells.sum())
    assert len(found.filled) + found.not_filled == first.theta_in.size


def test_lists_find_datasets_by_sample_kind_and_flag_without_their_numbers(shown: Shown) -> None:
    store, _, opened, _ = shown
    sample = opened.dataset.sample
    assert [entry.id for entry in store.entries(Wanted(sample=sample.upper()), 10)] == [opened.entry.id]
    assert [entry.id for entry in store.entries(Wanted(flag=Flag.CLIPPED), 10)] == [opened.entry.id]
    assert store.entries(Wanted(flag=Flag.SATURATED), 10) == []
    assert store.entries(Wanted(kind="simulated"), 10) == []
    found = detail(opened)
    assert (found.points, found.flagged) == (opened.dataset.theta_in.size, 1)
    assert found.content_hash == opened.dataset.content_hash


def test_the_lineage_leads_to_every_fit(shown: Shown) -> None:
    store, _, opened, _ = shown
    fits = [node.ids[0] for node in lineage(store, opened).derived if node.kind == "fit"]
    assert fits == [fit.id for fit in store.fits(opened.entry.id)]


def test_what_answers_are_said_to_hold_is_what_they_hold() -> None:
    assert f"no better than {100 * TELLS:.0f} %" in str(InPlaneMap.model_fields["not_filled"].description)
    assert f"at {REFERENCE_WAVELENGTH:g} nm" in str(Drift.model_fields["level"].description)
    assert list(ABOUT) == list(REGIMES)
