"""Scans of the reference panel, and how the lamp drifted in them."""

from api.bodies.calibration import Drift, Reference
from api.results.certificates import sha256_of
from goniometer.errors import CalibrationError
from goniometer.radiometry.drift import lamp_series
from goniometer.radiometry.raw import read_raw
from goniometer.states import ExposureKind
from goniometer.storage import look_up
from goniometer.storage.records import Scan
from goniometer.storage.store import Store

_OF_THE_LAMP: tuple[ExposureKind, ...] = ("dark", "monitor")
"""What tells how the lamp drifted; a scan has a hundred times as many others."""


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
