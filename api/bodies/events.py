"""What events of the service tell: `EventData` has the shape of every kind."""

from functools import cache
from typing import Any, Literal

from pydantic import Field, TypeAdapter

from api.bodies.base import Body
from api.bodies.bench import BenchState, Prompt, Running
from api.bodies.jobs import JobView

EventKind = Literal["state", "progress", "point", "spectrum", "queue", "mount", "job", "alarm", "log", "reset"]
"""What an event is about; "reset" says that some were missed."""


class PointDone(Body):
    """A point of a scan is over: it is measured, or it failed and is left out."""

    scan: int = Field(description="Id of the scan.")
    theta_in: float = Field(description="As planned, degrees.")
    theta_out: float = Field(description="As planned, degrees, signed.")
    done: int = Field(description="Points of the scan that are finished, failed and skipped ones included.")
    failed: int = Field(description="Those of them that were not measured.")
    expected: int = Field(description="Points that there will be, as far as the plan can tell.")


class SpectrumRead(Body):
    """A spectrum was read; GET /api/instrument/spectrum gives the last one."""

    number: int = Field(description="The device's running number.")
    integration_time: float = Field(description="Seconds.")
    brightest: int = Field(description="Raw counts of the brightest pixel.")
    saturation: int = Field(description="Counts at and above which a pixel is saturated.")
    shutter: Literal["open", "closed", "unknown"]


class EntryChanged(Body):
    """An entry of the queue has changed, or the queue while that entry runs; GET /api/queue tells how it is now."""

    entry: int = Field(description="Of the queue; it may be gone.")


class QueueChanged(Body):
    """The queue has changed, and nothing runs; GET /api/queue tells how it is now."""


class PromptGone(Body):
    """Nobody is asked for a sample any more: it is mounted, or its campaign does not go on."""

    entry: int = Field(description="Of the queue.")
    scan: int
    request: None = Field(description="Null, which tells it from a prompt.")


class Notice(Body):
    """A message of the devices, of a scan or of its fits."""

    level: str = Field(description='"info", "warning", "error" or "critical".')
    message: str
    moment: str = Field(description="ISO 8601, UTC.")


class Reset(Body):
    """Events were missed: read everything anew."""


class EventData(Body):
    """What an event tells, by its kind: the data of one of the kind "point" are what `point` is here.

    Every event brings one of them; they are never sent together.
    """

    state: BenchState = Field(description="What the bench is and does now, whenever that changes.")
    progress: Running = Field(description="How far the scan is that is measured now, at most ten times a second.")
    point: PointDone = Field(description="A point of the scan is over.")
    spectrum: SpectrumRead = Field(description="A spectrum was read; of several at once the last one is told.")
    queue: EntryChanged | QueueChanged = Field(description="The queue has changed, or a campaign in it.")
    mount: Prompt | PromptGone = Field(description="A sample is to be mounted, or is not any more.")
    job: JobView = Field(description="A job was ordered, or has gone on or ended.")
    alarm: Notice = Field(description="Something went wrong that somebody must look at.")
    log: Notice = Field(description="Something that is good to know: a warning, or how far fits are.")
    reset: Reset = Field(description="Events were missed: read everything anew.")


AnyData = (
    BenchState
    | Running
    | PointDone
    | SpectrumRead
    | EntryChanged
    | QueueChanged
    | Prompt
    | PromptGone
    | JobView
    | Notice
    | Reset
)
"""What some event tells."""


def read_data(kind: EventKind, text: str) -> AnyData:
    """What the JSON of an event of that kind tells; raises pydantic's `ValidationError`."""
    return _reader(kind).validate_json(text)


@cache
def _reader(kind: EventKind) -> TypeAdapter[AnyData]:
    models: Any = EventData.model_fields[kind].annotation
    return TypeAdapter(models)
