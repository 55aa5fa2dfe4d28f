"""Single rows and parts of long lists of what was measured, for who looks at a database while it is written."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import BindParameter, Select, and_, bindparam, case, exists, func, select

from goniometer.states import Phase
from goniometer.storage import tables
from goniometer.storage.archive_file import whole_exposures
from goniometer.storage.database import Database
from goniometer.storage.records import Exposure, Point, Scan, to_point, to_scan

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


@cache  # to build it takes longer than to ask it
def scan_rows() -> Select[Any]:
    """Rows of `tables.scans`, with which scan of its kind of its sample each is, null where there is one only.

    Without the constants, whose 20 kB most scans are not asked for.
    """
    here, other = tables.scans.c, tables.scans.alias("other").c
    alike = and_(other.campaign_id == here.campaign_id, other.kind == here.kind, other.sample == here.sample)
    count = select(func.count()).where(alike).scalar_subquery()
    place = select(func.count()).where(alike, other.number <= here.number).scalar_subquery()
    columns = [column for column in here if column.name != "constants"]
    return select(*columns, case((count > 1, place)).label("repeat"))


@cache
def listed_scans() -> tuple[Select[Any], Select[Any]]:
    """All scans, and those of the campaign "campaign", in the order in which they are run."""
    every = scan_rows().order_by(tables.scans.c.campaign_id, tables.scans.c.number)
    return every, every.where(tables.scans.c.campaign_id == bindparam("campaign"))


def scans_after(database: Database, scan_id: int, limit: int, campaign_id: int | None = None) -> list[Scan]:
    """At most `limit` scans (of one campaign) with ids above `scan_id`, in the order of these."""
    here = tables.scans.c
    query = scan_rows().where(here.id > scan_id).order_by(here.id).limit(limit)
    if campaign_id is not None:
        query = query.where(here.campaign_id == campaign_id)
    return [to_scan(row) for row in database.rows(query)]


def begun_references(database: Database, limit: int, before: int | None = None) -> list[Scan]:
    """At most `limit` scans of reference panels that have begun, newest first: those with ids below `before`."""
    here = tables.scans.c
    begun = select(here.id).where(here.kind == "reference", here.started.is_not(None)).order_by(here.id.desc())
    if before is not None:
        begun = begun.where(here.id < before)
    # chosen before anything is counted: how often a scan was repeated is asked for these only
    query = scan_rows().where(here.id.in_(begun.limit(limit).correlate(None))).order_by(here.id.desc())
    return [to_scan(row) for row in database.rows(query)]


def scans_in_phases(database: Database, phases: Collection[Phase]) -> list[Scan]:
    """Scans of all campaigns that are in one of these phases, in the order in which they are run."""
    here = tables.scans.c
    query = scan_rows().where(here.phase.in_(phases)).order_by(here.campaign_id, here.number)
    return [to_scan(row) for row in database.rows(query)]


def uncalibrated_scans(database: Database) -> list[Scan]:
    """Completed scans of samples that have no dataset, in the order in which they were run."""
    here = tables.scans.c
    without = ~exists().where(tables.datasets.c.scan_id == here.id)
    query = scan_rows().where(here.kind == "sample", here.outcome == "completed", without)
    return [to_scan(row) for row in database.rows(query.order_by(here.campaign_id, here.number))]


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
    """One exposure and the id of its scan; raises `NotInStore`, `RawDamaged` and `ArchiveMissing`."""
    query = select(tables.exposures).where(tables.exposures.c.id == exposure_id)
    row = database.row(query, f"exposure {exposure_id}")
    return row.scan_id, whole_exposures(database, [row])[0]
