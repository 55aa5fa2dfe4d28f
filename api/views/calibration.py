"""Scans of the reference panel, and how the lamp drifted in them."""

from pydantic import Field

from api.results.certificates import sha256_of
from api.views.body import Body
from goniometer import look_up
from goniometer.drift import REFERENCE_WAVELENGTH, lamp_series
from goniometer.errors import CalibrationError
from goniometer.raw import read_raw
from goniometer.records import Scan
from goniometer.states import ExposureKind, Outcome, Phase
from goniometer.store import Store

_OF_THE_LAMP: tuple[ExposureKind, ...] = ("dark", "monitor")
"""What tells how the lamp drifted; a scan has a hundred times as many others."""


class Drift(Body):
    """What the looks at the lamp of one scan tell; the lists run over them."""

    seconds: list[float] = Field(description="Since the first one, on the clock of its session.")
    session: list[int] = Field(description="Number of the session of the bench; times of two cannot be compared.")
    level: list[float] = Field(description=f"Relative change of the lamp at {REFERENCE_WAVELENGTH:g} nm.")
    tilt: list[float] = Field(description="Relative change towards the blue; of a hotter lamp as large as the level.")


class Reference(Body):
    """A scan of the reference panel."""

    scan: int
    campaign_id: int
    campaign: str
    phase: Phase
    outcome: Outcome | None
    started: str | None = Field(description="ISO 8601, UTC.")
    finished: str | None
    points: int = Field(description="Directions that were measured.")
    certificate: str | None = Field(description="SHA-256 of the campaign's certificate; null: nominal values.")
    drift: Drift | None = Field(description="Null where the lamp was looked at less than twice.")
    drift_words: str = Field(description="Why there is no drift although the lamp was looked at; empty else.")


def reference_view(store: Store, scan: Scan) -> Reference:
    """A scan of the reference panel that has begun."""
    text = store.certificate(scan.campaign_id)
    drift, words = None, ""
    raw = read_raw(store, scan.id, _OF_THE_LAMP)
    try:
        series = lamp_series(raw)
    except CalibrationError as error:
        words = str(error)
    else:
        if series is not None:
            known = list(dict.fromkeys(series.sessions))
            drift = Drift(
                seconds=series.moments.tolist(),
                session=[known.index(each) for each in series.sessions],
                level=series.level.tolist(),
                tilt=series.tilt.tolist(),
            )
    return Reference(
        scan=scan.id,
        campaign_id=scan.campaign_id,
        campaign=look_up.campaign_row(store, scan.campaign_id).name,
        phase=scan.phase,
        outcome=scan.outcome,
        started=scan.started,
        finished=scan.finished,
        points=len(raw.read_back),
        certificate=None if text is None else sha256_of(text),
        drift=drift,
        drift_words=words,
    )
