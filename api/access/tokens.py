"""Tokens, with which scripts use the service in somebody's name, and sessions, with which browsers do.

Both are 256 random bits. The database keeps their SHA-256 only: nobody can guess what has so many bits, so that a slow
hash would protect nothing more. A session ends when it was idle, when it is old, and with the password, the token or
the person that began it.
"""

import hashlib
import hmac
import logging
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from sqlalchemy import Row, Update, bindparam, delete, select, update

from api.access.accounts import add_user, all_users, at_least, lower, user
from api.choices import FIRST_USER, Role
from goniometer.errors import InputError, NotInStore, StoreError
from goniometer.storage.database import Database, insert_row
from goniometer.storage.records import now
from goniometer.storage.service_tables import sessions, tokens, users

PREFIX = "gonio_"
"""Begins every token, so that one can be recognised where it should not be."""
IDLE = timedelta(hours=12)
OLD = timedelta(days=7)
log = logging.getLogger(__name__)
_NOTED = timedelta(minutes=1)
"""How exactly the last use of a token or session is known; noting every use would write for every reading."""

# Built once, because every request of the service asks one of these.
_OF_TOKEN = (
    select(tokens, users.c.role.label("owner_role"))
    .join(users)
    .where(tokens.c.hash == bindparam("hash"), ~users.c.disabled)
)
_OF_SESSION = (
    select(sessions, users.c.role, tokens.c.role.label("token_role"), tokens.c.expires)
    .join(users, users.c.name == sessions.c.user)
    .outerjoin(tokens, tokens.c.id == sessions.c.token_id)
    .where(sessions.c.hash == bindparam("hash"), ~users.c.disabled)
)


@dataclass(frozen=True)
class Token:
    """What is known of a token; not the token itself, which only who made it has seen."""

    id: int
    user: str
    label: str
    """What it is for, in its owner's words."""
    role: Role
    """It may do no more than this, and no more than its owner."""
    created: str
    """ISO 8601, UTC, as all times here."""
    expires: str | None
    """None: never."""
    used: str | None
    """When it was last used, to a minute; None: never."""


@dataclass(frozen=True)
class Caller:
    """Who asks the service for something."""

    name: str
    role: Role
    """What they may do now, with what they have shown."""
    via: Literal["session", "token"] = "session"
    token_id: int | None = None
    """Of the token they have shown, or with which their session began."""


def create_token(
    database: Database, owner: str, label: str, role: Role | None = None, expires: datetime | None = None
) -> tuple[str, Token]:
    """A new token of somebody and what is known of it; by default with their role, and for ever.

    Raises `NotInStore` for an unknown owner, `InputError` for a role above theirs.
    """
    owns = user(database, owner)
    role = role or owns.role
    if not at_least(owns.role, role):
        raise InputError(f"A token of {owner} cannot have the role {role}; give it {owns.role} or a lower one")
    text = PREFIX + secrets.token_urlsafe(32)
    with database.writing() as connection:
        made = insert_row(
            connection,
            tokens,
            user=owner,
            label=label,
            role=role,
            hash=_digest(text),
            created=now(),
            expires=None if expires is None else _text_of(expires),
        )
    return text, token(database, made)


def ensure_first_user(database: Database) -> bool:
    """Where nobody may use the service yet, let in an admin called "local", whom only tokens let in; whether it did."""
    if all_users(database):
        return False
    add_user(database, FIRST_USER, "admin", None)
    return True


def first_token(database: Database) -> str | None:
    """Where nobody may use the service yet: a token of a new admin; else None."""
    if not ensure_first_user(database):
        return None
    return create_token(database, FIRST_USER, "made at the first start")[0]


def token(database: Database, token_id: int) -> Token:
    """One token; raises `NotInStore`."""
    found = database.rows(select(tokens).where(tokens.c.id == token_id))
    if not found:
        raise NotInStore(f"There is no token {token_id}; list them with: goniometer token list")
    return _to_token(found[0])


def all_tokens(database: Database, owner: str | None = None) -> list[Token]:
    """All tokens (of one user), oldest first."""
    query = select(tokens).order_by(tokens.c.id)
    return [_to_token(row) for row in database.rows(query if owner is None else query.where(tokens.c.user == owner))]


def revoke_token(database: Database, token_id: int) -> None:
    """Make a token worthless and end the sessions that began with it; raises `NotInStore`."""
    token(database, token_id)
    with database.writing() as connection:
        connection.execute(delete(tokens).where(tokens.c.id == token_id))


