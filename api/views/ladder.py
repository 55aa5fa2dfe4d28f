"""The models that were fitted, from the simplest on: what each costs, how far off it is, and what speaks for it."""

import json
import math
from typing import Any

from analysis.choices import BRDF_MODELS, MODEL_NAMES, MODELS
from analysis.figures.notation import roughly, with_uncertainty
from api.bodies.base import number
from api.bodies.fits import Difference, FitRow, FittedModel, FittedParameter, Gain, Ladder
from api.views.opened import Opened
from goniometer.storage.records import StoredText


def ladder(opened: Opened) -> Ladder:
    """The newest fit of every model of a dataset."""
    order = {model: i for i, model in enumerate(MODELS)}
    stored = sorted((fit for model, fit in opened.newest.items() if model in order), key=lambda fit: order[fit.kind])
    models = [_model(fit) for fit in stored]
    # models of the slopes take their brightness from the measurement
    sound = [m for m in models if m.model in BRDF_MODELS and m.trusted and m.absolute.mean is not None]
    best = min(sound, key=lambda m: m.absolute.mean or math.inf).model if sound else None
    return Ladder(dataset=opened.entry.id, models=models, best=best)


def fit_row(fit: StoredText) -> FitRow:
    """The line of a list of fits."""
    content = json.loads(fit.text)
    verdict = content.get("verdict")
    return FitRow(
        id=fit.id,
        dataset=fit.dataset_id,
        model=fit.kind,
        software_version=content["software"]["version"],
        trusted=None if verdict is None else verdict["trusted"],
    )


def _model(stored: StoredText) -> FittedModel:
    content = json.loads(stored.text)
    verdict, metrics = content["verdict"], content["metrics"]
    gain = content.get("comparison")
    return FittedModel(
        fit=stored.id,
        model=content["model"],
        name=MODEL_NAMES[content["model"]],
        equation=content["equation"],
        engine=content["engine"],
        distribution=content.get("distribution"),
        conductor=content["conductor"]["name"] if "conductor" in content else None,
        parameter_count=len(content["parameters"]),
        parameters=[_parameter(each, verdict) for each in content["parameters"]],
        cost=metrics["cost"]["name"],
        cost_value=number(metrics["cost"]["value"]),
        r2=number(metrics["r2"]),
        absolute=_difference(metrics["dE00"]["absolute"]),
        chromatic=_difference(metrics["dE00"]["chromatic"]),
        against_simpler=None
        if gain is None
        else Gain(
            simpler=gain["simpler_model"],
            bic_falls_by=number(gain["BIC_falls_by"]),
            mean_dE00_falls_by=number(gain["mean_dE00_falls_by"]),
        ),
        trusted=verdict["trusted"],
        reasons=verdict["reasons"],
    )


def _parameter(each: dict[str, Any], verdict: dict[str, Any]) -> FittedParameter:
    value, u = number(each["value"]), number(each["standard_error"])
    determined = each["name"] not in verdict["undetermined"] and value is not None
    if value is None or not determined:
        text = "not determined"
    else:
        text = with_uncertainty(value, math.nan if u is None else u) if verdict["trusted"] else roughly(value)
    return FittedParameter(
        name=each["name"],
        value=value,
        u=u,
        unit=each["unit"],
        determined=determined,
        text=text if each["unit"] == "1" or not determined else f"{text} {each['unit'].replace('um', 'µm')}",
        u_by_part=each["standard_error_by_part"],
    )


def _difference(found: dict[str, Any]) -> Difference:
    known = {name: number(found[name]) for name in ("mean", "median", "p95", "max")}
    return Difference(**known, count=int(found["count"]))
