"""What was measured: scans, their points, and the raw spectra."""

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response

from api.bodies.base import Page
from api.bodies.scans import ExposureView, NewestBrdf, PointDetail, PointView, ScanView
from api.web.access import Viewer
from api.web.answers import Shared
from api.web.context import Here, Number
from api.web.instrument import BINARY
from api.web.live import Live
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, etag, page, unchanged
from goniometer.storage import look_up
from goniometer.storage.look_up import NONE, Counts
from goniometer.storage.records import Exposure, Point, Scan

router = APIRouter(prefix="/api", tags=["scans"])


@router.get("/scans", response_model=Page[ScanView])
async def scans(
    request: Request,
    live: Here,
    answers: Shared,
    caller: Viewer,
    campaign: Annotated[int | None, Query(ge=1, lt=2**63, description="Only those of this campaign.")] = None,
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
) -> Response:
    """Scans in the order in which they are run, campaign by campaign."""
    return await answers.of(request, lambda: _scans(live, campaign, after, limit))


@router.get("/scans/{number}")
def scan(live: Here, caller: Viewer, number: Number) -> ScanView:
    """One scan."""
    return scan_views(live, [live.store.scan(number)])[0]


@router.get("/scans/{number}/points", response_model=Page[PointView])
async def points(
    request: Request,
    live: Here,
    answers: Shared,
    caller: Viewer,
    number: Number,
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
) -> Response:
    """The points of a scan, in the order in which the plan asked for them."""
    return await answers.of(request, lambda: _points(live, number, after, limit))


@router.get("/scans/{number}/brdf")
def newest_brdf(live: Here, caller: Viewer, number: Number) -> NewestBrdf:
    """The BRDF of the point that was measured last, provisional: the scan is not complete yet.

    It is calibrated as the scan will be, by what was measured so far. It is refused where nothing was, and for the
    scan of the reference panel.
    """
    return live.newest.of(number)


@router.get("/points/{number}")
def point(live: Here, caller: Viewer, number: Number) -> PointDetail:
    """One point, and the ids of its exposures."""
    found = look_up.point(live.store, number)
    return PointDetail(**_point(found).model_dump(), exposures=look_up.exposures_of(live.store, number))


@router.get(
    "/exposures/{number}",
    responses={
        200: {"model": ExposureView, "content": {BINARY: {"schema": {"type": "string"}}}},
        304: {"description": "It is as it was."},
    },
    response_class=Response,
)
def exposure(
    request: Request,
    response: Response,
    live: Here,
    caller: Viewer,
    number: Number,
    accept: Annotated[str, Header(include_in_schema=False)] = "",
) -> Response:
    """A raw spectrum, which never changes; as octets, it is the counts as little-endian float64."""
    binary = BINARY in accept
    scan_id, found = look_up.exposure(live.store, number)
    same = unchanged(request, response, etag("exposure", number, found.taken, binary))
    if same is not None:
        return same
    headers = {"ETag": response.headers["ETag"], "Cache-Control": "private, max-age=31536000, immutable"}
    headers["Vary"] = "Accept"
    if binary:
        return Response(found.counts.astype("<f8").tobytes(), media_type=BINARY, headers=headers)
    content = _exposure(scan_id, found).model_dump_json()
    return Response(content, media_type="application/json", headers=headers)


def scan_views(live: Live, rows: list[Scan]) -> list[ScanView]:
    """Scans as they are shown."""
    ids = [row.id for row in rows]
    counts, made = look_up.point_counts(live.store, ids), look_up.datasets_of(live.store, ids)
    return [_scan(row, counts.get(row.id, NONE), made.get(row.id, [])) for row in rows]


def _scans(live: Live, campaign: int | None, after: str | None, limit: int) -> Page[ScanView]:
    rows = look_up.scans_after(live.store, after_number(after), limit + 1, campaign)
    views = {view.id: view for view in scan_views(live, rows)}
    return page(rows, limit, lambda scan: views[scan.id], lambda scan: scan.id)


def _points(live: Live, number: int, after: str | None, limit: int) -> Page[PointView]:
    live.store.scan(number)
    rows = look_up.points_after(live.store, number, after_number(after, -1), limit + 1)
    return page(rows, limit, _point, lambda point: point.number)


def _scan(row: Scan, counts: Counts, datasets: list[int]) -> ScanView:
    return ScanView(
        id=row.id,
        campaign=row.campaign_id,
        number=row.number,
        kind=row.kind,
        name=row.name,
        sample=row.sample,
        material=row.material,
        phase=row.phase,
        outcome=row.outcome,
        reason=row.reason,
        command=row.command,
        started=row.started,
        finished=row.finished,
        points_done=counts.done,
        points_failed=counts.failed,
        points_expected=row.expected_points if row.phase != "finished" or row.outcome != "completed" else counts.done,
        remaining=None if row.remaining is None else row.remaining.seconds,
        datasets=datasets,
    )


def _point(row: Point) -> PointView:
    read = row.read_back
    return PointView(
        id=row.id,
        scan=row.scan_id,
        number=row.number,
        theta_in=row.geometry.theta_in,
        theta_out=row.geometry.theta_out,
        read_theta_in=None if read is None else read.theta_in,
        read_theta_out=None if read is None else read.theta_out,
        status=row.status,
        attempts=row.attempts,
        reason=row.reason,
        seconds=row.seconds,
        signal_to_noise=row.signal_to_noise,
    )


def _exposure(scan_id: int, row: Exposure) -> ExposureView:
    return ExposureView(
        id=row.id,
        scan=scan_id,
        point=row.point_id,
        kind=row.kind,
        theta_in=None if row.geometry is None else row.geometry.theta_in,
        theta_out=None if row.geometry is None else row.geometry.theta_out,
        integration_time=row.integration_time,
        detector_temperature=row.detector_temperature,
        taken=row.taken,
        counts=row.counts.tolist(),
    )