def token_caller(database: Database, text: str) -> Caller | None:
    """Whose token this is; None where it is nobody's, has expired, or its owner is kept out."""
    found = database.rows(_OF_TOKEN, {"hash": _digest(text)})
    if not found or _is_past(found[0].expires):
        return None
    row = found[0]
    if row.used is None or _is_past(row.used, _NOTED):
        _note_use(database, update(tokens).where(tokens.c.id == row.id))
    return Caller(row.user, lower(row.role, row.owner_role), "token", row.id)


def begin_session(database: Database, name: str, token_id: int | None = None, instead_of: str | None = None) -> str:
    """The secret of a new session of somebody who has shown their password, or this token of theirs.

    It takes the place of the one that their browser had before.
    """
    secret = secrets.token_urlsafe(32)
    oldest, stale = (_text_of(datetime.now(UTC) - age) for age in (OLD, IDLE))
    with database.writing() as connection:
        over = (
            (sessions.c.created < oldest) | (sessions.c.used < stale) | (sessions.c.hash == _digest(instead_of or ""))
        )
        connection.execute(delete(sessions).where(over))
        row = {"hash": _digest(secret), "user": name, "token_id": token_id, "created": now(), "used": now()}
        connection.execute(sessions.insert().values(**row))
    return secret


def session_caller(database: Database, secret: str) -> Caller | None:
    """Whose session this is; None where it is nobody's or has ended."""
    found = database.rows(_OF_SESSION, {"hash": _digest(secret)})
    if not found:
        return None
    row = found[0]
    if _is_past(row.used, IDLE) or _is_past(row.created, OLD) or _is_past(row.expires):
        return None
    if _is_past(row.used, _NOTED):
        _note_use(database, update(sessions).where(sessions.c.hash == row.hash))
    return Caller(row.user, lower(row.role, row.token_role or row.role), "session", row.token_id)


@dataclass(frozen=True)
class Session:
    """A browser in which somebody is logged in."""

    id: str
    """Tells it from others, and opens nothing."""
    created: str
    """ISO 8601, UTC, as all times here."""
    used: str
    """To a minute or so."""
    token_id: int | None
    """The token that it began with; None for a password."""


def sessions_of(database: Database, name: str) -> list[Session]:
    """The sessions of somebody that have not ended, newest first."""
    here = sessions.c
    rows = database.rows(select(sessions).where(here.user == name).order_by(here.created.desc()))
    return [
        Session(_session_id(row.hash), row.created, row.used, row.token_id)
        for row in rows
        if not _is_past(row.used, IDLE) and not _is_past(row.created, OLD)
    ]


def session_of(secret: str) -> str:
    """The id of the session with this secret."""
    return _session_id(_digest(secret))


def _session_id(digest: str) -> str:
    return digest[:16]


def end_sessions(database: Database, name: str, number: str) -> None:
    """End the session of somebody that has this id; raises `NotInStore`."""
    with database.writing() as connection:
        mine = (sessions.c.user == name) & sessions.c.hash.startswith(number, autoescape=True)
        ended = connection.execute(delete(sessions).where(mine)).rowcount
    if not ended:
        raise NotInStore(f"{name} has no session {number}; list them with GET /api/me/sessions")


def end_session(database: Database, secret: str) -> None:
    """Let nobody in with this session any more."""
    with database.writing() as connection:
        connection.execute(delete(sessions).where(sessions.c.hash == _digest(secret)))


def csrf_token(secret: str) -> str:
    """What a page must send in X-CSRF-Token with the session `secret`; another site's page cannot know it."""
    return hmac.new(secret.encode(), b"goniometer csrf", hashlib.sha256).hexdigest()


def _note_use(database: Database, which: Update) -> None:
    try:
        with database.writing() as connection:
            connection.execute(which.values(used=now()))
    except StoreError:  # who wants to stop the bench must be let in when the disk is full, too
        log.exception("The last use of a token or session is not noted")


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _is_past(time: str | None, age: timedelta = timedelta(0)) -> bool:
    """Whether this time, and then `age`, have passed."""
    return time is not None and datetime.fromisoformat(time) + age <= datetime.now(UTC)


def _text_of(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds")


def _to_token(row: Row[Any]) -> Token:
    return Token(row.id, row.user, row.label, row.role, row.created, row.expires, row.used)
