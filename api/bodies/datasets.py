"""Datasets and samples: what a list shows, how good they are, and where they come from."""

from typing import Literal

from pydantic import Field

from api.bodies.base import Body, Number
from goniometer.datasets.dataset import Kind


class DatasetRow(Body):
    """A dataset as a list shows it."""

    id: int
    sample: str = Field(description="Name of the sample, with the number of the repeat where there are several.")
    kind: Kind
    campaign_id: int | None = Field(description="Null where no campaign of this database measured it.")
    campaign: str | None
    bench: str | None = Field(description="Name of the bench; null where no campaign of this database measured it.")
    operator: str | None = Field(description="Who put the campaign into the queue; null where no service measured it.")
    scan_id: int | None
    created: str = Field(description="ISO 8601, UTC.")
    points: int = Field(description="Directions with a spectrum.")
    incident_angles: int
    wavelengths_nm: tuple[float, float] = Field(description="Shortest and longest, nm.")
    flags: list[str] = Field(description="Names of all flags that occur.")
    flagged: int = Field(description="Points with any flag.")
    checks_failed: int
    recalibrated_from: int | None = Field(description="The dataset that it was made anew from.")
    content_hash: str = Field(description="SHA-256 of all its numbers: two datasets of one hash are equal.")
    software_version: str


class FlagUse(Body):
    """A flag that occurs."""

    flag: str
    meaning: str
    points: int


class DatasetDetail(DatasetRow):
    """A dataset as it opens; what is large stands in resources of its own."""

    theta_in_deg: list[float] = Field(description="Mean of every incident angle, degrees, ascending.")
    theta_out_deg: tuple[float, float] = Field(description="Smallest and largest reflected angle, degrees.")
    wavelength_count: int
    aperture_deg: float = Field(description="Full angle of the detector's aperture, degrees; 0 where corrected for.")
    u_angle_deg: float = Field(description="Standard uncertainty (k = 1) of one stage position, degrees.")
    u_zero_deg: float = Field(description="Standard uncertainty (k = 1) of the zero of each stage, degrees.")
    median_relative_u: Number = Field(description="Combined standard uncertainty (k = 1) over the value, median.")
    flag_uses: list[FlagUse]
    fitted: list[str] = Field(description="Models of which there is a fit, oldest first.")
    certificate_override: str | None = Field(description="Who answers for a certificate that was not valid, and why.")


NEWEST = 200
"""Datasets that a sample tells of."""


class SampleRow(Body):
    """A sample."""

    name: str
    datasets: int = Field(description="How many there are of it.")
    newest: DatasetRow | None = Field(description="Null where it was not measured to the end yet.")


class SampleView(SampleRow):
    """A sample and its datasets."""

    all: list[DatasetRow] = Field(description=f"The newest {NEWEST}, newest first.")


class CheckResult(Body):
    """One question that the dataset was asked."""

    name: str
    passed: bool | None = Field(description="Null where the data do not tell.")
    message: str


class FlagCount(Body):
    """A flag that occurs."""

    flag: str
    meaning: str
    points: int
    in_fits: str = Field(description="What the fits do with its points.")


class Checks(Body):
    """All checks and flags of a dataset."""

    dataset: int
    sample: str
    passed: bool = Field(description="False where any check failed.")
    checks: list[CheckResult]
    points: int
    flags: list[FlagCount]
    too_noisy: str = Field(description="Which points missed the wanted signal-to-noise ratio; empty where none did.")
    certificate_override: str | None


class SourceShare(Body):
    """One source of error of one value."""

    name: str
    u: float = Field(description="Standard uncertainty (k = 1), 1/sr; signed: what its error does to the BRDF.")
    relative: Number
    share: float = Field(description="Of the variance, 0 to 1.")
    shared: str = Field(description="Which points and wavelengths have the same error, in words.")


class PartShare(Body):
    """A part of the budget of one value."""

    name: str
    u: float
    relative: Number
    share: float
    sources: list[SourceShare]


class UncertaintyBudget(Body):
    """The budget of one measured value."""

    dataset: int
    sample: str
    theta_in: float = Field(description="Of the measured point, degrees, as read back.")
    theta_out: float
    wavelength: float = Field(description="nm")
    brdf: float = Field(description="1/sr")
    u: float = Field(description="Combined standard uncertainty (k = 1), 1/sr.")
    parts: list[PartShare]
    expanded_uncertainty: float = Field(description="1/sr, by `coverage_factor`.")
    coverage_factor: int
    coverage: str


NodeKind = Literal[
    "dataset", "scan", "exposures", "darks", "stray", "monitors", "reference", "certificate", "file", "simulation",
    "fit", "export",
]  # fmt: skip


class LineageNode(Body):
    """A thing from which something was made, or that was made from it."""

    kind: NodeKind
    title: str = Field(description="For a person.")
    href: str | None = Field(default=None, description="Where this service tells more of it.")
    ids: list[int] = Field(default=[], description="Of the rows of the database that it stands for.")
    about: dict[str, str] = Field(default={}, description="What else is known of it, in words.")
    sources: list["LineageNode"] = Field(default=[], description="What it was made from.")


class Lineage(Body):
    """Both directions from one dataset."""

    dataset: LineageNode
    derived: list[LineageNode] = Field(description="Fits, files and datasets that were made from it.")
