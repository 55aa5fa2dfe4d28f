"""Which model of a dataset a scene needs."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from analysis.brdf_table import reference_table
from analysis.choose import Choice, Judged, choose
from analysis.fits import fit_models, local_fit_for
from analysis.fresnel import load_conductor
from analysis.ladder import DIELECTRIC_FITS, METAL_FITS
from analysis.scene import load_scene
from analysis.scene_rays import trace
from api.products import conductor_name, last_way
from goniometer.store import Store


def choose_model(store: Store, dataset_id: int, scene_file: Path, tolerance: float, *, dielectric: bool) -> Choice:
    """The simplest model of a dataset whose mean dE00 in a scene stays below `tolerance`.

    Models are fitted with the metal, distribution, weight and engine of the last fit. Raises `InputError` for a scene
    that is none, `SceneError` for one that shows nothing of the material, and what the fits raise.
    """
    scene = load_scene(scene_file)
    dataset = store.dataset(dataset_id)
    how = last_way(store, dataset_id)
    metal = load_conductor(*conductor_name(how.conductor))
    models = DIELECTRIC_FITS if dielectric else METAL_FITS
    local = local_fit_for(dataset, models, metal, how.engine)
    fits = fit_models(dataset, local, models, metal, how.engine, how.distribution, how.weight)
    alpha = fits[0].value("alpha")
    reference = reference_table(dataset, alpha, metal=not dielectric)
    return choose(lambda samples: trace(scene, alpha, samples), reference, fits, metal, tolerance)


def choice_content(choice: Choice) -> dict[str, Any]:
    """A choice as one JSON object."""
    wanted = choice.asked
    return {
        "tolerance": choice.tolerance,
        "chosen": None if choice.chosen is None else _judged(choice.chosen),
        "rungs": [_judged(judged) for judged in choice.judged],
        "too_few_wavelengths": [_judged(judged) for judged in choice.tried],
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
    }


def _judged(judged: Judged) -> dict[str, Any]:
    return {
        "model": judged.rung.name,
        "state": judged.state,
        "why": judged.why,
        "dE00": asdict(judged.score),
        "wavelengths_nm": judged.wavelengths.tolist(),
        "parameters": judged.parameters,
        "bytes": judged.size,
        "nanoseconds": judged.nanoseconds,
    }
