"""What came of questions about speed, stability and models, so that pages can draw it and act on it."""

import json
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from analysis.choose import State
from api.views.body import Body, Number, number
from goniometer.errors import NotInStore

Told = Annotated[Number, BeforeValidator(number)]
"""A number of a result, in which infinities are words; they are no value here."""


class Use(Body):
    """What somebody asks for who wants a way for themselves."""

    kind: Literal["campaign", "fit", "choose", "text"]
    settings: dict[str, str | float] = Field(
        description='"campaign": keys of its resolution; "fit": model and engine; "text": `text` to copy.',
        examples=[{"mode": "dynamic", "tolerance": 0.005}],
    )
    note: str = Field(description="Where what one gets so differs from what was charted; empty where it does not.")


class Way(Body):
    """One mark of a chart."""

    name: str = Field(examples=["0.005"])
    setting: str = Field(description="What exactly was done, as a phrase.")
    family: str = Field(description="Ways of one family differ by the effort they take.", examples=["dynamic"])
    cost: Told = Field(description="Median of the rounds, in the unit of the chart.")
    cost_low: Told = Field(description="Lower quartile.")
    cost_high: Told = Field(description="Upper quartile.")
    error: Told
    more: dict[str, Told] = Field(description="Further figures by name with unit.")
    on_front: bool = Field(description="No other way costs less and errs less.")
    use: Use | None = Field(default=None, description="Null where no command offers it.")


class ChartAxis(Body):
    """What a chart shows along one side."""

    name: str
    unit: str = Field(description="Empty for a pure number.")


class TradeoffChart(Body):
    """Ways to one result; both axes are logarithmic."""

    kind: str = Field(examples=["scan-error"])
    title: str
    caption: str
    cost: ChartAxis
    error: ChartAxis
    choices: list[Way]


class Tradeoff(Body):
    """What a job has charted."""

    job: int
    charts: list[TradeoffChart]


class StabilityCell(Body):
    """All runs of one level of a difficulty with one method."""

    regime: str
    level: str
    method: str
    runs: int
    right: Told = Field(description="Share that came out as near to the truth as is of use; null: no truth.")
    trusted: Told = Field(description="Share with a good verdict.")
    silent: int = Field(description="How many were wrong and did not say so.")
    covered: Told = Field(description="Share of the 95 % intervals under a good verdict that hold the truth.")
    worst: Told = Field(description="Largest deviation under a good verdict, standard errors.")
    bias: dict[str, Told] = Field(description="Mean of fitted - true by parameter.")
    reached: Told = Field(description="Share of random starts that ended where the fit did; null: none was tried.")
    lower: int = Field(description="How many random starts ended lower.")
    said: str = Field(description="What verdicts say most often; empty where they say nothing.")


class StabilityMap(Body):
    """Where fits can be believed."""

    job: int
    regimes: dict[str, str] = Field(description="What is difficult, by its name, in the order of the map.")
    methods: list[str] = Field(description="In the order of the map.")
    cells: list[StabilityCell]


class EstimateView(Body):
    """What a fit says of a parameter, and what is true."""

    value: Told
    u: Told = Field(description="Stated standard error; null: the data do not tell.")
    true: Told


class RunView(Body):
    """One fit of one simulated measurement."""

    seed: int
    right: Told = Field(description="1, 0, or of a local fit the share of spectra; null: no truth.")
    trusted: bool
    silent: bool
    z: dict[str, Told] = Field(description="(Fitted - true) / standard error, of what a good verdict vouches for.")
    covered: Told
    start: str = Field(description='Where a random start ended: "reached", "missed", "lower"; empty: none was tried.')
    reasons: list[str] = Field(description="The verdict in words.")
    estimates: dict[str, EstimateView]


class Ensemble(Body):
    """The runs behind a cell of the map."""

    job: int
    about: str = Field(description="What is difficult.")
    cell: StabilityCell
    runs: list[RunView] = Field(description="By seed.")


