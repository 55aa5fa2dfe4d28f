"""What is to be measured, as checked, frozen data; `goniometer.campaigns.campaign_file` reads it from YAML or JSON.

A quantity is a number in the documented unit or a text with a unit, see `goniometer.campaigns.quantities`. The smallest
campaign that runs:

    name: First light
    samples:
      - {name: Sample 1, material: sample-1}
"""

import hashlib
import json
from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from goniometer.campaigns.conditions import Conditions
from goniometer.campaigns.material_file import material_file
from goniometer.campaigns.quantities import Angle, Duration, Length
from goniometer.campaigns.scene_weights import SceneWeights
from goniometer.geometry import LARGEST_ANGLE, Geometry
from goniometer.wording import check_name

Words = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
"""Text that says something."""
Name = Annotated[str, AfterValidator(check_name)]
"""How people call something."""

SMALLEST_STEP = 0.05
"""Degrees below which directions cannot be told apart, and a campaign would have no end."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Sample(_Model):
    """One thing to be measured."""

    name: Name = Field(min_length=1, description="How people call it; must differ between the samples of a campaign.")
    material: str = Field(
        min_length=1,
        description='What lies on the bench, e.g. "sample-1", or "file:NAME.npz" relative to the campaign file; only a '
        "simulated bench reads it.",
    )
    diameter: Length = Field(default=50.0, gt=0, description="Of the round sample, mm.")
    description: str = Field(default="", description="What it is, in words.")
    preparation: str = Field(default="", description="How its surface was made, in words.")
    repeats: int = Field(default=1, ge=1, le=1000, description="How often it is measured, each time as a whole.")
    wait: Duration = Field(default=0.0, ge=0, description="Before each of its scans, once it is mounted, seconds.")


class AngleSteps(_Model):
    """Evenly spaced angles, both ends included."""

    start: Angle = Field(ge=0, le=LARGEST_ANGLE, description="First angle, degrees.")
    stop: Angle = Field(ge=0, le=LARGEST_ANGLE, description="Last angle, degrees.")
    step: Angle = Field(ge=SMALLEST_STEP, description="Distance of two angles, degrees; must divide the range.")

    @model_validator(mode="after")
    def _divides(self) -> Self:
        steps = (self.stop - self.start) / self.step
        if steps < 0:
            raise ValueError(f"stop ({self.stop:g} deg) lies below start ({self.start:g} deg): exchange them")
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(f"a step of {self.step:g} deg does not divide {self.start:g} to {self.stop:g} deg")
        return self

    @property
    def angles(self) -> tuple[float, ...]:
        """All angles, degrees, ascending."""
        return tuple(self.start + i * self.step for i in range(round((self.stop - self.start) / self.step) + 1))


def _form_of_incident(value: object) -> str | None:
    if isinstance(value, dict | AngleSteps):
        return "steps"
    return "list" if isinstance(value, list | tuple) else None


Incident = Annotated[
    Annotated[AngleSteps, Tag("steps")] | Annotated[tuple[Angle, ...], Tag("list")],
    Discriminator(
        _form_of_incident,
        custom_error_type="incident_form",
        custom_error_message="give start, stop and step, or a list of angles",
    ),
]
"""Incident angles as a range or as a list; only the form that the user wrote is checked."""


class OutgoingRange(_Model):
    """The range of reflected directions, signed; the mirror direction of `theta_in` is `+theta_in`."""

    start: Angle = Field(default=-LARGEST_ANGLE, ge=-LARGEST_ANGLE, description="Lowest theta_out, degrees.")
    stop: Angle = Field(default=LARGEST_ANGLE, le=LARGEST_ANGLE, description="Highest theta_out, degrees.")

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if self.start >= self.stop:
            raise ValueError(f"start ({self.start:g} deg) must lie below stop ({self.stop:g} deg)")
        return self


class Resolution(_Model):
    """How finely the reflected directions are sampled, and when to stop: whatever comes first."""

    mode: Literal["dynamic", "uniform"] = Field(
        default="dynamic", description="Whether the plan finds the directions, or takes an even grid of `step`."
    )
    tolerance: float = Field(
        default=0.005,
        gt=0,
        allow_inf_nan=False,
        description="Wanted root mean square error of reading ln(1 + cos(theta_in) f) between the directions.",
    )
    colour_tolerance: float | None = Field(
        default=0.2,
        gt=0,
        allow_inf_nan=False,
        description="Wanted mean dE00 of reading a colour between them; none: colour does not matter.",
    )
    minimum_step: Angle = Field(
        default=0.2, ge=SMALLEST_STEP, le=45, description="Dynamic directions never lie closer than this, degrees."
    )
    step: Angle = Field(
        default=1.0, ge=SMALLEST_STEP, le=45, description="Distance of directions of the even grid, degrees."
    )
    scene: SceneWeights | None = Field(
        default=None,
        description="File of `goniometer choose --weights`: colour_tolerance is then the mean dE00 in this scene, and "
        "tolerance does not count.",
    )
    points: int | None = Field(default=None, ge=1, description="Most directions of a sample; none: no limit.")
    time: Duration | None = Field(default=None, gt=0, description="Most time for a sample, seconds; none: no limit.")

    @model_validator(mode="after")
    def _has_an_aim(self) -> Self:
        if self.scene is not None and (self.mode == "uniform" or self.colour_tolerance is None):
            raise ValueError("a scene needs dynamic resolution and a colour_tolerance")
        return self


class Integration(_Model):
    """How the integration time of a point is chosen."""

    minimum: Duration = Field(default=0.008, gt=0, description="Shortest integration time, seconds.")
    maximum: Duration = Field(default=30.0, gt=0, description="Longest integration time, seconds.")
    fill: float = Field(default=0.7, gt=0, le=0.95, description="Wanted brightest pixel, as a part of saturation.")
    scans: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="Spectra that are averaged at each point of a sample; without a signal_to_noise.",
    )
    signal_to_noise: float | None = Field(
        default=None,
        gt=0,
        allow_inf_nan=False,
        description="Wanted at each point of a sample in the median bin of 6 pixels between 380 and 995 nm; none: "
        "`scans` spectra of the longest fitting time.",
    )
    time_limit: Duration = Field(
        default=120.0, gt=0, description="Integration that a point may take to reach signal_to_noise, seconds."
    )
    exposures: int = Field(
        default=1,
        ge=1,
        le=3,
        description="Most integration times that are combined at a point: longer ones for what is dim in its spectrum.",
    )

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if self.minimum > self.maximum:
            raise ValueError(f"minimum ({self.minimum:g} s) must not exceed maximum ({self.maximum:g} s)")
        if self.minimum > self.time_limit:
            raise ValueError(f"minimum ({self.minimum:g} s) must not exceed time_limit ({self.time_limit:g} s)")
        return self


class Monitor(_Model):
    """How often one direction is looked at again, to see the lamp drift."""

    every: Duration = Field(default=600.0, gt=0, description="Time from one monitor exposure to the next, seconds.")


class Prescan(_Model):
    """How the arm sweeps over an incident angle before its first point, while the detector integrates.

    A reading is the average over the interval that the arm passed meanwhile. A lobe as narrow as the aperture is
    diluted in it as many times as the interval is wider than the lobe, and three points must find it in there, so an
    interval is at most 2 degrees wide.
    """

    step: Angle = Field(
        default=2.0, ge=0.5, le=2.0, description="Width of the interval of theta_out that a reading covers, degrees."
    )
    integration: Duration = Field(
        default=0.5, gt=0, description="Integration time of a reading, seconds; the arm moves at step / integration."
    )

    @property
    def velocity(self) -> float:
        """Of the arm, degrees/s."""
        return self.step / self.integration


class Homogeneity(_Model):
    """How a sample is measured again at another place, or turned by 90 degrees about its normal."""

    points: int = Field(default=5, ge=1, le=50, description="Directions that are measured again.")


class Override(_Model):
    """Who takes the responsibility for a certificate that is missing or not valid, and why."""

    name: Words = Field(description="Name of that person.")
    reason: Words = Field(description="Why, in words.")


class Reference(_Model):
    """How the reference panel is measured; its scan comes first."""

    every_round: bool = Field(
        default=False, description="Whether it is measured again at the start of each round, and serves that round."
    )
    certificate: str | None = Field(
        default=None,
        description="CSV file of the panel's certificate, relative to the campaign file; none: nominal values.",
    )
    override: Override | None = Field(
        default=None, description="Calibrate although the certificate is missing or not valid: name and reason."
    )
    diameter: Length = Field(default=50.0, gt=0, description="Of the round panel, mm.")
    step: Angle = Field(
        default=10.0, ge=SMALLEST_STEP, le=45, description="Distance of its reflected directions, degrees."
    )
    scans: int = Field(
        default=2, ge=1, le=1000, description="Spectra that are averaged at each point of the reference."
    )


class Campaign(_Model):
    """A series of scans with one instrument: the reference panel first, then each sample."""

    name: Name = Field(min_length=1, description="Name of the campaign; a database holds one campaign of a name.")
    seed: int = Field(default=0, ge=0, description="Seed of the simulated bench; a real bench has no use for it.")
    samples: tuple[Sample, ...] = Field(min_length=1, description="What to measure, in this order.")
    rounds: int = Field(default=1, ge=1, le=1000, description="How often the whole series of samples is measured.")
    incident: Incident = Field(
        default=AngleSteps(start=0, stop=80, step=10),
        description="Incident angles, degrees: start, stop and step, or a list.",
    )
    outgoing: OutgoingRange = Field(default=OutgoingRange(), description="Range of reflected directions.")
    resolution: Resolution = Field(default=Resolution(), description="How finely reflected directions are sampled.")
    prescan: Prescan | None = Field(
        default=None, description="Whether a sweep looks for lobes between the points first; null: not."
    )
    integration: Integration = Field(default=Integration(), description="How integration times are chosen.")
    reference: Reference = Field(default=Reference(), description="How the reference panel is measured.")
    stray_light: bool = Field(
        default=True, description="Whether stray light is measured, once per incident angle of every scan."
    )
    monitor: Monitor | None = Field(
        default=Monitor(), description="How often the lamp is looked at in every scan; null: never."
    )
    homogeneity: Homogeneity | None = Field(
        default=None, description="Whether every sample is measured again at another place; null: not."
    )
    conditions: Conditions = Field(default=Conditions(), description="What must hold before every scan.")

    @field_validator("samples")
    @classmethod
    def _named(cls, samples: tuple[Sample, ...]) -> tuple[Sample, ...]:
        names = [sample.name for sample in samples]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f'two samples are named "{name}": give each its own name')
        return samples

    @field_validator("incident")
    @classmethod
    def _possible(cls, incident: AngleSteps | tuple[float, ...]) -> AngleSteps | tuple[float, ...]:
        angles = incident.angles if isinstance(incident, AngleSteps) else incident
        if not angles:
            raise ValueError("the list of angles is empty: give at least one")
        for angle in angles:
            if not 0 <= angle <= LARGEST_ANGLE:
                raise ValueError(
                    f"{angle:g} deg is not possible: an incident angle must lie between 0 and {LARGEST_ANGLE:g} deg"
                )
        if len(set(angles)) < len(angles):
            raise ValueError("an angle is listed twice: leave one out")
        return incident

    @field_validator("outgoing")
    @classmethod
    def _measurable(cls, outgoing: OutgoingRange, info: ValidationInfo) -> OutgoingRange:
        incident = info.data.get("incident", ())  # absent where it is at fault itself
        for angle in incident.angles if isinstance(incident, AngleSteps) else incident:
            # The blocked directions are one interval, so that both ends speak for what lies between.
            if Geometry(angle, outgoing.start).blocked and Geometry(angle, outgoing.stop).blocked:
                raise ValueError(
                    f"the detector blocks the source in all of {outgoing.start:g} to {outgoing.stop:g} deg at the "
                    f"incident angle {angle:g} deg: widen the range, or leave this angle out"
                )
        return outgoing

    @field_validator("prescan")
    @classmethod
    def _has_use(cls, prescan: Prescan | None, info: ValidationInfo) -> Prescan | None:
        resolution = info.data.get("resolution")  # absent where it is at fault itself
        if prescan is not None and resolution is not None and resolution.mode == "uniform":
            raise ValueError("an even grid has no use for what it finds: leave it out, or make the resolution dynamic")
        return prescan

    @property
    def theta_in(self) -> tuple[float, ...]:
        """Incident angles, degrees, ascending."""
        angles = self.incident.angles if isinstance(self.incident, AngleSteps) else self.incident
        return tuple(sorted(angles))

    @property
    def series(self) -> tuple[tuple[str, Sample | None], ...]:
        """Name and sample of every measurement in its order; None stands for the reference panel."""
        panels = self.rounds if self.reference.every_round else 1
        seen: Counter[str] = Counter()
        found: list[tuple[str, Sample | None]] = []
        for number in range(1, self.rounds + 1):
            if number <= panels:
                found.append((numbered("reference", number if panels > 1 else None), None))
            for sample in self.samples:
                more = sample.repeats * self.rounds > 1
                for _ in range(sample.repeats):
                    seen[sample.name] += 1
                    found.append((numbered(sample.name, seen[sample.name] if more else None), sample))
        return tuple(found)

    @property
    def canonical_json(self) -> str:
        """The campaign as JSON with sorted keys, all defaults written out, quantities in degrees and seconds."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, ensure_ascii=False, separators=(",", ":"))

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides what is measured, so that nobody resumes under a changed campaign.

        The path of the certificate is left out: the database keeps, and compares, what stands in the file. So is that
        of a material, of which the SHA-256 counts once it is known, and who
        overrides what it says: that may be decided when everything is measured. Conditions and waits decide when
        something is measured and not what, so whoever was too impatient need not begin anew.
        """
        content = self.model_dump(mode="json")
        del content["reference"]["certificate"], content["reference"]["override"], content["conditions"]
        for sample in content["samples"]:
            del sample["wait"]
            file = material_file(sample["material"])
            if file is not None:
                sample["material"] = f"file:{file.identity}"
        # what is measured once has the hash that it had when nothing could be measured again
        for part, key in ((content, "rounds"), *((sample, "repeats") for sample in content["samples"])):
            if part[key] == 1:
                del part[key]
        if content["resolution"]["scene"] is None:
            del content["resolution"]["scene"]
        if not content["reference"]["every_round"]:
            del content["reference"]["every_round"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def changed_content(before: Campaign, after: Campaign) -> str:
    """What is another in a campaign that has begun, or in what its files hold, in words."""
    if before.hash == after.hash:
        return "another certificate"
    for old, new in zip(before.samples, after.samples, strict=False):
        was, now = material_file(old.material), material_file(new.material)
        if was and now and was.identity != now.identity:
            return f'another material file of the sample "{new.name}"'
    return "other content"


def numbered(name: str, repeat: int | None) -> str:
    """What the measurement `repeat` of `name`, counted from 1, is called; None where there is only one.

    >>> numbered("Sample 1", 2), numbered("Sample 1", None)
    ('Sample 1 #2', 'Sample 1')
    """
    return name if repeat is None else f"{name} #{repeat}"
