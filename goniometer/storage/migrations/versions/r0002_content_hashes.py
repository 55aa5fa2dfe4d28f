"""Every raw exposure has the hash of what was read, so that a change of it is seen; those that are there get theirs.

From now on a byte that changes on the disk is told from what was measured. What had changed before cannot be.
"""

import hashlib
import json
from collections.abc import Iterator
from typing import Any

from alembic import op
from sqlalchemy import (
    CheckConstraint,
    Column,
    Connection,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    bindparam,
    insert,
    select,
    update,
)

from goniometer.storage.migrations.baseline import metadata as before
from goniometer.storage.only_added import protect, unprotect

revision = "0002"
down_revision = "0001"

_BATCH = 1000
_HASHED = (
    "kind",
    "integration_time",
    "device_count",
    "detector_temperature",
    "theta_in",
    "theta_out",
    "theta_out_end",
    "session",
    "moment",
    "taken",
)


def upgrade() -> None:
    """See the module."""
    connection = op.get_bind()
    if connection.dialect.name == "sqlite":
        _write_anew(connection)
    else:
        unprotect(connection, "exposures")
        op.add_column("exposures", Column("sha256", String))
        table = Table("exposures", MetaData(), Column("id", Integer, primary_key=True), Column("sha256", String))
        for rows in _hashed(connection):
            values = [{"row": row["id"], "hash": row["sha256"]} for row in rows]
            connection.execute(
                update(table).where(table.c.id == bindparam("row")).values(sha256=bindparam("hash")), values
            )
        op.alter_column("exposures", "sha256", nullable=False)
    protect(connection, "exposures")


def _write_anew(connection: Connection) -> None:
    """SQLite cannot add a column that is not null, and to read the hash it need not read the counts before it."""
    tables = MetaData()
    for name in ("campaigns", "scans", "points"):
        before.tables[name].to_metadata(tables)
    new = Table(
        "new_exposures",
        tables,
        Column("id", Integer, primary_key=True),
        Column("scan_id", ForeignKey("scans.id"), nullable=False),
        Column("point_id", ForeignKey("points.id")),
        Column("kind", String, nullable=False),
        Column("integration_time", Float, nullable=False),
        Column("sha256", String, nullable=False),
        Column("counts", LargeBinary, nullable=False),
        Column("device_count", Integer, nullable=False),
        Column("detector_temperature", Float, nullable=False),
        Column("theta_in", Float),
        Column("theta_out", Float),
        Column("theta_out_end", Float),
        Column("session", String, nullable=False),
        Column("moment", Float, nullable=False),
        Column("taken", String, nullable=False),
        CheckConstraint("kind IN ('light', 'dark', 'stray', 'monitor', 'sweep')"),
        CheckConstraint("(kind = 'light') = (point_id IS NOT NULL)"),
        CheckConstraint("(kind = 'dark') = (theta_in IS NULL) AND (theta_in IS NULL) = (theta_out IS NULL)"),
        CheckConstraint("(kind = 'sweep') = (theta_out_end IS NOT NULL)"),
    )
    new.create(connection)
    for rows in _hashed(connection):
        connection.execute(insert(new), rows)
    op.drop_table("exposures")
    op.rename_table("new_exposures", "exposures")
    Index("exposures_of_scan", Table("exposures", MetaData(), Column("scan_id")).c.scan_id).create(connection)


def _hashed(connection: Connection) -> Iterator[list[dict[str, Any]]]:
    """All rows with their hash, some at a time."""
    old = before.tables["exposures"]
    last = -1
    while True:
        query = select(old).where(old.c.id > last).order_by(old.c.id).limit(_BATCH)
        rows = [dict(row._mapping) for row in connection.execute(query)]
        if not rows:
            return
        yield [row | {"sha256": _hash(row)} for row in rows]
        last = rows[-1]["id"]


def _hash(row: dict[str, Any]) -> str:
    told = json.dumps([row[name] for name in _HASHED], separators=(",", ":"))
    return hashlib.sha256(told.encode() + b"\n" + bytes(row["counts"])).hexdigest()
