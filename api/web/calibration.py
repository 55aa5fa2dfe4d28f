"""What calibrates: certificates of white panels, scans of the reference, and what the bench knows of itself."""

import json
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Body, Path, Query

from api.bodies.base import Page
from api.bodies.calibration import CertificateRow, CertificateView, CharacterisationView, History, Reference
from api.bodies.jobs import JobView, RecalibrateArguments, RecalibrationAsked
from api.results.certificates import (
    Known,
    add_certificate,
    curve_of,
    is_valid,
    known_certificate,
    known_certificates,
    wavelengths_of,
)
from api.views.calibration import reference_view
from api.views.history import history
from api.web.access import Metrologist, Viewer
from api.web.context import Here, Number
from api.web.jobs import submit
from api.web.live import Live
from api.web.paging import After, after_number, etag, page
from goniometer.storage import look_up
from goniometer.storage.records import Scan

router = APIRouter(prefix="/api", tags=["calibration"])

_LARGEST = 4_000_000
_PAGE = 10


@router.get("/certificates")
def certificates(live: Here, caller: Viewer) -> list[CertificateRow]:
    """All certificates that were handed in, or used by a campaign or a dataset, newest first."""
    return [CertificateRow(**_row(known)) for known in known_certificates(live.store)]


@router.post("/certificates", status_code=201)
def hand_in(
    text: Annotated[str, Body(media_type="text/csv", max_length=_LARGEST, description="The CSV file.")],
    live: Here,
    caller: Metrologist,
    name: Annotated[str, Query(min_length=1, max_length=120, description="Of the file.", examples=["panel.csv"])],
) -> CertificateView:
    """Hand in a certificate; one that is known already stays as it is."""
    return _view(add_certificate(live.store, name, text, caller.name))


@router.get("/certificates/{sha256}")
def certificate(
    sha256: Annotated[str, Path(pattern="^[0-9a-f]{64}$", description="Of its text.")], live: Here, caller: Viewer
) -> CertificateView:
    """A certificate with what it certifies."""
    return _view(known_certificate(live.store, sha256))


@router.get("/references")
def references(live: Here, caller: Viewer, after: After = None) -> Page[Reference]:
    """Scans of the reference panel, newest first, with how the lamp drifted in each."""
    rows = look_up.begun_references(live.store, _PAGE + 1, None if after is None else after_number(after))
    return page(rows, _PAGE, lambda scan: _reference(live, scan), lambda scan: scan.id)


@router.get("/history")
def bench_history(
    live: Here,
    caller: Viewer,
    limit: Annotated[int, Query(ge=1, le=200, description="Most scans of the answer, the newest ones.")] = 60,
) -> History:
    """How the bench has changed from scan to scan: response to the panel, lamp, detector, wavelength scale."""
    return history(live.store, limit)


@router.get("/characterisations")
def characterisations(live: Here, caller: Viewer) -> list[CharacterisationView]:
    """What was measured of the bench itself, newest first."""
    return [
        CharacterisationView(
            id=each.id, kind=each.kind, created=each.created, bench=each.bench, content=json.loads(each.json)
        )
        for each in reversed(live.store.characterisations())
    ]


@router.post("/datasets/{number}/recalibrate", status_code=202)
def recalibrate(number: Number, asked: RecalibrationAsked, live: Here, caller: Metrologist) -> JobView:
    """Calibrate the raw data of a dataset anew; the older dataset stays."""
    return submit(live, caller, "recalibrate", RecalibrateArguments(dataset=number, **asked.model_dump()))


def _reference(live: Live, scan: Scan) -> Reference:
    """How a scan is shown; what was found out about one that has ended is remembered until it goes on."""
    if scan.phase != "finished":
        return reference_view(live.store, scan)
    tag = etag("reference", scan.id, scan.finished)
    content = live.datasets.answer(tag, lambda: reference_view(live.store, scan).model_dump_json().encode())
    return Reference.model_validate_json(content)


def _row(known: Known) -> dict[str, Any]:
    panel = known.panel
    return {
        "sha256": known.sha256,
        "name": known.name,
        "serial_number": panel.serial_number,
        "calibrated": None if panel.calibrated is None else panel.calibrated.isoformat(),
        "valid_until": None if panel.valid_until is None else panel.valid_until.isoformat(),
        "valid_today": is_valid(panel, datetime.now(UTC).date()),
        "wavelengths_nm": wavelengths_of(panel),
        "kind": "brdf" if curve_of(panel) is None else "reflectance",
        "who": known.who,
        "created": known.created,
    }


def _view(known: Known) -> CertificateView:
    wavelengths, values, u = curve_of(known.panel) or ([], [], [])
    return CertificateView(
        **_row(known), text=known.text, wavelength_nm=wavelengths, reflectance=values, u_reflectance=u
    )
