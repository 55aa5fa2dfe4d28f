"""How the tables of a database follow the program: one file in `versions` for each step, which Alembic runs in order.

A database says in the table `alembic_version` which revision it has; the newest file in `versions` is the one that the
program needs. Nothing else counts. A new database is made from `goniometer.storage.tables` at once and gets that
number.

To add a column:

1. Change the table in `goniometer.storage.tables` or `goniometer.storage.service_tables`.
2. Add `versions/rNNNN_what.py` with the next number, `revision = "NNNN"`, `down_revision` of the file before it, and

       def upgrade() -> None:
           op.add_column("points", Column("humidity", Float))

   A column without null needs a `server_default` or has to be filled, and SQLite can do neither that nor change a
   constraint in place: use `with op.batch_alter_table("points") as batch:`, which writes the table anew. That drops the
   triggers of a table whose rows are only ever added, so call `only_added.protect(op.get_bind(), "points")` after it;
   to fill a column of such a table, `only_added.unprotect` comes before. Batch mode sees no CHECK without a name: hand
   it the table as it shall be, `batch_alter_table("points", copy_from=...)`, or the constraints are lost.
3. Do not import `goniometer.storage.tables` in a revision: it must do the same when they have gone on changing.
4. `tests/goniometer/test_migrations.py` upgrades a database of every version there ever was and compares what comes of
   it with the tables of the program, constraints and triggers included; it fails until the revision is right.

All steps run in one transaction, with references unchecked meanwhile and checked before its end.
"""

from pathlib import Path

from sqlalchemy import Column, Connection, MetaData, PrimaryKeyConstraint, String, Table, insert, inspect, select

FOLDER = Path(__file__).parent

_version = Table(
    "alembic_version",
    MetaData(),
    Column("version_num", String(32), nullable=False),
    PrimaryKeyConstraint("version_num", name="alembic_version_pkc"),
)
"""As Alembic makes it."""


def known() -> tuple[str, ...]:
    """Every revision that this program knows, oldest first."""
    return tuple(sorted(file.name[1:5] for file in (FOLDER / "versions").glob("r[0-9][0-9][0-9][0-9]_*.py")))


def head() -> str:
    """The revision that this program needs."""
    return known()[-1]


def revision_of(connection: Connection) -> str | None:
    """The revision that a database has; None for one from before there were any."""
    if not inspect(connection).has_table(_version.name):
        return None
    found: str | None = connection.execute(select(_version.c.version_num)).scalar()
    return found


def stamp(connection: Connection) -> None:
    """Note that the tables, which were made just now, are those of the newest revision."""
    _version.create(connection)
    connection.execute(insert(_version).values(version_num=head()))


def upgrade(connection: Connection) -> list[str]:
    """Bring the tables to the newest revision, within the transaction of the caller; returns the steps in words."""
    # Loading Alembic takes as long as opening a database, which hardly ever needs it.
    from alembic.operations import Operations  # noqa: PLC0415
    from alembic.runtime.migration import MigrationContext  # noqa: PLC0415
    from alembic.script import ScriptDirectory  # noqa: PLC0415

    scripts = ScriptDirectory(str(FOLDER))
    context = MigrationContext.configure(connection)
    steps = list(scripts.walk_revisions(revision_of(connection) or "base", "heads"))[::-1]
    done = []
    with Operations.context(context):
        for step in steps:
            if step.revision != revision_of(connection):
                step.module.upgrade()
                context.stamp(scripts, step.revision)
                done.append(f"{step.revision}: {step.doc}")
    return done
