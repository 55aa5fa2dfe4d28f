"""The tables of the database, and how to tell that a database is one of ours.

campaigns 1-n scans 1-n points 1-n exposures; scans 1-n exposures without a point (darks, stray light, monitors,
sweeps), scans 1-n datasets 1-n fits and exports; imported and simulated datasets belong to no scan, and
characterisations of a bench stand alone. A campaign is measured on one bench, whose name it has. What the service needs
besides stands in `goniometer.storage.service_tables`. Exposures and everything derived are only ever added: triggers
refuse to change or delete them. Only the counts of an exposure may move to a file that `archives` names, and back;
meanwhile they are empty here, and their hash stays. Times are ISO 8601 texts in UTC; a moment is seconds on the clock
of the session of the bench that measured; those of two sessions cannot be compared.
"""

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    Connection,
    Engine,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    func,
    insert,
    inspect,
    select,
)

from goniometer.errors import StoreError, StoreOutdated
from goniometer.storage import migrations
from goniometer.storage.only_added import let_counts_move, protect
from goniometer.storage.postgresql import key, lock_transaction

APPLICATION = "goniometer"
OLD_VERSION = 8
"""What `about` tells programs from before `goniometer.storage.migrations`, which refuse it; it never changes again."""

BENCH = "bench"
"""The name of a bench that was given no other."""

metadata = MetaData()

ONLY_ADDED = {"only_added": True}
"""`info` of a table whose rows nobody may change or delete."""

about = Table(
    "about",
    metadata,
    Column("application", String, primary_key=True),
    Column("schema_version", Integer, nullable=False),
)

campaigns = Table(
    "campaigns",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("name", String, nullable=False, unique=True),
    Column("json", Text, nullable=False),
    Column("hash", String, nullable=False),
    Column("certificate", Text),
    Column("created", String, nullable=False),
    Column("bench", String, nullable=False, server_default=BENCH),
)

