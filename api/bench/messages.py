"""What goes between a service and the process that drives its bench.

The bench is driven in a process of its own (`api.bench.worker`), so that nothing that the web server does slows a scan
down.
"""

from dataclasses import dataclass
from typing import Any, Literal

from api.bodies.bench import BenchState
from api.bodies.events import AnyData, EventKind
from drivers.arrays import CountArray, FloatArray


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
class Done:
    """A call was obeyed."""

    number: int
    value: Any
    """What the command of that name gives; None of most."""


@dataclass(frozen=True)
class Refusal:
    """A call was not obeyed."""

    number: int
    kind: str
    """Name of the error; see `api.named_errors`."""
    message: str


@dataclass(frozen=True)
class Told:
    """An event for all listeners."""

    kind: EventKind
    data: AnyData
    """What `api.bodies.events.EventData` says of that kind."""


@dataclass(frozen=True)
class Doing:
    """How far a call is."""

    number: int
    share: float
    """0 to 1."""
    words: str
    """What is done next."""


Answer = Done | Refusal
"""What came of a call."""

Message = Doing | Answer | Told | BenchState | Snapshot
"""What the process that drives the bench says."""
