"""The tables of the service: who may use it, and who did what.

users 1-n tokens 1-n sessions; a session that began with a password belongs to no token. Secrets are kept as hashes
only. The log names people in words, so that it outlives them.
"""

from sqlalchemy import Boolean, CheckConstraint, Column, Float, ForeignKey, Index, Integer, String, Table, Text

from goniometer.tables import ONLY_ADDED, metadata

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
