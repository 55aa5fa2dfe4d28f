"""Single rows and parts of long lists of what was measured, for who looks at a database while it is written."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import BindParameter, bindparam, func, select

from goniometer import tables
from goniometer.database import Database
from goniometer.records import Exposure, Point, to_exposure, to_point

# Built once, for pages ask all the time while a scan runs.
_POINT = tables.points.c
_SCANS: BindParameter[Any] = bindparam("scans", expanding=True)
_COUNTED = (
    select(_POINT.scan_id, _POINT.status, func.count().label("number"))
    .where(_POINT.scan_id.in_(_SCANS))
    .group_by(_POINT.scan_id, _POINT.status)
)
_MADE = (
    select(tables.datasets.c.id, tables.datasets.c.scan_id)
    .where(tables.datasets.c.scan_id.in_(_SCANS))
    .order_by(tables.datasets.c.id)
)
_POINTS = (
    select(tables.points)
    .where(_POINT.scan_id == bindparam("scan"), _POINT.number > bindparam("after"))
    .order_by(_POINT.number)
    .limit(bindparam("limit"))
)


@dataclass(frozen=True)
class Counts:
    """How many points a scan has."""

    done: int
    failed: int
    """Failed and skipped ones."""
    pending: int


NONE = Counts(0, 0, 0)


@dataclass(frozen=True)
class CampaignRow:
    """A campaign in the database, without what it asks for."""

    id: int
    name: str
    hash: str
    """SHA-256 of what decides what is measured."""
    created: str
    """ISO 8601, UTC."""
    bench: str
    """Name of the bench on which it is measured."""


def campaign_rows(database: Database, after: int, limit: int) -> list[CampaignRow]:
    """At most `limit` campaigns with ids above `after`, oldest first."""
    here = tables.campaigns.c
    query = (
        select(here.id, here.name, here.hash, here.created, here.bench)
        .where(here.id > after)
        .order_by(here.id)
        .limit(limit)
    )
    return [CampaignRow(row.id, row.name, row.hash, row.created, row.bench) for row in database.rows(query)]


def campaign_row(database: Database, campaign_id: int) -> CampaignRow:
    """One campaign; raises `NotInStore`."""
    here = tables.campaigns.c
    query = select(here.id, here.name, here.hash, here.created, here.bench).where(here.id == campaign_id)
    row = database.row(query, f"campaign {campaign_id}")
    return CampaignRow(row.id, row.name, row.hash, row.created, row.bench)


def point_counts(database: Database, scan_ids: Sequence[int]) -> dict[int, Counts]:
    """How many points these scans have, by their ids; scans without any are left out."""
    found: dict[int, dict[str, int]] = {}
    for row in database.rows(_COUNTED, {"scans": scan_ids}):
        found.setdefault(row.scan_id, {})[row.status] = row.number
    return {scan_id: _counts(**counted) for scan_id, counted in found.items()}


def _counts(done: int = 0, failed: int = 0, skipped: int = 0, pending: int = 0, running: int = 0) -> Counts:
    return Counts(done, failed + skipped, pending + running)


def datasets_of(database: Database, scan_ids: Sequence[int]) -> dict[int, list[int]]:
    """Ids of the datasets of these scans, oldest first, by the ids of the scans; scans without any are left out."""
    found: dict[int, list[int]] = {}
    for row in database.rows(_MADE, {"scans": scan_ids}):
        found.setdefault(row.scan_id, []).append(row.id)
    return found


def detector_temperatures(database: Database, scan_ids: Sequence[int]) -> dict[int, tuple[float, float, float]]:
    """Mean, lowest and highest detector temperature of all exposures of these scans, degrees Celsius, by their ids."""
    here = tables.exposures.c
    value = here.detector_temperature
    told = select(
        here.scan_id, func.avg(value).label("mean"), func.min(value).label("low"), func.max(value).label("high")
    )
    query = told.where(here.scan_id.in_(scan_ids)).group_by(here.scan_id)
    return {row.scan_id: (float(row.mean), float(row.low), float(row.high)) for row in database.rows(query)}


def points_after(database: Database, scan_id: int, after: int, limit: int) -> list[Point]:
    """At most `limit` points of a scan with numbers above `after`, in the order in which the plan asked for them."""
    return [to_point(row) for row in database.rows(_POINTS, {"scan": scan_id, "after": after, "limit": limit})]


def point(database: Database, point_id: int) -> Point:
    """One point; raises `NotInStore`."""
    return to_point(database.row(select(tables.points).where(tables.points.c.id == point_id), f"point {point_id}"))


def exposures_of(database: Database, point_id: int) -> list[int]:
    """Ids of the exposures of a point, in the order in which they were written."""
    here = tables.exposures.c
    scan = select(tables.points.c.scan_id).where(tables.points.c.id == point_id).scalar_subquery()
    # there is an index of scans
    query = select(here.id).where(here.scan_id == scan, here.point_id == point_id).order_by(here.id)
    return [row.id for row in database.rows(query)]


def exposure(database: Database, exposure_id: int) -> tuple[int, Exposure]:
    """One exposure and the id of its scan; raises `NotInStore`."""
    query = select(tables.exposures).where(tables.exposures.c.id == exposure_id)
    row = database.row(query, f"exposure {exposure_id}")
    return row.scan_id, to_exposure(row)
