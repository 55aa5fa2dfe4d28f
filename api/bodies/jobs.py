"""Jobs, and what somebody asks of each kind; the numbers and names are those of the command line."""

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from analysis.choices import MODELS, USUAL_COLOUR_ERROR, USUAL_ERROR, Distribution, Engine, Weight
from api.bodies.base import Asked, Body
from api.choices import ChartKind
from goniometer.choices import Quantity
from simulators.choices import ABOUT, METHODS

State = Literal["waiting", "running", "done", "failed", "cancelled", "interrupted"]
OPEN: tuple[State, ...] = ("waiting", "running")


class JobView(Body):
    """A piece of work that takes longer than an answer may."""

    id: int
    kind: str = Field(examples=["fit"])
    title: str = Field(description="What kind it is, for a person.")
    who: str = Field(description="Who asked for it.")
    state: State = Field(description='"interrupted": the service ended before it did; it can be run again.')
    share: float | None = Field(description="How much of it is done, 0 to 1; null where nobody can tell.")
    words: str = Field(description="What it does now.")
    reason: str = Field(description="Why it did not come to its end, as a sentence; empty else.")
    fault: str | None = Field(
        description="What a program calls that, as in the `type` of a problem, where it failed; null else, "
        'and for what failed in older versions. "killed": its process was ended from outside. "conflict": the bench '
        'was stopped. "bench-ended": its process has ended. "internal": a fault of the service, which its log tells.',
        examples=["not-in-store"],
    )
    arguments: dict[str, Any] = Field(description="What was asked for.")
    created: str = Field(description="ISO 8601, UTC, as all times here.")
    started: str | None
    finished: str | None
    has_result: bool = Field(description="Whether there is JSON at /api/jobs/{id}/result.")
    has_page: bool = Field(description="Whether there is HTML at /api/jobs/{id}/page.")


class Upload(Body):
    """A file that was sent."""

    upload: str = Field(description="By what a job is told of it.")
    name: str
    size: int = Field(description="Bytes.")


class DoctorArguments(Asked):
    """How the devices are examined."""

    home: bool = Field(default=False, description="Home stages that do not know their reference; look before.")


class OfDataset(Asked):
    """A job on one dataset."""

    dataset: int = Field(ge=1, lt=2**63, description="Id of the dataset.")


class HowAsked(Asked):
    """What may be chosen of a fit."""

    model: str | None = Field(default=None, description=f"Only this: {', '.join(MODELS)}; null: all of a scan's end.")
    engine: Engine = "fast"
    distribution: Distribution = Field(default="ggx", description="Of the microfacets' normals.")
    weight: Weight = Field(default="none", description="How the cost weighs its terms.")
    conductor: str = Field(default="main/Al/Cheng", description="Metal of refractiveindex.info, shelf/book/page.")


class FitArguments(HowAsked, OfDataset):
    """Fit a dataset anew."""


class ExportOptions(Asked):
    """What a format lets one say; files are named by their uploads."""

    raw: bool = Field(default=False, description="With all raw exposures.")
    license: str | None = Field(default=None, max_length=100, description="SPDX identifier.", examples=["CC-BY-4.0"])
    creators: list[str] = Field(default=[], max_length=100, description='"Family, Given", or an organisation.')
    attached: list[str] = Field(default=[], max_length=100, description="Uploads of files that belong to the sample.")
    about: str | None = Field(default=None, description="Upload of a YAML file of what no database knows.")
    model: str | None = Field(default=None, max_length=40, description="Name of the fitted model.")
    budget: float = Field(default=USUAL_ERROR, ge=1e-4, le=1, description="Relative error of 99 of 100 directions.")
    colour_budget: float = Field(default=USUAL_COLOUR_ERROR, ge=0.01, description="dE00 of 99 of 100 directions.")


class ExportAsked(Asked):
    """In which format a dataset leaves the house."""

    format: str = Field(description="One of those that GET /api/exports/formats lists.", examples=["hdf5"])
    options: ExportOptions = ExportOptions()


class ExportArguments(ExportAsked, OfDataset):
    """Write a dataset for others."""


class ReportArguments(OfDataset):
    """Write the report of a dataset."""


