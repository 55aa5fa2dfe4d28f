"""Fits of a dataset, and files that are written from it."""

from pydantic import Field

from api.bodies.base import Body, Number


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


class FormatView(Body):
    """A format in which a dataset leaves the house."""

    name: str
    about: str
    ending: str = Field(description="Of the file, without a dot.")
    options: list[str] = Field(description="What it lets one say, by name.")


class ExportView(Body):
    """A file that was written from a dataset."""

    id: int
    dataset: int
    format: str
    file: str = Field(description="Its name.")
    sha256: str
    created: str = Field(description="ISO 8601, UTC.")
    available: bool = Field(description="Whether it is still where it was written.")
