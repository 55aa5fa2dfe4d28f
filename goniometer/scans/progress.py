"""How far a scan has come, as a frozen snapshot that anybody may keep."""

from dataclasses import dataclass
from typing import Literal

from goniometer.geometry import Geometry
from goniometer.states import Kind, Outcome
from goniometer.storage.records import Expected

ToldPhase = Literal["running", "paused", "finished"]
"""The phases that a scan tells of itself; what it was asked for meanwhile stands in the database."""


@dataclass(frozen=True)
class Waiting:
    """What a scan waits for instead of measuring."""

    what: str
    """In words, as "warming the lamp"."""
    left: float | None
    """Seconds of bench time to go; None where nobody knows."""


@dataclass(frozen=True)
class Progress:
    """A snapshot of a running scan."""

    scan_id: int
    sample: str
    """Name of the scan: that of its sample, with the number of the repeat, or "reference"."""
    kind: Kind
    phase: ToldPhase
    geometry: Geometry | None
    """The direction that is measured now, or was measured just now; None before the first and while it waits."""
    done: int
    """Points that are finished, the failed and skipped ones included."""
    failed: int
    """Points that could not be measured."""
    expected: int
    """Points that there will be, as far as the plan can tell: it grows or shrinks while the plan learns."""
    bench_elapsed: float
    """Seconds of bench time spent on finished points, in all runs of this scan."""
    bench_remaining: Expected
    """Bench time to go."""
    elapsed: float
    """Seconds of real time since this run of the scan began; once it measures, since it began to."""
    remaining: float | None
    """Seconds of real time to go; None until this run has done a point."""
    dead_time: float | None
    """Seconds at a point beyond moves and integration, as measured; None until a few points are done."""
    waiting: Waiting | None = None
    """None while it measures."""
    outcome: Outcome | None = None
    """How it ended; None while it has not. Why stands in the database."""

    @property
    def fraction(self) -> float:
        """Part of the expected points that is done, 0 to 1."""
        return min(self.done / self.expected, 1.0) if self.expected else 0.0
