"""The model that a scene needs is the one that it needs, and none that the data cannot tell."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from analysis.fits.by_name import fit_models, local_fit_for
from analysis.reflectance.directions import Directions, from_vectors, in_plane
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cook_torrance
from analysis.results import ModelFit
from analysis.scenes.asked import asked
from analysis.scenes.brdf_table import BrdfTable, Reference, folded, reference_table, table_nodes
from analysis.scenes.choose import FEWER, NODES, choose, nodes
from analysis.scenes.ladder import METAL_FITS, Lambert
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import Vertices, display_for, image, to_pixels, xyz_of_vertices
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

SAMPLE = (0.209, 1.35, 3.0)
CAMERA = {"position": (0.0, -4.0, 1.0), "pixels": (16, 16), "field_of_view": 32.0}
SUN = Scene.model_validate(
    {"camera": CAMERA, "material": [{"sphere": 1.0}], "lights": [{"sun": (1.0, -1.0, 1.0)}]},
)
AROUND = Scene.model_validate({"camera": CAMERA, "material": [{"sphere": 1.0}], "lights": [{"environment": 1.0}]})


@pytest.fixture(scope="module")
def fits(measure: Callable[..., Dataset]) -> tuple[Dataset, tuple[ModelFit, ...]]:
    dataset = measure(*SAMPLE, wavelength_step=12.0, incident=(10, 30, 50, 70))
    local = local_fit_for(dataset, METAL_FITS)
    return dataset, fit_models(dataset, local, METAL_FITS)


@pytest.fixture(scope="module")
def reference(fits: tuple[Dataset, tuple[ModelFit, ...]]) -> Reference:
    return reference_table(fits[0], SAMPLE[0])


def _table(reflectance: Callable[[Directions, FloatArray], FloatArray], alpha: float) -> Reference:
    """A reference that is known without error."""
    theta_h, theta_d = table_nodes(alpha)
    in_angle, out_angle = folded(*(grid.ravel() for grid in np.meshgrid(theta_h, theta_d, indexing="ij")))
    values = reflectance(in_plane(in_angle, out_angle), NODES).reshape(theta_h.size, theta_d.size, -1)
    one = Lambert(NODES, np.full(NODES.size, np.pi))
    table = BrdfTable(theta_h, theta_d, NODES, np.log(values), one)
    return Reference(table, np.zeros((1, theta_h.size, theta_d.size, 3)))


def without_draws(reference: Reference) -> Reference:
    """The reference as if the measurement knew everything, for a material that is a formula."""
    return replace(reference, draws=np.zeros_like(reference.draws[:1]))


def _tracer(scene: Scene) -> Callable[[int], Vertices]:
    return lambda samples: trace(scene, SAMPLE[0], samples)


def test_the_table_of_a_measurement_holds_out_of_the_plane(reference: Reference) -> None:
    rng = np.random.default_rng(3)
    cos, phi = rng.uniform(0.35, 1, (2, 400)), rng.uniform(0, 2 * np.pi, (2, 400))
    incident, reflected = (
        np.stack([np.sqrt(1 - c**2) * np.cos(p), np.sqrt(1 - c**2) * np.sin(p), c], axis=-1)
        for c, p in zip(cos, phi, strict=True)
    )
    directions = from_vectors(incident, reflected, np.array([0.0, 0.0, 1.0]))
    truth = cook_torrance(directions, NODES, SAMPLE[0], load_conductor(), *SAMPLE[1:])
    error = np.abs(reference.table(directions, NODES) / truth - 1)
    assert np.median(error) < 0.01
    assert np.percentile(error, 95) < 0.05


def test_a_scene_in_the_sun_needs_the_shift_and_one_under_an_even_sky_a_tint(
    fits: tuple[Dataset, tuple[ModelFit, ...]], reference: Reference
) -> None:
    models = fits[1]
    sunny = choose(_tracer(SUN), reference, models, load_conductor(), 1.0)
    assert sunny.chosen is not None
    assert sunny.chosen.rung.name == "cook-torrance-shift"
    even = choose(_tracer(AROUND), reference, models, load_conductor(), 1.0)
    assert even.chosen is not None
    assert even.chosen.rung.name == "tinted"
    by_name = {judged.rung.name: judged for judged in even.judged}
    # the ladder is not monotone: with more physics but without the shift it is worse
    assert by_name["cook-torrance"].score.mean > 2 * by_name["tinted"].score.mean
    for choice in (sunny, even):
        assert choice.chosen is not None
        assert choice.chosen.wavelengths.size <= 4
        assert all(judged.state != "meets" for judged in choice.tried)
        assert choice.judged[-1].score.mean == 0  # the table itself
        assert choice.judged[-1].score.expected > 0  # which does not know everything
        assert all(judged.score.low <= judged.score.expected <= judged.score.high for judged in choice.judged)


def test_a_lambertian_material_needs_no_more_than_lambert(fits: tuple[Dataset, tuple[ModelFit, ...]]) -> None:
    grey = _table(lambda directions, wavelengths: np.full((directions.cos_i.size, wavelengths.size), 0.1), 0.2)
    choice = choose(_tracer(SUN), grey, fits[1], load_conductor(), 0.5)
    assert choice.chosen is not None
    assert choice.chosen.rung.name == "lambert"
    assert choice.chosen.parameters == 1
    assert choice.chosen.score.mean == pytest.approx(0, abs=1e-3)


@pytest.mark.slow
def test_the_interval_of_a_colour_error_holds_the_true_one_whatever_the_measurement_got_wrong(
    measure: Callable[..., Dataset],
) -> None:
    metal, inside = load_conductor(), {"tinted": 0, "cook-torrance-shift": 0, "table": 0}
    seen_in = {name: trace(AROUND if name == "cook-torrance-shift" else SUN, SAMPLE[0], 64) for name in inside}
    right = {
        name: image(vertices, lambda at, nm: cook_torrance(at, nm, SAMPLE[0], metal, *SAMPLE[1:]), NODES).mean(axis=0)
        for name, vertices in seen_in.items()
    }
    for seed in range(2):
        dataset = measure(*SAMPLE, seed=seed, systematic=True, wavelength_step=12.0, incident=(10, 30, 50, 70))
        models = fit_models(dataset, local_fit_for(dataset, METAL_FITS[1:2]), METAL_FITS[1:2])
        known = reference_table(dataset, SAMPLE[0], seed=seed + 10)
        for name, vertices in seen_in.items():
            choice = choose(partial(lambda found, _: found, vertices), known, models, metal, 1e-3)
            judged = next(each for each in choice.judged if each.rung.name == name)
            mine = image(vertices, judged.rung.model, NODES).mean(axis=0)
            error = float(choice.picture.display.difference(mine, right[name]).mean())
            inside[name] += judged.score.low <= error <= judged.score.high
    # of 6 intervals of 90 % fewer than 4 hold the truth twice in a hundred times
    assert sum(inside.values()) >= 4, inside


def test_no_parameter_is_chosen_that_the_data_do_not_tell(
    fits: tuple[Dataset, tuple[ModelFit, ...]], reference: Reference
) -> None:
    unknown = tuple(
        replace(fit, verdict=replace(fit.verdict, undetermined=("h",))) if fit.model != "cook-torrance" else fit
        for fit in fits[1]
    )
    choice = choose(_tracer(SUN), without_draws(reference), unknown, load_conductor(), 1.0)
    assert choice.chosen is not None
    assert choice.chosen.rung.name == "table"
    assert {j.rung.name: j.state for j in choice.judged}["cook-torrance-shift"] == "not identified"


def test_what_noise_decides_is_undetermined_and_never_a_lucky_pass(
    fits: tuple[Dataset, tuple[ModelFit, ...]], reference: Reference
) -> None:
    models, exact = fits[1], without_draws(reference)
    few = choose(lambda _: trace(AROUND, SAMPLE[0], 4), exact, models, load_conductor(), 2.0)
    lambert = few.judged[0]
    edge = 2 * lambert.score.u_trace
    assert edge > 0.5
    at = lambert.score.expected
    passing = choose(lambda _: trace(AROUND, SAMPLE[0], 4), exact, models, load_conductor(), at + 0.5 * edge)
    assert passing.judged[0].state == "undetermined"
    assert passing.chosen is None or passing.chosen.rung.name != "lambert"


def test_shares_that_cannot_be_measured_add_up(reference: Reference) -> None:
    vertices = trace(AROUND, SAMPLE[0], 64)
    xyz = xyz_of_vertices(vertices, reference.table, NODES)
    found = asked(vertices, xyz, display_for(vertices, to_pixels(vertices, xyz).mean(axis=0)))
    assert 0 < found.out_of_plane < 0.2
    assert 0 < found.cells < found.all_cells
    assert found.measurable + found.out_of_plane + found.grazing + found.blocked == pytest.approx(1)
    sunny = trace(SUN, SAMPLE[0], 64)
    seen = xyz_of_vertices(sunny, reference.table, NODES)
    few = asked(sunny, seen, display_for(sunny, to_pixels(sunny, seen).mean(axis=0)))
    assert few.cells < 0.5 * found.cells


def test_candidate_wavelengths_ascend_within_what_the_eye_sees() -> None:
    for count in FEWER:
        wavelengths = nodes(count)
        assert wavelengths.size == count
        assert np.all(np.diff(wavelengths) > 0)
        assert wavelengths.min() >= 400
        assert wavelengths.max() <= 700
