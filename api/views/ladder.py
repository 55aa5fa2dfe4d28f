"""The models that were fitted, from the simplest on: what each costs, how far off it is, and what speaks for it."""

import json
import math
from typing import Any

from pydantic import Field

from analysis.choices import BRDF_MODELS, MODELS
from analysis.notation import roughly, with_uncertainty
from analysis.page import MODEL_NAMES
from api.views.body import Body, Number, number
from api.views.opened import Opened
from goniometer.records import StoredText


class FittedParameter(Body):
    """A parameter of a fit."""

    name: str
    value: Number
    u: Number = Field(description="Standard uncertainty (k = 1); null where the data do not tell.")
    unit: str = Field(description='"1" for a pure number, else e.g. "1/um".')
    determined: bool
    text: str = Field(description="For a person, e.g. 1.234(12); with ≈ where the fit is not to be trusted.")
    u_by_part: dict[str, float] = Field(description="What each part of the budget gives to `u`.")


class Difference(Body):
    """CIEDE2000 over all points that have a colour."""

    mean: Number
    median: Number
    p95: Number
    max: Number
    count: int


class Gain(Body):
    """A model against the simpler one that it contains."""

    simpler: str
    bic_falls_by: Number = Field(description="Above 10: very strong evidence.")
    mean_dE00_falls_by: Number  # noqa: N815  (the field's own spelling)


class FittedModel(Body):
    """A fit."""

    fit: int = Field(description="Id of the fit; its JSON is at /api/fits/{fit}.")
    model: str
    name: str = Field(description="For a person.")
    equation: str
    engine: str
    distribution: str | None
    conductor: str | None = Field(description="Metal, shelf/book/page; null for a model that needs none.")
    parameter_count: int
    parameters: list[FittedParameter]
    cost: str = Field(description="What was minimised.")
    cost_value: Number
    r2: Number
    absolute: Difference = Field(description="Of the spectra as they are.")
    chromatic: Difference = Field(description="Of spectra at one level; where their hue is known.")
    against_simpler: Gain | None
    trusted: bool
    reasons: list[str] = Field(description="The verdict in words.")


class Ladder(Body):
    """The newest fit of every model, simplest first."""

    dataset: int
    models: list[FittedModel]
    best: str | None = Field(
        description="The trusted model of brightness and colour with the smallest mean dE00; null of none."
    )


class FitRow(Body):
    """A fit as a list shows it."""

    id: int
    dataset: int
    model: str = Field(description='"analysis" holds the local fit and all models of a scan\'s end.')
    software_version: str
    trusted: bool | None = Field(description="Null of an analysis, which holds several verdicts.")


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
