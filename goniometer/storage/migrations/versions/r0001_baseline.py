"""Tables of versions 1 to 7 become those with which revisions begin.

A table whose text differs is written anew: its rows are copied, and what they did not say then is filled in as follows.
In versions 1 and 2 an exposure had no geometry and no moment: it gets those that its point read back, and the second in
which it was written, on a clock of its own called "unknown", as that of version 3 is. What a list shows of a dataset
is read from its numbers.
"""

from collections.abc import Callable, Iterator
from typing import Any

from alembic import op
from sqlalchemy import Connection, MetaData, Table, insert, inspect, select, text, update
from sqlalchemy.schema import CreateTable

from goniometer.storage.migrations.baseline import metadata
from goniometer.storage.migrations.old_content import campaign_of, columns_of, constants_of
from goniometer.storage.only_added import protect

revision = "0001"
down_revision = None

ABOUT_VERSION = 8
"""What programs from before revisions read, and refuse; it never changes again."""

_FIRST = "(SELECT min(o.taken) FROM exposures o WHERE o.point_id = old.point_id)"
_READ_BACK = "(SELECT read_{} FROM points WHERE points.id = old.point_id)"
_MISSING = {
    ("exposures", "theta_in"): _READ_BACK.format("theta_in"),
    ("exposures", "theta_out"): _READ_BACK.format("theta_out"),
    ("exposures", "moment"): f"CAST(strftime('%s', coalesce({_FIRST}, taken)) AS REAL)",
    ("exposures", "session"): "'unknown'",
    ("queue", "ordered"): "CASE phase WHEN 'idle' THEN NULL ELSE created END",
}
"""SQL for what an old row does not say; null for all others."""


def upgrade() -> None:
    """See the module."""
    connection = op.get_bind()
    there = set(inspect(connection).get_table_names())
    for table in metadata.sorted_tables:
        if table.name not in there:
            table.create(connection)
        elif _words(_text(connection, table.name)) != _words(str(CreateTable(table).compile(connection))):
            _write_anew(connection, table)
        for index in table.indexes:
            index.create(connection, checkfirst=True)
        if table.info:
            protect(connection, table.name)
    _rewrite(connection, "campaigns", "json", campaign_of)
    _rewrite(connection, "scans", "constants", constants_of)
    about = metadata.tables["about"]
    connection.execute(update(about).values(schema_version=ABOUT_VERSION))


def _text(connection: Connection, name: str) -> str:
    query = text("SELECT sql FROM sqlite_master WHERE type = 'table' AND name = :name")
    return str(connection.execute(query, {"name": name}).scalar_one())


def _words(sql: str) -> list[str]:
    return sql.split()


def _write_anew(connection: Connection, table: Table) -> None:
    """Give a table the columns and constraints of `table`, with its rows; triggers and indexes are not kept."""
    beside = MetaData()
    for each in metadata.sorted_tables:
        each.to_metadata(beside)
    new = table.to_metadata(beside, name=f"new_{table.name}")
    connection.execute(CreateTable(new))
    names = [column.name for column in table.columns]
    columns = {column["name"] for column in inspect(connection).get_columns(table.name)}
    if table.name == "datasets":
        for row in _datasets(connection, columns):
            connection.execute(insert(new).values(**row))
    else:
        told = ", ".join(name if name in columns else _MISSING.get((table.name, name), "NULL") for name in names)
        # names of tables and columns only
        copy = f"INSERT INTO {new.name} ({', '.join(names)}) SELECT {told} FROM {table.name} old"  # nosec B608
        connection.execute(text(copy))
    if table.dialect_options["sqlite"]["autoincrement"]:  # numbers that were given once are not given again
        connection.execute(text("DELETE FROM sqlite_sequence WHERE name = :new"), {"new": new.name})
        connection.execute(
            text("INSERT INTO sqlite_sequence (name, seq) SELECT :new, seq FROM sqlite_sequence WHERE name = :old"),
            {"new": new.name, "old": table.name},
        )
    connection.execute(text(f"DROP TABLE {table.name}"))
    connection.execute(text(f"ALTER TABLE {new.name} RENAME TO {table.name}"))


def _rewrite(connection: Connection, name: str, column: str, change: Callable[[str], str]) -> None:
    """Bring one text of every row of a table into today's form."""
    here = metadata.tables[name].c
    for row in connection.execute(select(here.id, here[column]).where(here[column].is_not(None))).all():
        changed = change(row[1])
        if changed != row[1]:
            connection.execute(update(metadata.tables[name]).where(here.id == row.id).values({column: changed}))


def _datasets(connection: Connection, columns: set[str]) -> Iterator[dict[str, Any]]:
    """Every dataset as a row of the new table."""
    kept = ", ".join(sorted(columns))
    one = text(f"SELECT {kept} FROM datasets WHERE id = :id")  # nosec B608 # names of columns only
    for (dataset_id,) in connection.execute(text("SELECT id FROM datasets ORDER BY id")).all():
        row = connection.execute(one, {"id": dataset_id}).one()
        yield columns_of(dict(row._mapping))
