"""What the bench is and does now, as frozen snapshots that anybody may keep, and what goes between the two processes.

The bench is driven in a process of its own (`api.bench.worker`), so that nothing that the web server does slows a scan
down.
"""

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.events import EventKind
from drivers.arrays import CountArray, FloatArray
from goniometer.geometry import BLOCKED_HALF_WIDTH
from goniometer.states import Kind, Phase

BenchPhase = Literal["disconnected", "connecting", "ready", "busy", "running", "stopping"]
"""What the bench is at: nothing open, opening, waiting for orders, doing one, measuring a campaign, being stopped."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


class StageView(_Model):
    """A rotation stage."""

    name: Literal["sample", "detector"]
    angle: float | None = Field(description="As read, degrees on the bench; null where it is not known.")
    phase: str = Field(description='What it does in its own words, as "ready"; "unknown" without an answer.')
    moving: bool
    limits: tuple[float, float] = Field(description="Where it may be sent, degrees.")


class Driver(_Model):
    """The service that drives the bench."""

    url: str = Field(description="Where it answers.")
    host: str
    process: int
    since: str = Field(description="ISO 8601, UTC.")
    here: bool = Field(description="Whether it is this one.")


class Prompt(_Model):
    """What a person is asked to lay on the bench before the scan goes on."""

    entry: int = Field(description="Of the queue.")
    scan: int
    sample: str = Field(description='Name of the scan; "reference" for the panel.')
    kind: Kind
    request: str = Field(description="What to do.", examples=["Mount Sample 1"])
    check: str = Field(description="How to see that it is right.")
    since: str = Field(description="ISO 8601, UTC.")


class Alarm(_Model):
    """Something that somebody must look at."""

    text: str
    since: str = Field(description="ISO 8601, UTC.")


class Span(_Model):
    """A time and between which limits it lies."""

    seconds: float
    low: float
    high: float


class Running(_Model):
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


class BenchState(_Model):
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


@dataclass(frozen=True)
class Snapshot:
    """The last spectrum that was read, as it is."""

    number: int
    """The device's own."""
    wavelengths: FloatArray
    """[pixels] nanometres."""
    counts: CountArray
    """[pixels] raw counts."""
    integration_time: float
    """Seconds."""
    saturation: int
    """Counts at and above which a pixel is saturated."""
    shutter: Literal["open", "closed", "unknown"]
    theta_in: float | None
    """Where the arm stood, degrees."""
    theta_out: float | None
    detector_temperature: float
    """Degrees Celsius."""
    moment: str
    """ISO 8601, UTC."""


@dataclass(frozen=True)
class Call:
    """A command for the process that drives the bench."""

    number: int
    name: str
    arguments: dict[str, Any]


@dataclass(frozen=True)
class Answer:
    """What came of a call: a value, or why not."""

    number: int
    value: Any = None
    refusal: tuple[str, str] | None = None
    """Kind and sentence of an error; see `api.bench.link`."""


@dataclass(frozen=True)
class Told:
    """An event for all listeners."""

    kind: EventKind
    data: dict[str, Any]


@dataclass(frozen=True)
class Doing:
    """How far a call is."""

    number: int
    share: float
    """0 to 1."""
    words: str
    """What is done next."""


Message = Doing | Answer | Told | BenchState | Snapshot
"""What the process that drives the bench says."""
