"""Fits of a dataset, and files that are written from it for others."""

import hashlib
from pathlib import Path

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse

from api.bodies.fits import ExportView, FitRow, FormatView
from api.bodies.jobs import ExportArguments, ExportAsked, FitArguments, HowAsked, JobView, ReportArguments
from api.choices import WRITTEN
from api.errors import Conflict
from api.exports.formats import FORMATS
from api.views.ladder import fit_row
from api.web.access import Operator, Viewer
from api.web.context import Here, Number
from api.web.jobs import submit
from goniometer.errors import NotInStore
from goniometer.storage.derived import ExportRow

router = APIRouter(prefix="/api", tags=["fits and exports"])


@router.get("/datasets/{number}/fits")
def fits(number: Number, live: Here, caller: Viewer) -> list[FitRow]:
    """All fits of a dataset, oldest first; a newer one replaces none."""
    live.store.entry(number)
    return [fit_row(each) for each in live.store.fits(number)]


@router.post("/datasets/{number}/fits", status_code=202)
def fit(number: Number, asked: HowAsked, live: Here, caller: Operator) -> JobView:
    """Fit a dataset anew; the result is what `goniometer fit --json` prints."""
    return submit(live, caller, "fit", FitArguments(dataset=number, **asked.model_dump()))


@router.get("/fits/{number}", responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}})
def one_fit(number: Number, live: Here, caller: Viewer) -> Response:
    """A fit as JSON, which reloads bit for bit; null is NaN, "inf" and "-inf" are infinities."""
    headers = {"Cache-Control": "private, max-age=31536000, immutable"}
    return Response(live.store.fit(number).text, media_type="application/json", headers=headers)


@router.get("/exports/formats")
def formats(caller: Viewer) -> list[FormatView]:
    """All formats of exports."""
    return [
        FormatView(name=name, about=WRITTEN[name], ending=each.ending, options=list(each.uses))
        for name, each in FORMATS.items()
    ]


@router.get("/datasets/{number}/exports")
def exports(number: Number, live: Here, caller: Viewer) -> list[ExportView]:
    """All files that were written from a dataset, oldest first."""
    live.store.entry(number)
    return [_view(each) for each in live.store.export_rows(number)]


@router.post("/datasets/{number}/exports", status_code=202)
def export(number: Number, asked: ExportAsked, live: Here, caller: Operator) -> JobView:
    """Write a dataset in a format for others; the result names the export."""
    return submit(live, caller, "export", ExportArguments(dataset=number, **asked.model_dump()))


@router.post("/datasets/{number}/report", status_code=202)
def report(number: Number, live: Here, caller: Operator) -> JobView:
    """Write the report of a dataset, which is then the page of the job, too."""
    return submit(live, caller, "report", ReportArguments(dataset=number))


@router.get("/exports/{number}/file", response_class=FileResponse)
def file(number: Number, live: Here, caller: Viewer) -> Response:
    """The file of an export, as it was written."""
    row = live.store.export(number)
    path = Path(row.path)
    if not path.is_file():
        raise NotInStore(f"The file of export {number} is no longer at {path}; export the dataset again")
    with path.open("rb") as content:
        if hashlib.file_digest(content, "sha256").hexdigest() != row.sha256:
            raise Conflict(f"{path} is not what export {number} wrote any more; export the dataset again")
    # nothing that was written is ever run in the name of this service
    headers = {"X-Content-Type-Options": "nosniff", "Content-Security-Policy": "sandbox", "ETag": f'"{row.sha256}"'}
    return FileResponse(path, media_type="application/octet-stream", filename=path.name, headers=headers)


def _view(row: ExportRow) -> ExportView:
    path = Path(row.path)
    return ExportView(
        id=row.id,
        dataset=row.dataset_id,
        format=row.format,
        file=path.name,
        sha256=row.sha256,
        created=row.created,
        available=path.is_file(),
    )
