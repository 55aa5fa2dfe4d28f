"""Whether a database is as it was written: what can be told of its file and of its rows."""

import json
from collections.abc import Iterator
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, func, or_, select
from sqlalchemy.exc import DatabaseError

from goniometer.errors import ArchiveMissing
from goniometer.storage import migrations, tables
from goniometer.storage.archive_file import Archive, read_counts
from goniometer.storage.database import Database
from goniometer.storage.records import exposure_hash

_READ_AT_ONCE = 500
_EXPOSURES = ("exposures", "darks", "stray", "monitors")
_MADE_OF = {
    **{name: tables.exposures for name in (*_EXPOSURES, *(f"reference_{name}" for name in _EXPOSURES))},
    **dict.fromkeys(("scan", "reference_scan", "spot_scan", "scans_between"), tables.scans),
}
"""What the lineage of a measured dataset names by number, and where that stands."""


@dataclass(frozen=True)
class Findings:
    """What a check of a database found."""

    exposures: int
    """Whose hashes were compared."""
    datasets: int
    """Whose origin was looked for."""
    faults: list[str]
    """What is wrong, a sentence each; empty where nothing is."""
    complete: bool = True
    """Whether rows were looked at; not in a damaged file, nor in one of another version."""


def check(database: Database) -> Findings:
    """Read the whole database and compare it with itself; one of an older version is looked at as far as that goes."""
    with database.reading() as connection:
        faults = list(damage(connection))
        if faults:  # a damaged file gives other answers at every question
            return Findings(0, 0, faults, complete=False)
        revision = migrations.revision_of(connection)
        if revision != migrations.head():
            told = f"Its tables are {revision or 'those of a version before revisions'}, not {migrations.head()}"
            return Findings(0, 0, [f"{told}; run: goniometer db upgrade {database.where}"], complete=False)
        faults += [
            *_settings(connection),
            *_raw(connection),
            *_archives(connection),
            *_points(connection),
            *_origins(connection),
        ]
        exposures, datasets = (
            connection.execute(select(func.count()).select_from(table)).scalar_one()
            for table in (tables.exposures, tables.datasets)
        )
    return Findings(exposures, datasets, faults)


def damage(connection: Connection) -> Iterator[str]:
    """What is wrong with an SQLite file and with the references between its rows; a server sees to that itself."""
    if connection.dialect.name != "sqlite":
        return
    try:
        for (fault,) in connection.exec_driver_sql("PRAGMA integrity_check(20)"):
            if fault != "ok":
                yield f"The file is damaged: {' '.join(fault.split())}"
        for table, row, parent, _ in connection.exec_driver_sql("PRAGMA foreign_key_check"):
            yield f"Row {row} of {table} refers to a row of {parent} that is not there"
    except DatabaseError as error:
        yield f"The file is damaged: {error.orig}"


def _settings(connection: Connection) -> Iterator[str]:
    """Whether SQLite keeps to what makes a committed row stay."""
    if connection.dialect.name != "sqlite":
        return
    wanted = {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}
    for name, value in wanted.items():
        found = connection.exec_driver_sql(f"PRAGMA {name}").scalar()
        if found != value:
            yield f"SQLite keeps to {name} = {found} where {value} is wanted; move the file to a local disk"


def _raw(connection: Connection) -> Iterator[str]:
    """Exposures that are not as they were written."""
    query = select(tables.exposures).where(kept_inside())
    for row in connection.execute(query.execution_options(yield_per=_READ_AT_ONCE)):
        if exposure_hash(row._mapping) != row.sha256:
            yield f"Exposure {row.id} is not as it was written"


def kept_inside() -> ColumnElement[bool]:
    """Whether the counts of an exposure should be in the database, and not in an archive."""
    here = tables.exposures.c
    return or_(func.length(here.counts) > 0, here.scan_id.not_in(select(tables.archives.c.scan_id)))


def _archives(connection: Connection) -> Iterator[str]:
    """Archives that are not there, and exposures in them that are not as they were written."""
    here = tables.archives.c
    columns = (here.scan_id, here.path, here.sha256, here.octets, here.exposures, here.created)
    for found in connection.execute(select(*columns).order_by(here.scan_id)).all():
        archive = Archive(**found._mapping)
        try:
            counts = read_counts(archive)
        except ArchiveMissing as error:
            yield str(error)
            continue
        query = select(tables.exposures).where(tables.exposures.c.scan_id == archive.scan_id, ~kept_inside())
        for row in connection.execute(query):
            if exposure_hash({**row._mapping, "counts": counts.get(row.id, b"")}) != row.sha256:
                yield f"Exposure {row.id} is not as it was written, in {archive.path}"


def _points(connection: Connection) -> Iterator[str]:
    """Points that are done without an exposure."""
    points, exposures = tables.points, tables.exposures
    query = select(points.c.id).where(
        points.c.status == "done", points.c.id.not_in(select(exposures.c.point_id).where(exposures.c.kind == "light"))
    )
    for (point_id,) in connection.execute(query):
        yield f"Point {point_id} is done, but has no exposure"


def _origins(connection: Connection) -> Iterator[str]:
    """Measured datasets that name an exposure or a scan that is not there."""
    there = {
        table.name: set(connection.execute(select(table.c.id)).scalars()) for table in (tables.exposures, tables.scans)
    }
    here = tables.datasets.c
    query = select(here.id, here.lineage).where(here.kind == "measured", here.scan_id.is_not(None)).order_by(here.id)
    for row in connection.execute(query.execution_options(yield_per=_READ_AT_ONCE)):
        lineage = json.loads(row.lineage)
        for name, table in _MADE_OF.items():
            named = lineage.get(name)
            numbers = set(named if isinstance(named, list) else [] if named is None else [named])
            missing = sorted(numbers - there[table.name])
            if missing:
                told = f"{table.name} {missing[0]}, which is not there ({len(missing)} such)"
                yield f"Dataset {row.id} was made of {told}"
