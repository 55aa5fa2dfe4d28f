"""Campaigns and the queue in which they wait."""

from typing import Any, Literal

from pydantic import AwareDatetime, Field

from api.bodies.base import Asked, Body
from api.bodies.bench import Prompt, Span
from api.bodies.scans import ScanView
from goniometer.states import Kind, Outcome


class Verdict(Body):
    """Whether a campaign can be measured."""

    name: str
    hash: str = Field(description="SHA-256 of what decides what is measured.")
    findings: list[str] = Field(description="Why it would be refused, as sentences; empty where it would not.")


class Direction(Body):
    """Where the arm goes."""

    theta_in: float = Field(description="Degrees.")
    theta_out: float = Field(description="Degrees.")
    sample: float = Field(description="Angle of the sample stage, degrees.")
    detector: float = Field(description="Angle of the detector stage, degrees.")


class LegView(Body):
    """One scan as far as it is known beforehand."""

    name: str
    points: int = Field(description="Directions that are certain.")
    most_points: int = Field(description="Directions that there may be in the end.")
    sample_travel: float = Field(description="Degrees that the sample stage turns between those that are certain.")
    detector_travel: float
    time: Span
    waiting: float = Field(description="Least time for which it waits before it measures, seconds.")


class BlockedRange(Body):
    """Reflected directions at which the detector would stand in the beam; they are filled, not measured."""

    theta_in: float = Field(description="Degrees.")
    low: float = Field(description="theta_out, degrees.")
    high: float = Field(description="theta_out, degrees.")


class PreviewView(Body):
    """What a campaign will do."""

    campaign: str
    legs: list[LegView]
    time: Span = Field(description="Of the whole campaign.")
    points: list[Direction] = Field(description="The certain directions of a sample, in the order of the way.")
    reference_points: list[Direction] = Field(description="The directions of the reference panel.")
    blocked: list[BlockedRange]
    uniform_1_degree_points: int = Field(description="Points that an even grid of 1 degree would have, per sample.")
    lines: list[str] = Field(description="All of it as sentences.")
    findings: list[str] = Field(description="Why it would be refused, as sentences; empty where it would not.")


class CampaignView(Body):
    """A campaign that was begun."""

    id: int
    name: str
    hash: str = Field(description="SHA-256 of what decides what is measured.")
    created: str = Field(description="ISO 8601, UTC.")
    bench: str = Field(description="Name of the bench on which it is measured.")


class CampaignDetail(CampaignView):
    """A campaign that was begun, with all of it."""

    campaign: dict[str, Any] = Field(description="What it asks for, all defaults written out.")
    scans: list[ScanView]


EntryPhase = Literal["idle", "queued", "running", "pausing", "paused", "aborting", "fitting", "finished"]
"""As in the database, and what the scan that is measured does; "fitting": all is measured, and the bench is free."""


class EntryScan(Body):
    """A scan of a campaign, as far as it is."""

    id: int
    name: str
    kind: Kind
    phase: str
    outcome: Outcome | None
    points_done: int


class EntryView(Body):
    """A campaign in the queue."""

    id: int
    position: int = Field(description="Place in the queue, counted from 1; 0 once it is finished.")
    campaign: str = Field(description="Its name.")
    campaign_id: int | None = Field(description="In the database; null until it was begun.")
    phase: EntryPhase
    outcome: Outcome | None = Field(description="How it ended; null while it has not.")
    reason: str = Field(description="Why it ended so, why it waits, or why it is idle again; a sentence, or empty.")
    who: str = Field(description="Who ordered it.")
    start_after: str | None = Field(description="It does not begin before, ISO 8601, UTC.")
    created: str = Field(description="ISO 8601, UTC.")
    started: str | None = Field(description="ISO 8601, UTC.")
    finished: str | None = Field(description="ISO 8601, UTC.")
    scans: list[EntryScan] = Field(description="In the order in which they are run; none until it was begun.")
    scan: int | None = Field(description="Id of the scan that is measured now.")
    points_done: int
    points_expected: int | None = Field(
        description="Of all its scans, as far as the plan can tell; null once finished."
    )
    remaining: Span | None = Field(description="Bench time to go, seconds; null once finished.")
    pause_takes_effect: str | None = Field(
        description="When a pause takes effect, in words; null where there is nothing to pause.",
        examples=["after this point, about 4 s"],
    )
    prompt: Prompt | None = Field(description="What somebody must mount before it goes on.")


class Order(Asked):
    """A campaign that is to be measured."""

    campaign: str | dict[str, Any] = Field(
        description="As YAML text, or as an object, as docs/campaign.yaml explains it.",
        examples=[{"name": "First light", "samples": [{"name": "Sample 1", "material": "sample-1"}]}],
    )
    start_after: AwareDatetime | None = Field(
        default=None, description="It is started now, and begins in its turn once this moment has come."
    )


class Place(Asked):
    """Where an entry shall stand."""

    position: int = Field(ge=1, le=1_000_000, description="Counted from 1; beyond the end is the end.")


class Mounted(Asked):
    """What lies on the bench now."""

    scan: int | None = Field(
        default=None, ge=1, lt=2**63, description="Of the prompt that is answered; null: whichever."
    )
