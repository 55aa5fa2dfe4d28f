"""The tables of the service: who may use it, who did what, who drives the bench, what it shall measure, and what is
worked at.

users 1-n tokens 1-n sessions; a session that began with a password belongs to no token. Secrets are kept as hashes
only. The log names people in words, so that it outlives them. The lease has one row a bench; an entry of the queue
holds its campaign as it was ordered, and the id of the one that was begun from it. A job names what it was asked for;
certificates are those that somebody handed in.
"""

from sqlalchemy import Boolean, CheckConstraint, Column, Float, ForeignKey, Index, Integer, String, Table, Text

from goniometer.storage.tables import BENCH, ONLY_ADDED, metadata

_ROLES = "role IN ('viewer', 'operator', 'metrologist', 'admin')"

users = Table(
    "users",
    metadata,
    Column("name", String, primary_key=True),
    Column("role", String, nullable=False),
    Column("password", String),  # as argon2 encodes its hash; null where only tokens open the door
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
    sqlite_autoincrement=True,  # the log names tokens by their number
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
    Column("failed", Float, nullable=False, default=0.0),  # seconds since 1970
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
    sqlite_autoincrement=True,  # so that SQLite remembers the highest number there ever was
    info=ONLY_ADDED,
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("kind", String, nullable=False),
    Column("who", String, nullable=False),
    Column("state", String, nullable=False),
    Column("share", Float),  # of the work that is done
    Column("words", Text, nullable=False, default=""),
    Column("reason", Text, nullable=False, default=""),
    Column("fault", String),  # what a program calls the reason, where it failed
    Column("runner", String, nullable=False),  # the process that answers for it
    Column("beat", Float, nullable=False),  # when that process was last known to live, seconds since 1970
    Column("created", String, nullable=False),
    Column("started", String),
    Column("finished", String),
    Column("arguments", Text, nullable=False),
    # what is large stands last, for SQLite reads a row from its front
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
    info=ONLY_ADDED,
)

lease = Table(
    "lease",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("term", Integer, nullable=False),
    Column("beat", Integer, nullable=False),
    Column("holder", String),  # null where nobody drives
    Column("host", String, nullable=False),
    Column("process", Integer, nullable=False),
    Column("url", String, nullable=False),
    Column("taken", String, nullable=False),
    Column("stop", Boolean, nullable=False, default=False),
    Column("bench", String, nullable=False, unique=True, server_default=BENCH),
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
    Column("bench", String, nullable=False, server_default=BENCH),
    CheckConstraint("phase IN ('idle', 'queued', 'running', 'finished')"),
    CheckConstraint("outcome IN ('completed', 'aborted', 'failed')"),
    CheckConstraint("(phase = 'finished') = (outcome IS NOT NULL)"),
    Index("queue_of_phase", "phase"),
    Index("queue_of_campaign", "campaign_id"),
    sqlite_autoincrement=True,  # the log names entries by their number
)
