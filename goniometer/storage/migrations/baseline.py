"""The tables as revision 0001 has them; frozen, for what a revision leads to never changes afterwards."""

from sqlalchemy import (
    Boolean,
    CheckConstraint,
    Column,
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
)

metadata = MetaData()
_ONLY_ADDED = {"only_added": True}

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
)

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
    Index("exposures_of_scan", "scan_id"),
    info=_ONLY_ADDED,
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
    Column("arrays", LargeBinary, nullable=False),
    CheckConstraint("kind IN ('measured', 'simulated', 'imported')"),
    info=_ONLY_ADDED,
)

fits = Table(
    "fits",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("dataset_id", ForeignKey("datasets.id"), nullable=False),
    Column("model", String, nullable=False),
    Column("json", Text, nullable=False),
    Column("software_version", String, nullable=False),
    Column("created", String, nullable=False),
    info=_ONLY_ADDED,
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
    info=_ONLY_ADDED,
)

characterisations = Table(
    "characterisations",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("kind", String, nullable=False),
    Column("json", Text, nullable=False),
    Column("software_version", String, nullable=False),
    Column("created", String, nullable=False),
    info=_ONLY_ADDED,
)

_ROLES = "role IN ('viewer', 'operator', 'metrologist', 'admin')"

users = Table(
    "users",
    metadata,
    Column("name", String, primary_key=True),
    Column("role", String, nullable=False),
    Column("password", String),
    Column("disabled", Boolean, nullable=False, default=False),
    Column("created", String, nullable=False),
    CheckConstraint(_ROLES),
)

tokens = Table(
    "tokens",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("user", ForeignKey("users.name", ondelete="CASCADE"), nullable=False),
    Column("label", String, nullable=False),
    Column("role", String, nullable=False),
    Column("hash", String, nullable=False, unique=True),
    Column("created", String, nullable=False),
    Column("expires", String),
    Column("used", String),
    CheckConstraint(_ROLES),
    sqlite_autoincrement=True,
)

sessions = Table(
    "sessions",
    metadata,
    Column("hash", String, primary_key=True),
    Column("user", ForeignKey("users.name", ondelete="CASCADE"), nullable=False),
    Column("token_id", ForeignKey("tokens.id", ondelete="CASCADE")),
    Column("created", String, nullable=False),
    Column("used", String, nullable=False),
)

logins = Table(
    "logins",
    metadata,
    Column("name", String, primary_key=True),
    Column("address", String, primary_key=True),
    Column("failures", Integer, nullable=False, default=0),
    Column("failed", Float, nullable=False, default=0.0),
    Column("succeeded", Float, nullable=False, default=0.0),
    Index("logins_of_address", "address"),
)

log = Table(
    "log",
    metadata,
    Column("sequence", Integer, primary_key=True),
    Column("time", String, nullable=False),
    Column("who", String, nullable=False),
    Column("via", String, nullable=False),
    Column("action", String, nullable=False),
    Column("about", Text, nullable=False),
    Column("previous", String, nullable=False),
    Column("hash", String, nullable=False, unique=True),
    CheckConstraint("via IN ('session', 'token', 'cli', 'service', 'nobody')"),
    sqlite_autoincrement=True,
    info=_ONLY_ADDED,
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("kind", String, nullable=False),
    Column("who", String, nullable=False),
    Column("state", String, nullable=False),
    Column("share", Float),
    Column("words", Text, nullable=False, default=""),
    Column("reason", Text, nullable=False, default=""),
    Column("runner", String, nullable=False),
    Column("beat", Float, nullable=False),
    Column("created", String, nullable=False),
    Column("started", String),
    Column("finished", String),
    Column("arguments", Text, nullable=False),
    Column("result", Text),
    Column("page", Text),
    CheckConstraint("state IN ('waiting', 'running', 'done', 'failed', 'cancelled', 'interrupted')"),
    Index("jobs_by_state", "state"),
    sqlite_autoincrement=True,
)

certificates = Table(
    "certificates",
    metadata,
    Column("sha256", String, primary_key=True),
    Column("name", String, nullable=False),
    Column("text", Text, nullable=False),
    Column("who", String, nullable=False),
    Column("created", String, nullable=False),
    info=_ONLY_ADDED,
)

lease = Table(
    "lease",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("term", Integer, nullable=False),
    Column("beat", Integer, nullable=False),
    Column("holder", String),
    Column("host", String, nullable=False),
    Column("process", Integer, nullable=False),
    Column("url", String, nullable=False),
    Column("taken", String, nullable=False),
    Column("stop", Boolean, nullable=False, default=False),
    CheckConstraint("id = 1"),
)

queue = Table(
    "queue",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("position", Integer, nullable=False),
    Column("name", String, nullable=False),
    Column("json", Text, nullable=False),
    Column("campaign_id", ForeignKey("campaigns.id", ondelete="SET NULL")),
    Column("phase", String, nullable=False),
    Column("outcome", String),
    Column("reason", Text, nullable=False, default=""),
    Column("who", String, nullable=False),
    Column("start_after", String),
    Column("created", String, nullable=False),
    Column("ordered", String),
    Column("started", String),
    Column("finished", String),
    CheckConstraint("phase IN ('idle', 'queued', 'running', 'finished')"),
    CheckConstraint("outcome IN ('completed', 'aborted', 'failed')"),
    CheckConstraint("(phase = 'finished') = (outcome IS NOT NULL)"),
    Index("queue_of_phase", "phase"),
    sqlite_autoincrement=True,
)