class Differences(Body):
    """How far a model is from the measurement in a scene, CIEDE2000."""

    mean: Told = Field(description="Over the pixels, if the measurement were exact.")
    p95: Told
    expected: Told = Field(description="Mean over what the measurement leaves possible.")
    u_trace: Told = Field(description="Standard error by the samples of the trace.")
    low: Told
    high: Told


class RungView(Body):
    """A model in a scene."""

    model: str
    name: str = Field(description="For a person.")
    state: State
    why: str
    dE00: Differences  # noqa: N815  (the field's own spelling)
    wavelengths_nm: list[float]
    parameters: int = Field(description="Numbers that describe it.")
    bytes: int
    least_directions: int = Field(description="How many must be measured at the least.")
    nanoseconds: Told = Field(description="Of one direction at one wavelength on this machine.")


class RenderedView(Body):
    """A model as Mitsuba has rendered it."""

    model: str
    mean: Told
    p95: Told
    u_mean: Told


class PictureView(Body):
    """A picture of the scene; it is at /api/choose/{job}/pictures/{by}/{name}."""

    by: Literal["shaded", "rendered"]
    name: Literal["measurement", "model", "difference"]
    words: str
    dE00_brightest: Told = Field(  # noqa: N815  (the field's own spelling)
        description="Of a difference: what is drawn brightest; else null."
    )


class ChoiceView(Body):
    """The simplest model that a scene needs."""

    job: int
    dataset: int
    sample: str
    scene: str = Field(description="Its text as it was asked for.")
    tolerance: float = Field(description="Largest mean dE00.")
    words: list[str] = Field(description="The answer in sentences, the first one first.")
    chosen: RungView | None
    rungs: list[RungView] = Field(description="All models, simplest first, at all wavelengths.")
    fewer: list[RungView] = Field(description="The chosen one at fewer wavelengths than will do.")
    rendered: list[RenderedView]
    pictures: list[PictureView]


def tradeoff(job: int, result: dict[str, Any]) -> Tradeoff:
    """The charts of a job."""
    return Tradeoff(job=job, charts=result["charts"])


def stability_map(job: int, result: dict[str, Any]) -> StabilityMap:
    """The map of a job."""
    cells = [StabilityCell(**cell) for cell in result["cells"]]
    about = {regime: result["regimes"][regime] for regime in dict.fromkeys(cell.regime for cell in cells)}
    return StabilityMap(job=job, regimes=about, methods=list(dict.fromkeys(cell.method for cell in cells)), cells=cells)


def ensemble(job: int, result: dict[str, Any], regime: str, level: str, method: str) -> Ensemble:
    """The runs behind a cell; raises `NotInStore` where there is no such cell, or an older version kept no runs."""
    asked = regime, level, method
    cell = next((c for c in result["cells"] if (c["regime"], c["level"], c["method"]) == asked), None)
    if cell is None:
        raise NotInStore(f"Job {job} has no cell {regime}, {level}, {method}; its map lists them")
    if "runs" not in result:
        raise NotInStore(f"Job {job} was run by a version that did not keep single runs; run it again")
    mine = [run for run in result["runs"] if tuple(run["job"][k] for k in ("regime", "level", "method")) == asked]
    runs = [RunView(**{"seed": run["job"]["seed"]} | run) for run in mine]
    return Ensemble(
        job=job,
        about=result["regimes"][regime],
        cell=StabilityCell(**cell),
        runs=sorted(runs, key=lambda run: run.seed),
    )


def choice(job: int, arguments: str, result: dict[str, Any]) -> ChoiceView:
    """What a job has chosen; raises `NotInStore` where an older version wrote it down otherwise."""
    if "words" not in result:
        raise NotInStore(f"Job {job} was run by a version that kept less of it; run it again")
    return ChoiceView(
        job=job,
        dataset=result["dataset"],
        sample=result["sample"],
        scene=json.loads(arguments)["scene"],
        tolerance=result["tolerance"],
        words=result["words"],
        chosen=result["chosen"],
        rungs=result["rungs"],
        fewer=result["too_few_wavelengths"],
        rendered=result["rendered"] or [],
        pictures=result["pictures"],
    )
