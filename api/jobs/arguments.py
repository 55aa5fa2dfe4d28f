"""What somebody asks of each kind of job; the numbers and names are those of the command line."""

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from analysis.bsdf_search import Budget
from analysis.choices import MODELS, Distribution, Engine, Weight
from analysis.fresnel import load_conductor
from api.choices import Kind as ChartKind
from api.exports.formats import FORMATS
from api.results.certificates import known_certificate
from api.results.foreign_scene import check_foreign_scene
from api.results.products import conductor_name
from api.results.quality import settings_of
from goniometer.choices import Quantity
from goniometer.errors import InputError
from goniometer.store import Store
from simulators.choices import METHODS
from simulators.ensemble import jobs
from simulators.regimes import REGIMES


class Arguments(BaseModel):
    """What somebody asks of a job."""

    model_config = ConfigDict(extra="forbid")

    def check(self, store: Store) -> None:
        """Raise what can be known to be wrong before the work begins."""


class DoctorArguments(Arguments):
    """How the devices are examined."""

    home: bool = Field(default=False, description="Home stages that do not know their reference; look before.")


class OfDataset(Arguments):
    """A job on one dataset."""

    dataset: int = Field(ge=1, lt=2**63, description="Id of the dataset.")

    def check(self, store: Store) -> None:
        """Raise `NotInStore` where there is no such dataset."""
        store.entry(self.dataset)


class HowAsked(BaseModel):
    """What may be chosen of a fit."""

    model_config = ConfigDict(extra="forbid")

    model: str | None = Field(default=None, description=f"Only this: {', '.join(MODELS)}; null: all of a scan's end.")
    engine: Engine = "fast"
    distribution: Distribution = Field(default="ggx", description="Of the microfacets' normals.")
    weight: Weight = Field(default="none", description="How the cost weighs its terms.")
    conductor: str = Field(default="main/Al/Cheng", description="Metal of refractiveindex.info, shelf/book/page.")


class FitArguments(HowAsked, OfDataset):
    """Fit a dataset anew."""

    def check(self, store: Store) -> None:
        """Raise `InputError` for an unknown model, `UnknownConductor` for an unknown metal, and `NotInStore`."""
        super().check(store)
        if self.model is not None and self.model not in MODELS:
            raise InputError(f'There is no model "{self.model}"; there are {", ".join(MODELS)}.')
        load_conductor(*conductor_name(self.conductor))


class ExportOptions(BaseModel):
    """What a format lets one say; files are named by their uploads."""

    model_config = ConfigDict(extra="forbid")

    raw: bool = Field(default=False, description="With all raw exposures.")
    license: str | None = Field(default=None, max_length=100, description="SPDX identifier.", examples=["CC-BY-4.0"])
    creators: list[str] = Field(default=[], max_length=100, description='"Family, Given", or an organisation.')
    attached: list[str] = Field(default=[], max_length=100, description="Uploads of files that belong to the sample.")
    about: str | None = Field(default=None, description="Upload of a YAML file of what no database knows.")
    model: str | None = Field(default=None, max_length=40, description="Name of the fitted model.")
    budget: float = Field(default=Budget.error, ge=1e-4, le=1, description="Relative error of 99 of 100 directions.")
    colour_budget: float = Field(default=Budget.colour, ge=0.01, description="dE00 of 99 of 100 directions.")


class ExportAsked(BaseModel):
    """In which format a dataset leaves the house."""

    model_config = ConfigDict(extra="forbid")

    format: str = Field(description="One of those that GET /api/exports/formats lists.", examples=["hdf5"])
    options: ExportOptions = ExportOptions()


class ExportArguments(ExportAsked, OfDataset):
    """Write a dataset for others."""

    def check(self, store: Store) -> None:
        """Raise `InputError` for an unknown format or option, and `NotInStore`."""
        super().check(store)
        if self.format not in FORMATS:
            raise InputError(f'There is no format "{self.format}"; there are {", ".join(FORMATS)}.')
        known = FORMATS[self.format].uses
        if unknown := sorted(self.options.model_dump(exclude_defaults=True).keys() - set(known)):
            raise InputError(
                f"An export to {self.format} has no option {unknown[0]}; it has {', '.join(known) or 'none'}."
            )


class ReportArguments(OfDataset):
    """Write the report of a dataset."""


class ImportAsked(Arguments):
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


class RecalibrationAsked(BaseModel):
    """How raw data is calibrated anew."""

    model_config = ConfigDict(extra="forbid")

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

    def check(self, store: Store) -> None:
        """Raise `InputError` for an unknown correction, and `NotInStore`."""
        super().check(store)
        settings_of(self.without, self.also)
        if self.certificate is not None:
            known_certificate(store, self.certificate)


class TradeoffArguments(Arguments):
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

    def check(self, store: Store) -> None:
        """Raise `NotInStore` where there is no such dataset."""
        if self.dataset is not None:
            store.entry(self.dataset)


class StabilityArguments(Arguments):
    """Fit difficult measurements of known truth with every method."""

    regimes: list[str] = Field(default=[], description=f"Only these: {'; '.join(REGIMES)}.")
    methods: list[str] = Field(default=[], description=f"Only these: {'; '.join(METHODS)}.")
    runs: int = Field(default=5, ge=1, le=1000, description="Measurements of every cell of the map.")

    def check(self, store: Store) -> None:
        """Raise `InputError` for an unknown regime or method."""
        jobs(self.regimes, self.methods, 1)


class ChooseArguments(OfDataset):
    """The simplest model that a scene needs."""

    scene: str = Field(max_length=2_000_000, description="Text of a scene: YAML, or of Mitsuba (XML).")
    scene_format: Literal["yaml", "mitsuba"] = "yaml"
    tolerance: float = Field(default=1.0, ge=0.01, description="Largest mean dE00 in the scene.")
    dielectric: bool = Field(default=False, description="Take the ladder of a dielectric.")
    rendering: bool = Field(default=True, description="Verify by rendering, where Mitsuba is installed.")

    def check(self, store: Store) -> None:
        """Raise `InputError` for a scene of Mitsuba that reaches for files, and `NotInStore`."""
        super().check(store)
        if self.scene_format == "mitsuba":
            check_foreign_scene(self.scene)
