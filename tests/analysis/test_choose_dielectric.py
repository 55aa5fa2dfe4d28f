"""A dielectric of the bench, whose truth is known in all directions, gets the model that its truth says will do."""

from collections.abc import Callable

import numpy as np
import pytest

from analysis.fits.by_name import fit_models, local_fit_for
from analysis.mitsuba.verify import cheaper
from analysis.reflectance.directions import Directions
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import dielectric
from analysis.results import ModelFit
from analysis.scenes.brdf_table import Reference, reference_table
from analysis.scenes.choose import NODES, choose
from analysis.scenes.ladder import DIELECTRIC_FITS, guides, roughness
from analysis.scenes.rays import trace
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import Reflectance, display_for, image
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from simulators.costs.measurements import drawn
from simulators.materials.surfaces import SANDED, mean_brdf

CAMERA = {"position": (0.0, -4.0, 1.0), "pixels": (16, 16), "field_of_view": 32.0}
BALL = [{"sphere": 1.0}]
SUN = Scene.model_validate({"camera": CAMERA, "material": BALL, "lights": [{"sun": (1.0, -1.0, 1.0)}]})
AROUND = Scene.model_validate({"camera": CAMERA, "material": BALL, "lights": [{"environment": 1.0}]})
LADDER = DIELECTRIC_FITS[:2]
SANDED_SPECTRALON = SANDED["srs-02-grit-1000"]


def truth(directions: Directions, wavelengths: FloatArray) -> FloatArray:
    """BRDF [vertices, wavelengths] of the sheet, in the plane and out of it."""
    columns = Directions(*(cosine[:, None] for cosine in directions))
    no_metal = np.ones_like(wavelengths), np.zeros_like(wavelengths)
    return mean_brdf(SANDED_SPECTRALON, columns, np.ones(1), wavelengths, no_metal)


@pytest.fixture(scope="module")
def sanded() -> tuple[Dataset, tuple[ModelFit, ...], Reference]:
    (dataset,), _ = drawn(SANDED_SPECTRALON.name, SANDED_SPECTRALON, 1)
    dataset = dataset.at_wavelengths(slice(None, None, 10)).at_points(np.arange(0, dataset.theta_in.size, 2))
    fits = fit_models(dataset, local_fit_for(dataset, LADDER), LADDER)
    return dataset, fits, reference_table(dataset, roughness(fits), guides(fits))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "tolerance", "model"),
    [(SUN, 2.0, "dielectric-shift"), (SUN, 1.0, "table"), (AROUND, 1.0, "dielectric-shift")],
)
def test_the_chosen_model_meets_the_tolerance_and_the_next_cheaper_does_not_by_the_truth(
    sanded: tuple[Dataset, tuple[ModelFit, ...], Reference], scene: Scene, tolerance: float, model: str
) -> None:
    _, fits, reference = sanded
    alpha = roughness(fits)
    choice = choose(lambda samples: trace(scene, alpha, samples), reference, fits, load_conductor(), tolerance)
    assert choice.chosen is not None
    assert choice.chosen.rung.name == model
    other_rays = trace(scene, alpha, 64, seed=7)
    right = image(other_rays, truth, NODES).mean(axis=0)
    display = display_for(other_rays, right)

    def error(reflectance: Reflectance, wavelengths: FloatArray) -> float:
        return float(display.difference(image(other_rays, reflectance, wavelengths).mean(axis=0), right).mean())

    chosen = error(choice.chosen.rung.model, choice.chosen.wavelengths)
    assert chosen <= tolerance
    assert chosen == pytest.approx(choice.chosen.score.expected, rel=0.1, abs=0.1)
    for judged in [each for each in cheaper(choice) if each.state == "fails"]:
        assert error(judged.rung.model, NODES) > tolerance


def _wrong_out_of_plane(reference: Reference, right: Reflectance) -> float:
    """95th percentile of the relative error of a table in directions like those of a ball in the sun."""
    directions = trace(SUN, 0.3, 16).directions
    usual = np.minimum(directions.cos_i, directions.cos_o) > 0.35
    some = Directions(*(cosine[usual] for cosine in directions))
    return float(np.percentile(np.abs(reference.table(some, NODES) / right(some, NODES) - 1), 95))


@pytest.mark.slow
def test_a_table_holds_out_of_the_plane_whether_light_below_the_surface_passes_an_interface_or_not(
    sanded: tuple[Dataset, tuple[ModelFit, ...], Reference], measure: Callable[..., Dataset]
) -> None:
    assert _wrong_out_of_plane(sanded[2], truth) < 0.05

    def lambertian_below(directions: Directions, wavelengths: FloatArray) -> FloatArray:
        return dielectric(directions, wavelengths, 0.25, 1.5, 0.3 + 1e-3 * (wavelengths - 600), 1.2, 2.5)

    seen = measure(0.25, brdf=lambertian_below, wavelength_step=23.0, incident=range(0, 81, 20), noise=1e-3)
    seen = seen.at_wavelengths(np.flatnonzero(seen.wavelengths < 750))
    fits = fit_models(seen, local_fit_for(seen, ("dielectric",)), ("dielectric",))
    reference = reference_table(seen, roughness(fits), guides(fits))
    assert _wrong_out_of_plane(reference, lambertian_below) < 0.05
