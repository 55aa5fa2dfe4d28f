"""Raw counts of finished scans move from the database to files, and back; read they are as before.

Whoever is killed on the way loses nothing: the file is whole, on the disk and compared with the database before the
counts there become empty, all at once; on the way back the counts are in the database before the archive is forgotten.
"""

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, bindparam, delete, func, insert, select, update

from goniometer.errors import InputError, StoreBusy, StoreError
from goniometer.files.dataset_hdf5 import write_exposures
from goniometer.storage import tables
from goniometer.storage.archive_file import GROUP, Archive, archive_of, file_hash, read_counts
from goniometer.storage.records import Exposure, now
from goniometer.storage.store import Store
from goniometer.upkeep.backup import flush

_EMPTY = b""


@dataclass(frozen=True)
class Moved:
    """What was done with the counts of a scan."""

    scan_id: int
    path: str
    octets: int
    """Of the file."""
    freed: int
    """Octets of counts that are no longer in the database; below 0 where they came back."""


def finished_before(store: Store, day: str) -> list[int]:
    """Ids of the scans that ended before `day`, ISO 8601 in UTC, and have counts in the database, oldest first."""
    here, raw = tables.scans.c, tables.exposures.c
    inside = select(raw.id).where(raw.scan_id == here.id, func.length(raw.counts) > 0).exists()
    query = select(here.id).where(here.phase == "finished", here.finished < day, inside).order_by(here.id)
    return [row.id for row in store.rows(query)]


def archive_scan(store: Store, scan_id: int, folder: Path) -> Moved:
    """Let the counts of a finished scan be in a file in `folder`; one that is archived elsewhere moves there.

    A file that somebody has carried there is taken up. Raises `NotInStore`, `InputError` for a scan that has not ended
    or a folder that is not there, `StoreBusy` where the scan goes on meanwhile, and what reading raises.
    """
    if store.scan(scan_id).phase != "finished":
        raise InputError(f"Scan {scan_id} has not ended; archive it when it has")
    if not folder.is_dir():
        raise InputError(f"There is no folder {folder}; create it first")
    folder = folder.resolve()
    before = archive_of(store, scan_id)
    if before is not None:
        carried = folder / Path(before.path).name
        if carried.is_file() and file_hash(carried) == before.sha256:
            with store.alone() as connection:
                _point_to(connection, scan_id, {"path": str(carried)})
            if _inside(store, scan_id) == 0:
                return Moved(scan_id, str(carried), before.octets, 0)
    exposures = store.exposures(scan_id)
    if not exposures:
        raise InputError(f"Scan {scan_id} has no raw data; name another")
    path = folder / f"scan-{scan_id:06d}-{exposures[-1].id}.h5"
    with store.faults():
        archive = _write(store, scan_id, exposures, path)
    freed = _inside(store, scan_id)
    with store.alone() as connection:
        raw = tables.exposures.c
        known = connection.execute(select(raw.id).where(raw.scan_id == scan_id).order_by(raw.id)).scalars().all()
        if list(known) != [exposure.id for exposure in exposures]:
            raise StoreBusy(f"Scan {scan_id} goes on; archive it when it has ended")
        told = {name: getattr(archive, name) for name in ("path", "sha256", "octets", "exposures", "created")}
        _point_to(connection, scan_id, told)
        moving = update(tables.exposures).where(raw.scan_id == scan_id, func.length(raw.counts) > 0)
        connection.execute(moving.values(counts=_EMPTY))
    return Moved(scan_id, archive.path, archive.octets, freed)


def unarchive_scan(store: Store, scan_id: int) -> Moved:
    """Let the counts of a scan be in the database again; the file stays, and belongs to nobody then.

    Raises `InputError` for a scan that is not archived, `ArchiveMissing` and `RawDamaged`.
    """
    archive = archive_of(store, scan_id)
    if archive is None:
        raise InputError(f"Scan {scan_id} is not archived; its raw counts are in the database")
    store.exposures(scan_id)  # compares all hashes
    counts = read_counts(archive)
    before = _inside(store, scan_id)
    with store.alone() as connection:
        raw = tables.exposures.c
        away = select(raw.id).where(raw.scan_id == scan_id, func.length(raw.counts) == 0)
        rows = [{"row": number, "kept": counts[number]} for number in connection.execute(away).scalars()]
        if rows:
            filling = update(tables.exposures).where(raw.id == bindparam("row")).values(counts=bindparam("kept"))
            connection.execute(filling, rows)
        connection.execute(delete(tables.archives).where(tables.archives.c.scan_id == scan_id))
    return Moved(scan_id, archive.path, archive.octets, before - _inside(store, scan_id))


def give_back(store: Store) -> int | None:
    """Make an SQLite file as much smaller as there is room in it; returns by how many octets.

    None where it keeps its size, and the room is used for what is measured next: in a database that is older than this
    function, and on a server.
    """
    if store.file is None:
        return None
    with store.faults(), closing(sqlite3.connect(store.file, timeout=_PATIENCE)) as connection:
        if connection.execute("PRAGMA auto_vacuum").fetchone() != (_INCREMENTAL,):
            return None
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        before = store.file.stat().st_size
        # "execute" would take the first step only, which frees one page
        connection.executescript("PRAGMA incremental_vacuum; PRAGMA wal_checkpoint(TRUNCATE)")
        return before - store.file.stat().st_size


_PATIENCE = 10.0
"""Seconds that others may keep the database locked."""
_INCREMENTAL = 2
"""As SQLite counts its ways of making a file smaller."""


def _inside(store: Store, scan_id: int) -> int:
    """Octets of the counts of a scan that are in the database."""
    raw = tables.exposures.c
    query = select(func.coalesce(func.sum(func.length(raw.counts)), 0).label("octets")).where(raw.scan_id == scan_id)
    return int(store.rows(query)[0].octets)


def _point_to(connection: Connection, scan_id: int, told: dict[str, object]) -> None:
    here = tables.archives.c
    if connection.execute(update(tables.archives).where(here.scan_id == scan_id).values(**told)).rowcount == 0:
        connection.execute(insert(tables.archives).values(scan_id=scan_id, **told))


def _write(store: Store, scan_id: int, exposures: Sequence[Exposure], path: Path) -> Archive:
    """The file, whole and on the disk under its name, once it gives back what the database holds."""
    import h5py  # noqa: PLC0415  (is only needed here)

    scan = store.scan(scan_id)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with h5py.File(part, "w", libver=("earliest", "v110")) as file:
            file.attrs["format"] = "goniometer archive"
            file.attrs["scan"], file.attrs["sample"] = scan_id, scan.name
            write_exposures(file.create_group(GROUP), store.constants(scan_id), list(exposures))
        flush(part)
        made = Archive(scan_id, str(part), file_hash(part), part.stat().st_size, len(exposures), now())
        again = read_counts(made)
        for exposure in exposures:
            if again.get(exposure.id) != exposure.counts.astype("<u4").tobytes():
                raise StoreError(f"{path} does not give back what was written to it; archive to another disk")
        os.replace(part, path)
        flush(path.parent)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error.strerror or error}; make room, or name another") from error
    finally:
        part.unlink(missing_ok=True)
    return Archive(scan_id, str(path), made.sha256, made.octets, made.exposures, made.created)
