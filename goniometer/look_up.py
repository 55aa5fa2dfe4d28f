"""Single rows and parts of long lists of what was measured, for who looks at a database while it is written."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import Select, and_, case, exists, func, select

from goniometer import tables
from goniometer.database import Database
from goniometer.records import Exposure, Phase, Point, Scan, to_exposure, to_point, to_scan


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
    query = scan_rows().where(here.kind == "reference", here.started.is_not(None)).order_by(here.id.desc())
    if before is not None:
        query = query.where(here.id < before)
    return [to_scan(row) for row in database.rows(query.limit(limit))]


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
    query = select(here.id, here.name, here.hash, here.created).where(here.id > after).order_by(here.id).limit(limit)
    return [CampaignRow(row.id, row.name, row.hash, row.created) for row in database.rows(query)]


def campaign_row(database: Database, campaign_id: int) -> CampaignRow:
    """One campaign; raises `NotInStore`."""
    here = tables.campaigns.c
    query = select(here.id, here.name, here.hash, here.created).where(here.id == campaign_id)
    row = database.row(query, f"campaign {campaign_id}")
    return CampaignRow(row.id, row.name, row.hash, row.created)


def point_counts(database: Database, scan_ids: Sequence[int]) -> dict[int, Counts]:
    """How many points these scans have, by their ids; scans without any are left out."""
    here = tables.points.c
    numbers = [
        func.sum(case((here.status.in_(statuses), 1), else_=0))
        for statuses in (("done",), ("failed", "skipped"), ("pending", "running"))
    ]
    query = select(here.scan_id, *numbers).where(here.scan_id.in_(scan_ids)).group_by(here.scan_id)
    return {row[0]: Counts(*map(int, row[1:])) for row in database.rows(query)}


def datasets_of(database: Database, scan_ids: Sequence[int]) -> dict[int, list[int]]:
    """Ids of the datasets of these scans, oldest first, by the ids of the scans; scans without any are left out."""
    here = tables.datasets.c
    found: dict[int, list[int]] = {}
    for row in database.rows(select(here.id, here.scan_id).where(here.scan_id.in_(scan_ids)).order_by(here.id)):
        found.setdefault(row.scan_id, []).append(row.id)
    return found


def points_after(database: Database, scan_id: int, after: int, limit: int) -> list[Point]:
    """At most `limit` points of a scan with numbers above `after`, in the order in which the plan asked for them."""
    here = tables.points.c
    query = select(tables.points).where(here.scan_id == scan_id, here.number > after).order_by(here.number).limit(limit)
    return [to_point(row) for row in database.rows(query)]


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
