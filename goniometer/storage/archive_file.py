"""Files to which the raw counts of finished scans have moved, and how they are read as if they had not.

A scan has one such file, HDF5, which tells everything that was read in it: see `goniometer.files.dataset_hdf5`. The
rows of its exposures stay in the database, with empty counts and with the hash by which these are known again.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Row, select

from goniometer.errors import ArchiveMissing
from goniometer.storage import tables
from goniometer.storage.database import Database
from goniometer.storage.records import Exposure, to_exposure

GROUP = "raw"
"""Of the file, in which the exposures are."""


@dataclass(frozen=True)
class Archive:
    """Where the counts of a scan are."""

    scan_id: int
    path: str
    sha256: str
    """Of the file."""
    octets: int
    """Of the file."""
    exposures: int
    created: str
    """ISO 8601, UTC."""


def archive_of(database: Database, scan_id: int) -> Archive | None:
    """The archive of a scan; None where its counts are in the database."""
    here = tables.archives.c
    columns = (here.scan_id, here.path, here.sha256, here.octets, here.exposures, here.created)
    rows = database.rows(select(*columns).where(here.scan_id == scan_id))
    return Archive(**rows[0]._mapping) if rows else None


def whole_exposures(database: Database, rows: Sequence[Row[Any]]) -> list[Exposure]:
    """Rows of `tables.exposures` of one scan, wherever their counts are.

    Raises `ArchiveMissing` where these are in a file that is not there, and `RawDamaged` where they have changed.
    """
    if all(row.counts for row in rows):
        return [to_exposure(row) for row in rows]
    archive = archive_of(database, rows[0].scan_id)
    counts = {} if archive is None else read_counts(archive)  # without one, the hash tells that they are gone
    return [to_exposure(row, None if row.counts else counts.get(row.id)) for row in rows]


def read_counts(archive: Archive) -> dict[int, bytes]:
    """Counts of all exposures in a file, as the database keeps them, by their ids; raises `ArchiveMissing`."""
    import h5py  # noqa: PLC0415  (is only needed here)

    path = Path(archive.path)
    if not path.is_file():
        raise ArchiveMissing(archive.scan_id, archive.path, "which is not there")
    try:
        with h5py.File(path, "r") as file:
            ids, counts = file[f"{GROUP}/id"], file[f"{GROUP}/counts"]
            # nothing larger is unpacked than what was written
            if counts.ndim != 2 or ids.shape != counts.shape[:1] or len(ids) != archive.exposures:
                raise ArchiveMissing(archive.scan_id, archive.path, "which holds something else")
            values = np.asarray(counts[()], dtype="<u4")
            return dict(zip(ids[()].tolist(), (row.tobytes() for row in values), strict=True))
    # what the library raises for a file that is not what we wrote
    except (OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise ArchiveMissing(archive.scan_id, archive.path, f"which cannot be read ({error})") from error


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