class ImportAsked(Asked):
    """What a person says of an uploaded file; null is what is not said."""

    upload: str = Field(description="Of the file, as POST /api/uploads has told.")
    sample: str | None = Field(default=None, min_length=1, max_length=200, description="Null: that of the file.")
    relative_uncertainty: float | None = Field(default=None, ge=0, description="Of a value, as a part of it (k = 1).")
    relative_noise: float | None = Field(default=None, ge=1e-12)
    aperture: float | None = Field(default=None, ge=0, le=20, description="Full angle, degrees; 0 for a point.")
    angle_uncertainty: float | None = Field(default=None, ge=0, le=10, description="Of either angle, degrees (k = 1).")
    lowest: float = Field(default=0.0, ge=0, description="Shortest wavelength to import, nm.")
    highest: float | None = Field(default=None, ge=0, description="Longest wavelength to import, nm; null: all.")
    quantity: Quantity | None = Field(default=None, description="Table: what the values are.")
    angles: Literal["deg", "rad"] | None = Field(default=None, description="Table: unit of the angles.")
    wavelengths: Literal["nm", "um"] | None = Field(default=None, description="Table: unit of the wavelengths.")
    reference: str | None = Field(default=None, description="Raw text: upload of the scan of the reference panel.")
    certificate: str | None = Field(default=None, description="Raw text: upload of the panel's certificate.")
    darks: str | None = Field(default=None, description="Raw text: upload of spectra without light.")
    dark_subtracted: bool = Field(default=False, description="Raw text: the instrument has subtracted the dark signal.")
    saturation: float | None = Field(default=None, ge=1, description="Raw text: counts of a saturated pixel.")


class RecalibrationAsked(Asked):
    """How raw data is calibrated anew."""

    certificate: str | None = Field(default=None, description="SHA-256 of a known certificate; null: as before.")
    without: list[str] = Field(default=[], description="Corrections to leave out.")
    also: list[str] = Field(default=[], description='Corrections to make besides the usual ones, e.g. "aperture".')
    override_name: str | None = Field(default=None, min_length=1, description="Who answers for an invalid certificate.")
    override_reason: str | None = Field(default=None, min_length=1, description="Why that person does.")

    @model_validator(mode="after")
    def _whole_override(self) -> Self:
        if (self.override_name is None) != (self.override_reason is None):
            raise ValueError("an override needs both override_name and override_reason")
        return self


class RecalibrateArguments(RecalibrationAsked, OfDataset):
    """Calibrate the raw data of a dataset anew."""


class TradeoffArguments(Asked):
    """Chart speed against accuracy on the machine of the service."""

    kinds: list[ChartKind] = Field(default=list(ChartKind), min_length=1)
    dataset: int | None = Field(
        default=None, ge=1, lt=2**63, description="Chart this; null: what the simulated bench makes."
    )
    # names only: a path would let whoever asks look at the files of this machine
    sample: str = Field(
        default="sample-4",
        pattern=r"^[a-z0-9-]{1,40}$",
        description="Material of the simulated bench, whose truth is known.",
    )
    surface: str = Field(
        default="sample-1",
        pattern=r"^(sample-[1-8]|(gaussian|brushed)(:[0-9.e+-]{1,20}){2,3})$",
        description='Surface of the simulations: "sample-1" to "sample-8", "gaussian:RMS:LENGTH" (um) or '
        '"brushed:RMS:ACROSS:ALONG" (um).',
    )
    dielectric: bool = Field(default=False, description="Models: take the ladder of a dielectric.")
    rounds: int = Field(default=5, ge=1, le=50, description="How often everything is timed.")


class StabilityArguments(Asked):
    """Fit difficult measurements of known truth with every method."""

    regimes: list[str] = Field(default=[], description=f"Only these: {'; '.join(ABOUT)}.")
    methods: list[str] = Field(default=[], description=f"Only these: {'; '.join(METHODS)}.")
    runs: int = Field(default=5, ge=1, le=1000, description="Measurements of every cell of the map.")


class ChooseArguments(OfDataset):
    """The simplest model that a scene needs."""

    scene: str = Field(max_length=2_000_000, description="Text of a scene: YAML, or of Mitsuba (XML).")
    scene_format: Literal["yaml", "mitsuba"] = "yaml"
    tolerance: float = Field(default=1.0, ge=0.01, description="Largest mean dE00 in the scene.")
    dielectric: bool = Field(default=False, description="Take the ladder of a dielectric.")
    rendering: bool = Field(default=True, description="Verify by rendering, where Mitsuba is installed.")
