"""Scans, their points and the raw spectra."""

from pydantic import Field

from api.bodies.base import Body, Number
from goniometer.states import Command, ExposureKind, Kind, Outcome, Phase, Status


class ScanView(Body):
    """One thing measured from end to end."""

    id: int
    campaign: int = Field(description="Id of the campaign.")
    number: int = Field(description="Place in the campaign; the first reference scan is 0.")
    kind: Kind
    name: str = Field(description="Its sample, with the number of the repeat where there are several.")
    sample: str
    material: str
    phase: Phase
    outcome: Outcome | None = Field(description="How it ended; null while it has not.")
    reason: str = Field(description="Why it ended so, or why it waits; a sentence, or empty.")
    command: Command | None = Field(description="What was asked for and is not taken up yet.")
    started: str | None = Field(description="ISO 8601, UTC.")
    finished: str | None = Field(description="ISO 8601, UTC.")
    points_done: int
    points_failed: int
    points_expected: int | None = Field(description="Points in the end, as foreseen; null where nobody knows yet.")
    remaining: float | None = Field(description="Bench time to go, as foreseen at its last point, seconds.")
    datasets: list[int] = Field(description="Ids of what was made from it.")


class PointView(Body):
    """One direction of a scan."""

    id: int
    scan: int
    number: int = Field(description="Order in which the plan asked for it.")
    theta_in: float = Field(description="As planned, degrees.")
    theta_out: float = Field(description="As planned, degrees.")
    read_theta_in: float | None = Field(description="As the stages read it back, degrees.")
    read_theta_out: float | None
    status: Status
    attempts: int
    reason: str = Field(description="Why it failed or was skipped, or what is less than was wanted.")
    seconds: float = Field(description="Bench time that it took.")
    signal_to_noise: float | None


class PointDetail(PointView):
    """One direction of a scan, with its raw spectra."""

    exposures: list[int] = Field(description="Ids of its exposures.")


class ExposureView(Body):
    """One raw spectrum."""

    id: int
    scan: int
    point: int | None = Field(description="Id of its point; null for all but light.")
    kind: ExposureKind
    theta_in: float | None = Field(description="Where the stages stood, degrees; null for a dark.")
    theta_out: float | None
    integration_time: float = Field(description="Seconds.")
    detector_temperature: float = Field(description="Degrees Celsius.")
    taken: str = Field(description="ISO 8601, UTC.")
    counts: list[int] = Field(description="[pixels] raw counts.")


class NewestBrdf(Body):
    """The BRDF of the point of a scan that was measured last, before its scan is complete."""

    scan: int
    sample: str = Field(description="Name of the scan.")
    point: int = Field(description="Id of the measured point.")
    theta_in_deg: float = Field(description="As read back.")
    theta_out_deg: float = Field(description="As read back.")
    wavelengths_nm: list[float]
    brdf: list[Number] = Field(description="[wavelengths] 1/sr; null where there is no value.")
    u: list[Number] = Field(description="[wavelengths] combined standard uncertainty (k = 1) of all `parts`, 1/sr.")
    parts: list[str] = Field(description="Of the budget, that are in `u`.", examples=[["random", "dark", "reference"]])
    neighbours: int = Field(
        description="Points beside it from which the slope comes by which errors of the angles count; 0: without them."
    )
    flag_words: str = Field(description="What is doubtful about the point; empty where nothing is.")
