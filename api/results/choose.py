"""Which model of a dataset a scene needs."""

from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from analysis.figures.page import png
from analysis.fits.by_name import fit_models, local_fit_for
from analysis.mitsuba.run import Material, trace_mitsuba
from analysis.mitsuba.scene import read_mitsuba, write_mitsuba
from analysis.mitsuba.verify import Verification, verify
from analysis.reflectance.fresnel import load_conductor
from analysis.reports.choose import RUNG_NAMES, rendered_panels, shaded, summary
from analysis.scenes.brdf_table import reference_table
from analysis.scenes.choose import NODES, Choice, Judged, choose, least_directions
from analysis.scenes.ladder import DIELECTRIC_FITS, METAL_FITS, guides, roughness
from analysis.scenes.rays import trace
from analysis.scenes.scene import load_scene
from analysis.scenes.vertices import Vertices
from api.results.products import conductor_name, last_way
from goniometer.campaigns.campaign import AngleSteps
from goniometer.campaigns.scene_weights import SceneWeights
from goniometer.plans.plan_spec import PlanSpec, coarse, incident
from goniometer.storage.store import Store


@dataclass(frozen=True)
class Chosen:
    """A choice, and its rendering."""

    choice: Choice
    rendered: Verification | None
    """None where nothing was chosen or rendered."""


def choose_model(
    store: Store, dataset_id: int, scene_file: Path, tolerance: float, *, dielectric: bool, rendering: bool
) -> Chosen:
    """The simplest model of a dataset whose mean dE00 in a scene stays below `tolerance`.

    `scene_file` is one of Mitsuba's (.xml) or of `analysis.scenes.scene`. Models are fitted with the metal,
    distribution, weight and engine of the last fit. Raises `InputError` for a scene that is none, `SceneError` for one
    that shows nothing of the material, `RenderError` where Mitsuba fails, and what the fits raise.
    """
    of_mitsuba = read_mitsuba(scene_file) if scene_file.suffix.lower() == ".xml" else None
    own = None if of_mitsuba is not None else load_scene(scene_file)
    dataset = store.dataset(dataset_id)
    how = last_way(store, dataset_id)
    metal = load_conductor(*conductor_name(how.conductor))
    models = DIELECTRIC_FITS if dielectric else METAL_FITS
    local = local_fit_for(dataset, models, metal, how.engine)
    fits = fit_models(dataset, local, models, metal, how.engine, how.distribution, how.weight)
    alpha = roughness(fits)
    reference = reference_table(dataset, alpha, guides(fits))

    def traced(samples: int) -> Vertices:
        if own is not None:
            return trace(own, alpha, samples)
        assert of_mitsuba is not None  # one of the two was read
        return trace_mitsuba(of_mitsuba, Material(reference.table, NODES, alpha), samples)

    found = choose(traced, reference, fits, metal, tolerance)
    if not rendering:
        return Chosen(found, None)
    scene = of_mitsuba if own is None else write_mitsuba(own)
    assert scene is not None  # one of the two was read
    return Chosen(found, verify(scene, found, reference.table, alpha))


def first_pass(weights: SceneWeights) -> str:
    """How the scan of a scene begins, beside that of all directions; no sentence end."""
    usual = PlanSpec(AngleSteps(start=0, stop=80, step=10).angles)
    here = replace(usual, importance=weights.importance, colour_slope=weights.colour_slope)
    return (
        f"a campaign with it visits {len(incident(here))} of {len(usual.theta_in)} incident angles and begins with "
        f"{len(coarse(here))} directions instead of {len(coarse(usual))}"
    )


def mitsuba_is_there() -> bool:
    """Whether Mitsuba is installed; it is not loaded."""
    return find_spec("mitsuba") is not None


def choice_content(found: Chosen) -> dict[str, Any]:
    """A choice as one JSON object."""
    choice, rendered = found.choice, found.rendered
    wanted = choice.asked
    return {
        "words": summary(choice),
        "tolerance": choice.tolerance,
        "chosen": None if choice.chosen is None else _judged(choice, choice.chosen),
        "rungs": [_judged(choice, judged) for judged in choice.judged],
        "too_few_wavelengths": [_judged(choice, judged) for judged in choice.tried],
        "clipped_share": choice.picture.clipped,
        "dark_share": choice.picture.dark,
        "asked": {
            "cells": wanted.cells,
            "all_cells": wanted.all_cells,
            "measurable_share": wanted.measurable,
            "out_of_plane_share": wanted.out_of_plane,
            "grazing_share": wanted.grazing,
            "blocked_share": wanted.blocked,
        },
        "rendered": None
        if rendered is None
        else [
            {"model": each.judged.rung.name, "mean": each.mean, "p95": each.p95, "u_mean": each.u_render}
            for each in rendered.models
        ],
    }


def choice_pictures(found: Chosen) -> list[dict[str, Any]]:
    """What the scene looks like, shaded here and rendered where it was: PNG files in base64."""
    made = [("shaded", shaded(found.choice))]
    if found.rendered is not None:
        made.append(("rendered", rendered_panels(found.choice, found.rendered)))
    return [
        {"by": by, "name": each.name, "words": each.words, "dE00_brightest": each.top, "png": png(each.image)}
        for by, panels in made
        for each in panels
    ]


def _judged(choice: Choice, judged: Judged) -> dict[str, Any]:
    return {
        "model": judged.rung.name,
        "name": RUNG_NAMES[judged.rung.name],
        "state": judged.state,
        "why": judged.why,
        "dE00": asdict(judged.score),
        "wavelengths_nm": judged.wavelengths.tolist(),
        "parameters": judged.parameters,
        "bytes": judged.size,
        "least_directions": least_directions(choice, judged),
        "nanoseconds": judged.nanoseconds,
    }
