"""What the bench is and does now, and what operators let it do."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from api.bodies.base import Asked, Body
from goniometer.geometry import BLOCKED_HALF_WIDTH
from goniometer.states import Kind, Phase

BenchPhase = Literal["disconnected", "connecting", "ready", "busy", "running", "stopping"]
"""What the bench is at: nothing open, opening, waiting for orders, doing one, measuring a campaign, being stopped."""


class StageView(Body):
    """A rotation stage."""

    name: Literal["sample", "detector"]
    angle: float | None = Field(description="As read, degrees on the bench; null where it is not known.")
    phase: str = Field(description='What it does in its own words, as "ready"; "unknown" without an answer.')
    moving: bool
    limits: tuple[float, float] = Field(description="Where it may be sent, degrees.")


class Driver(Body):
    """The service that drives the bench."""

    url: str = Field(description="Where it answers.")
    host: str
    process: int
    since: str = Field(description="ISO 8601, UTC.")
    here: bool = Field(description="Whether it is this one.")


class Prompt(Body):
    """What a person is asked to lay on the bench before the scan goes on."""

    entry: int = Field(description="Of the queue.")
    scan: int
    sample: str = Field(description='Name of the scan; "reference" for the panel.')
    kind: Kind
    request: str = Field(description="What to do.", examples=["Mount Sample 1"])
    check: str = Field(description="How to see that it is right.")
    since: str = Field(description="ISO 8601, UTC.")


class Alarm(Body):
    """Something that somebody must look at."""

    text: str
    since: str = Field(description="ISO 8601, UTC.")


class Span(Body):
    """A time and between which limits it lies."""

    seconds: float
    low: float
    high: float


class Running(Body):
    """The scan that is measured now."""

    entry: int = Field(description="Of the queue.")
    campaign: str
    scan: int
    sample: str = Field(description='Name of the scan; "reference" for the panel.')
    kind: Kind
    phase: Phase
    done: int = Field(description="Points that are finished, failed and skipped ones included.")
    failed: int
    expected: int = Field(description="Points that there will be, as far as the plan can tell.")
    theta_in: float | None = Field(description="Of the point that is measured now, degrees.")
    theta_out: float | None = Field(description="Of the point that is measured now, degrees.")
    bench_elapsed: float = Field(description="Bench time of the finished points, seconds.")
    bench_remaining: Span = Field(description="Bench time to go.")
    remaining: float | None = Field(description="Real time to go, seconds; null until a point is done.")
    waiting: str | None = Field(description="What it waits for instead of measuring.")


class BenchState(Body):
    """The whole bench."""

    name: str = Field(description="Tells it from other benches on the same database.")
    phase: BenchPhase
    doing: str = Field(description="In words, what it does or why it does nothing.")
    possible: tuple[str, ...] = Field(description="Commands that are obeyed now.")
    driver: Driver | None = Field(description="Who drives the bench; null where nobody does.")
    simulated: bool
    stages: tuple[StageView, ...] = Field(description="Sample and detector stage; none while nothing is connected.")
    theta_in: float | None = Field(description="Where the arm stands, degrees.")
    theta_out: float | None = Field(description="Where the arm stands, degrees.")
    blocked_half_width: float = Field(
        default=BLOCKED_HALF_WIDTH, description="Degrees beside the source axis where the detector is in the beam."
    )
    detector_temperature: float | None = Field(description="As last read, degrees Celsius.")
    cooler_set_point: float = Field(description="Degrees Celsius.")
    lamp_on_for: float | None = Field(
        description="Seconds for which the lamp has been on for all that is known; null where it was not switched on."
    )
    shutter: Literal["open", "closed", "unknown"]
    integration_time: float | None = Field(description="Of the last spectrum, seconds.")
    integration_limits: tuple[float, float] | None = Field(description="Shortest and longest possible, seconds.")
    spectrum: int | None = Field(description="The device's running number of the last spectrum.")
    running: Running | None = Field(description="The scan that is measured now.")
    prompt: Prompt | None = Field(description="What somebody must mount before it goes on.")
    alarms: tuple[Alarm, ...]


Angle = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]


class Jog(Asked):
    """Where to turn the stages: each by its own angle, or the arm by directions."""

    sample: Angle | None = Field(default=None, description="Of the sample stage, degrees; null leaves it.")
    detector: Angle | None = Field(
        default=None, description="Of the detector stage from the source axis, degrees; null leaves it."
    )
    theta_in: Angle | None = Field(default=None, description="Incident angle, degrees; needs theta_out.", examples=[30])
    theta_out: Angle | None = Field(default=None, description="Reflected angle, degrees, signed.", examples=[-10])

    @model_validator(mode="after")
    def _is_one_of_both(self) -> "Jog":
        stages = self.sample is not None or self.detector is not None
        if (self.theta_in is None) != (self.theta_out is None):
            raise ValueError("theta_in and theta_out belong together: give both")
        if stages == (self.theta_in is not None):
            raise ValueError("give sample or detector, or theta_in and theta_out")
        return self

    @property
    def standing(self) -> tuple[float | None, float | None]:
        """Angles of the sample and the detector stage, degrees."""
        if self.theta_in is None or self.theta_out is None:
            return self.sample, self.detector
        return self.theta_in, self.theta_in + self.theta_out


class Expose(Asked):
    """A spectrum that is shown and not kept."""

    integration_time: float = Field(gt=0, le=3600, allow_inf_nan=False, description="Seconds.", examples=[0.1])
    dark: bool = Field(default=False, description="Whether the shutter is closed.")


class Spectrum(Body):
    """The last spectrum that was read."""

    number: int = Field(description="The device's running number.")
    wavelengths: list[float] = Field(description="[pixels] nanometres.")
    counts: list[int] = Field(description="[pixels] raw counts.")
    integration_time: float = Field(description="Seconds.")
    saturation: int = Field(description="Counts at and above which a pixel is saturated.")
    shutter: Literal["open", "closed", "unknown"]
    theta_in: float | None = Field(description="Where the arm stood, degrees.")
    theta_out: float | None
    detector_temperature: float = Field(description="Degrees Celsius.")
    moment: str = Field(description="ISO 8601, UTC.")


class Moment(Body):
    """What was read of the bench at some moment."""

    moment: str = Field(description="ISO 8601, UTC.")
    detector_temperature: float | None = Field(description="Degrees Celsius.")
    lamp_on_for: float | None = Field(description="Seconds.")
