"""Campaigns: whether they can be measured, what they will do, and what has become of them."""

import json
from typing import Any

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool

from api.bodies.base import Page
from api.bodies.bench import Span
from api.bodies.campaigns import BlockedRange, CampaignDetail, CampaignView, Direction, LegView, PreviewView, Verdict
from api.preflight import preflight
from api.preview import preview as preview_of
from api.web.access import Viewer
from api.web.context import Here, Number
from api.web.live import Live
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, page
from api.web.scans import scan_views
from goniometer.campaigns.campaign import Campaign
from goniometer.campaigns.campaign_file import read_campaign
from goniometer.errors import CampaignError
from goniometer.geometry import Geometry
from goniometer.plans.plan import first_points
from goniometer.plans.plan_spec import ORDINARY, plan_spec, reference_points, uniform_grid_size
from goniometer.scans.duration import DEAD_TIME
from goniometer.storage import look_up
from goniometer.storage.look_up import CampaignRow
from goniometer.storage.records import Expected

router = APIRouter(prefix="/api/campaigns", tags=["campaigns"])

MOST_POINTS = 50_000
"""Of a scan; a bench needs days for them."""
MOST_SCANS = 500

_EXAMPLE = "name: First light\nsamples:\n  - {name: Sample 1, material: sample-1}\n"
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "A campaign, as docs/campaign.yaml explains it.",
        "content": {
            "application/yaml": {"schema": {"type": "string"}, "example": _EXAMPLE},
            "application/json": {"schema": {"type": "object"}},
        },
    }
}


def checked(sent: str | dict[str, Any], live: Live) -> Campaign:
    """The campaign that somebody has sent; raises `CampaignError`, also for one that has no end."""
    campaign = read_campaign(sent, live.files)
    spec = plan_spec(campaign)
    points = uniform_grid_size(spec, spec.step) if spec.mode == "uniform" else len(spec.theta_in)
    if points > MOST_POINTS:
        raise CampaignError(f"campaign: {points} points a sample have no end; ask for at most {MOST_POINTS}")
    scans = campaign.rounds * sum(sample.repeats for sample in campaign.samples)
    if scans > MOST_SCANS:
        raise CampaignError(f"campaign: {scans} scans have no end; ask for at most {MOST_SCANS}")
    return campaign


async def text_of(request: Request) -> str:
    """The body of a request that holds a campaign."""
    try:
        return (await request.body()).decode()
    except UnicodeDecodeError:
        raise CampaignError("campaign: it is not UTF-8 text; send it as such") from None


@router.post("/validate", openapi_extra=BODY)
async def validate(request: Request, live: Here, caller: Viewer) -> Verdict:
    """Whether a campaign could be measured; nothing moves, and nothing is kept."""
    text = await text_of(request)
    return await run_in_threadpool(_verdict, live, text)


@router.post("/preview", openapi_extra=BODY)
async def preview(request: Request, live: Here, caller: Viewer) -> PreviewView:
    """What a campaign will do: points, blocked range, travel and time. Nothing moves, and nothing is kept."""
    text = await text_of(request)
    return await run_in_threadpool(_preview, live, text)


@router.get("")
def campaigns(live: Here, caller: Viewer, limit: Limit = DEFAULT_LIMIT, after: After = None) -> Page[CampaignView]:
    """Campaigns that were begun, oldest first."""
    rows = look_up.campaign_rows(live.store, after_number(after), limit + 1)
    return page(rows, limit, _campaign, lambda row: row.id)


@router.get("/{number}")
def campaign(live: Here, caller: Viewer, number: Number) -> CampaignDetail:
    """A campaign that was begun: what it asks for, and its scans."""
    row = look_up.campaign_row(live.store, number)
    asked = json.loads(live.store.campaign(number).canonical_json)
    scans = scan_views(live, live.store.scans(number))
    return CampaignDetail(**_campaign(row).model_dump(), campaign=asked, scans=scans)


def _verdict(live: Live, text: str) -> Verdict:
    asked = checked(text, live)
    return Verdict(name=asked.name, hash=asked.hash, findings=preflight(live.store, asked, live.settings))


def _preview(live: Live, text: str) -> PreviewView:
    asked = checked(text, live)
    motion = ORDINARY if live.settings is None else live.settings.motion
    found = preview_of(asked, motion, DEAD_TIME if live.settings is None else live.settings.spectrometer.dead_time)
    spec = plan_spec(asked, motion)
    return PreviewView(
        campaign=found.campaign,
        legs=[
            LegView(
                name=leg.name,
                points=leg.points,
                most_points=leg.most_points,
                sample_travel=leg.sample_travel,
                detector_travel=leg.detector_travel,
                time=span(leg.time),
                waiting=leg.waiting,
            )
            for leg in found.legs
        ],
        time=span(sum((leg.time for leg in found.legs), start=Expected(0.0, 0.0, 0.0))),
        points=[_direction(each) for each in first_points(spec)],
        reference_points=[_direction(each) for each in reference_points(spec, asked.reference.step)],
        blocked=[BlockedRange(theta_in=t, low=low, high=high) for t, (low, high) in found.blocked.items()],
        uniform_1_degree_points=found.uniform_1_degree_points,
        lines=found.lines(),
        findings=preflight(live.store, asked, live.settings),
    )


def span(time: Expected) -> Span:
    """A time with its limits, as it is shown."""
    return Span(seconds=time.seconds, low=time.low, high=time.high)


def _direction(geometry: Geometry) -> Direction:
    return Direction(
        theta_in=geometry.theta_in,
        theta_out=geometry.theta_out,
        sample=geometry.sample_angle,
        detector=geometry.detector_angle,
    )


def _campaign(row: CampaignRow) -> CampaignView:
    return CampaignView(id=row.id, name=row.name, hash=row.hash, created=row.created, bench=row.bench)
