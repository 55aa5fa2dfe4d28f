"""A dataset's fitted models rendered side by side, and its model as a scene for Mitsuba's plugin."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from analysis.bsdf.export import describe, write_bsdf
from analysis.bsdf.rendered_model import of_fit
from analysis.choices import BRDF_MODELS
from analysis.fits.by_name import fit_models, local_fit_for
from analysis.mitsuba.export_plugin import limiting_words, plugin_material, plugin_scene
from analysis.mitsuba.run import bsdf_element
from analysis.mitsuba.vase_render import Comparison, Pictures, Variant, compare, render_scenes, working_variant
from analysis.mitsuba.vase_scene import SceneFiles, vase_scene
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reports.render import difference_picture, shown
from analysis.results import ModelFit
from analysis.scenes.ladder import Microfacet
from api.choices import Through
from api.results.products import conductor_name, distrust, last_way
from api.written import Export, make_folder, write_bytes, write_file
from goniometer.datasets.dataset import Dataset
from goniometer.errors import InputError
from goniometer.storage.store import Store

METAL = ("cook-torrance", "cook-torrance-shift")
DIELECTRIC = ("dielectric", "dielectric-shift")
"""The models that are compared."""

TABLE = "model.bsdf"
_TRIAL_PIXELS = 16


@dataclass(frozen=True)
class RenderedDataset:
    """Two fitted models of a dataset, as they look."""

    sample: str
    models: tuple[str, str]
    comparison: Comparison
    pictures: Pictures
    variant: Variant
    through: Through
    trusted: bool
    """Whether both fits are to be trusted."""
    notes: tuple[str, ...]
    """What a person should know of it, whole sentences."""
    files: tuple[Export, ...]


def render_dataset(
    store: Store,
    dataset_id: int,
    folder: Path,
    *,
    dielectric: bool,
    through: Through | None,
    pixels: int,
    samples: int,
) -> RenderedDataset:
    """Render a dataset's Cook-Torrance with and without shift, and write the pictures to `folder`.

    Models are fitted with the metal, weight and engine of the last fit, and GGX. Without `through` the plugin renders
    where a vectorised variant of Mitsuba works, and tables where it would be too slow. Raises `RenderError` where
    Mitsuba is not there or fails, and what the fits raise.
    """
    dataset, fits, metal = _fitted(store, dataset_id, DIELECTRIC if dielectric else METAL)
    models = [of_fit(fit, metal) for fit in fits]
    variant = working_variant(vase_scene(plugin_material(models[0]), _TRIAL_PIXELS))
    notes = list(variant.refused)
    if through is None:
        through = "plugin" if variant.vectorised else "bsdf"
        if not variant.vectorised:
            notes.append(
                "So the models were rendered as tables; --through plugin has them exactly, at a tenth of the speed."
            )
    scenes = [_scene(model, through, pixels) for model in models]
    notes += [f"{fit.model}: {about}" for fit, (_, about) in zip(fits, scenes, strict=True) if about]
    pictures = render_scenes([scene for scene, _ in scenes], variant, samples)
    comparison = compare(pictures)
    for fit in fits:
        notes += distrust(fit.model, fit.verdict)
    trusted = all(fit.verdict.trusted for fit in fits)
    make_folder(folder)
    names = (fits[0].model, fits[1].model)
    images = zip((*names, "difference"), (*shown(comparison), difference_picture(comparison)), strict=True)
    files = tuple(write_file("picture", folder / f"{name}.png", _png(image)) for name, image in images)
    return RenderedDataset(dataset.sample, names, comparison, pictures, variant, through, trusted, tuple(notes), files)


def write_plugin_scene(store: Store, dataset_id: int, path: Path, model: str | None) -> Export:
    """Write a fitted model of a dataset as a scene for the plugin ggx_shift, with what it needs beside it.

    Without `model` it is Cook-Torrance with shift. Raises `InputError` for a model of no brightness and rather than
    replace another file of a name that is needed, and `ExportError` for a model that the plugin does not have.
    """
    wanted = model or METAL[1]
    if wanted not in BRDF_MODELS:
        raise InputError(f'"{wanted}" is no model that can be rendered; there are {", ".join(BRDF_MODELS)}.')
    dataset, fits, metal = _fitted(store, dataset_id, (wanted,))
    reflectance = of_fit(fits[-1], metal)
    about = describe(fits[-1], dataset)
    if limited := limiting_words(reflectance):
        about += f"\n{limited}"
    scene = plugin_scene(reflectance, about)
    beside = {path.with_name(name): content for name, content in scene.files.items()}
    for place, content in beside.items():
        if place.is_file() and place.read_bytes() != content:  # somebody's own, or that of other scenes
            raise InputError(
                f"{place} is there already, and is not what the scene needs there; name another folder, or move it away"
            )
    for place, content in beside.items():
        write_bytes("mitsuba-plugin", place, content)
    export = write_file("mitsuba-plugin", path, lambda part: part.write_text(scene.xml, encoding="utf-8"))
    verdict = fits[-1].verdict
    told = f"beside it: {', '.join(scene.files)}"
    notes = (f"model {wanted}", *distrust(wanted, verdict), told, *([limited] if limited else []))
    facts = {"model": wanted, "trusted": verdict.trusted, "beside": sorted(scene.files), "clamped": limited or None}
    return replace(export, notes=notes, facts=facts)


def _fitted(store: Store, dataset_id: int, models: tuple[str, ...]) -> tuple[Dataset, tuple[ModelFit, ...], Conductor]:
    dataset = store.dataset(dataset_id)
    how = last_way(store, dataset_id)
    metal = load_conductor(*conductor_name(how.conductor))
    local = local_fit_for(dataset, models, metal, how.engine)
    return dataset, fit_models(dataset, local, models, metal, how.engine, "ggx", how.weight), metal


def _scene(model: Microfacet, through: Through, pixels: int) -> tuple[SceneFiles, str]:
    """A scene, and what a person should know of how it has the model; may be empty."""
    if through == "plugin":
        return vase_scene(plugin_material(model), pixels), ""
    with tempfile.TemporaryDirectory(prefix="goniometer-") as name:
        path = Path(name) / TABLE
        report = write_bsdf(path, model)
        content = path.read_bytes()
    found = vase_scene(bsdf_element("measured", f'<string name="filename" value="{TABLE}"/>'), pixels)
    error = report.written
    about = (
        f"its table is off by less than {error.error.p99:.1%} and {error.colour:.2f} dE00 in 99 of 100 directions. "
        f"{report.clamped}"
    )
    return replace(found, files=found.files | {TABLE: content}), about.strip()


def _png(image: np.ndarray) -> Callable[[Path], object]:
    from matplotlib.image import imsave  # noqa: PLC0415  (takes a second)

    return lambda part: imsave(part, image, format="png")