scans = Table(
    "scans",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("campaign_id", ForeignKey("campaigns.id"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("kind", String, nullable=False),
    Column("sample", String, nullable=False),
    Column("material", String, nullable=False),
    Column("phase", String, nullable=False),
    Column("outcome", String),
    Column("reason", Text, nullable=False, default=""),
    Column("command", String),
    Column("constants", Text),
    Column("started", String),
    Column("finished", String),
    Column("expected_points", Integer),
    Column("remaining", Float),
    Column("remaining_low", Float),
    Column("remaining_high", Float),
    CheckConstraint("kind IN ('reference', 'sample', 'spot')"),
    CheckConstraint("phase IN ('idle', 'running', 'pausing', 'paused', 'aborting', 'finished')"),
    CheckConstraint("outcome IN ('completed', 'aborted', 'failed')"),
    CheckConstraint("command IN ('pause', 'resume', 'abort')"),
    UniqueConstraint("campaign_id", "number"),
    Index("scans_by_kind", "kind", "sample", "campaign_id"),
    Index("scans_by_phase", "phase"),
)
Index("scans_called", func.lower(scans.c.sample))

points = Table(
    "points",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("scan_id", ForeignKey("scans.id"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("theta_in", Float, nullable=False),
    Column("theta_out", Float, nullable=False),
    Column("read_theta_in", Float),
    Column("read_theta_out", Float),
    Column("status", String, nullable=False),
    Column("attempts", Integer, nullable=False, default=0),
    Column("reason", Text, nullable=False, default=""),
    Column("seconds", Float, nullable=False, default=0.0),
    Column("signal_to_noise", Float),
    Column("finished", String),
    CheckConstraint("status IN ('pending', 'running', 'done', 'failed', 'skipped')"),
    UniqueConstraint("scan_id", "number"),
)

exposures = Table(
    "exposures",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("scan_id", ForeignKey("scans.id"), nullable=False),
    Column("point_id", ForeignKey("points.id")),
    Column("kind", String, nullable=False),
    Column("integration_time", Float, nullable=False),
    Column("sha256", String, nullable=False),  # of all that was read, see `goniometer.storage.records.exposure_hash`
    Column("counts", LargeBinary, nullable=False),
    Column("device_count", Integer().with_variant(BigInteger, "postgresql"), nullable=False),  # unsigned, of 32 bits
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
    Index("exposures_of_scan", "scan_id"),
    info=ONLY_ADDED,
)

archives = Table(
    "archives",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("scan_id", ForeignKey("scans.id"), nullable=False, unique=True),
    Column("path", String, nullable=False),
    Column("sha256", String, nullable=False),
    Column("octets", BigInteger, nullable=False),
    Column("exposures", Integer, nullable=False),
    Column("created", String, nullable=False),
)

datasets = Table(
    "datasets",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("scan_id", ForeignKey("scans.id")),
    Column("sample", String, nullable=False),
    Column("kind", String, nullable=False),
    Column("points", Integer, nullable=False),
    Column("incident_angles", Integer, nullable=False),
    Column("shortest", Float, nullable=False),
    Column("longest", Float, nullable=False),
    Column("flags", Integer, nullable=False),
    Column("flagged", Integer, nullable=False),
    Column("checks_failed", Integer, nullable=False),
    Column("recalibrated_from", Integer),
    Column("content_hash", String, nullable=False),
    Column("software_version", String, nullable=False),
    Column("created", String, nullable=False),
    Column("certificate", Text),
    Column("checks", Text, nullable=False),
    Column("lineage", Text, nullable=False),
    # last, for SQLite reads a row from its front, and a list of datasets needs none of their numbers
    Column("arrays", LargeBinary, nullable=False),
    CheckConstraint("kind IN ('measured', 'simulated', 'imported')"),
    Index("datasets_of_scan", "scan_id", "sample"),
    Index("datasets_by_kind", "kind"),
    Index("datasets_by_time", "created"),
    Index("datasets_by_flags", "flags"),
    Index("datasets_made_anew", "recalibrated_from"),
    info=ONLY_ADDED,
)
Index("datasets_called", func.lower(datasets.c.sample))

fits = Table(
    "fits",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("dataset_id", ForeignKey("datasets.id"), nullable=False),
    Column("model", String, nullable=False),
    Column("json", Text, nullable=False),
    Column("software_version", String, nullable=False),
    Column("created", String, nullable=False),
    Index("fits_of_dataset", "dataset_id"),
    info=ONLY_ADDED,
)

exports = Table(
    "exports",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("dataset_id", ForeignKey("datasets.id"), nullable=False),
    Column("path", String, nullable=False),
    Column("format", String, nullable=False),
    Column("sha256", String, nullable=False),
    Column("created", String, nullable=False),
    Index("exports_of_dataset", "dataset_id"),
    info=ONLY_ADDED,
)

characterisations = Table(
    "characterisations",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("bench", String, nullable=False, server_default=BENCH),
    Column("kind", String, nullable=False),
    Column("json", Text, nullable=False),
    Column("software_version", String, nullable=False),
    Column("created", String, nullable=False),
    info=ONLY_ADDED,
)


def prepare(engine: Engine, where: str) -> None:
    """Create the tables in an empty database, or check that they are ours; `where` names it in messages.

    All tables come into being in one transaction, which another process that has the same wish waits for. Raises
    `StoreOutdated` for one that an older version of this program made, `StoreError` for one of a newer or of another.
    """
    with engine.connect() as connection:
        names = inspect(connection).get_table_names()
    if not names:
        # Python's driver opens no transaction before CREATE TABLE, so each table would stay on its own.
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            if engine.dialect.name == "sqlite":
                connection.exec_driver_sql("BEGIN IMMEDIATE")
            else:
                connection.exec_driver_sql("BEGIN")
                lock_transaction(connection, key("tables"), shared=False)
            if not inspect(connection).get_table_names():  # another process may have been faster
                _create(connection)
            connection.exec_driver_sql("COMMIT")  # without it, closing the connection rolls back
    with engine.connect() as connection:
        _check(connection, where)


def _check(connection: Connection, where: str) -> None:
    check_ours(connection, where)
    revision = migrations.revision_of(connection)
    if revision == migrations.head():
        return
    if revision is None or revision in migrations.known():
        raise StoreOutdated(
            f"{where} was written by an older version of {APPLICATION}; run: goniometer db upgrade {where}"
        )
    raise StoreError(
        f"{where} was written by a newer version of {APPLICATION}, which calls its tables {revision} where this one "
        f"needs {migrations.head()}; install that version, or name a new file"
    )


def check_ours(connection: Connection, where: str) -> None:
    """Raise `StoreError` where a database is not of this program, of whichever version."""
    row = connection.execute(select(about)).first() if inspect(connection).has_table(about.name) else None
    if row is None or row.application != APPLICATION:
        raise StoreError(f"{where} is the database of another program; name a new file or one of {APPLICATION}")


def _create(connection: Connection) -> None:
    metadata.create_all(connection)
    connection.execute(insert(about).values(application=APPLICATION, schema_version=OLD_VERSION))
    for table in protected():
        protect(connection, table.name)
    let_counts_move(connection)
    migrations.stamp(connection)


def protected() -> list[Table]:
    """The tables whose rows are only ever added."""
    return [table for table in metadata.sorted_tables if table.info == ONLY_ADDED]
