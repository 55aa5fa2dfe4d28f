"""What came of questions about speed, stability and models, so that pages can draw it and act on it."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from analysis.choices import State
from api.bodies.base import Body, Number, number

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
