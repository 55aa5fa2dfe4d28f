"""Who may use the service: people with a name, a role and a password.

A viewer reads; an operator also runs the bench and the analyses; a metrologist also answers for certificates and
characterisations; an admin also says who may. Each role may do all that those before it may. Passwords are kept as
argon2id hashes (RFC 9106), never as they are.
"""

import re
from dataclasses import dataclass
from functools import cache

from argon2 import PasswordHasher
from argon2.exceptions import VerifyMismatchError
from sqlalchemy import Connection, delete, insert, select, update

from api.bodies.access import LONGEST_PASSWORD
from api.choices import ROLES, Role
from goniometer.errors import InputError, NotInStore
from goniometer.storage.database import Database
from goniometer.storage.records import now
from goniometer.storage.service_tables import sessions, users

SHORTEST_PASSWORD = 10
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


@dataclass(frozen=True)
class User:
    """Somebody who may use the service."""

    name: str
    role: Role
    disabled: bool
    """Known, but not let in."""
    has_password: bool
    """Without one, only tokens let them in."""
    created: str
    """ISO 8601, UTC."""


def at_least(role: Role, wanted: Role) -> bool:
    """Whether `role` may do all that `wanted` may.

    >>> at_least("operator", "viewer"), at_least("operator", "admin")
    (True, False)
    """
    return ROLES.index(role) >= ROLES.index(wanted)


def lower(one: Role, other: Role) -> Role:
    """The one of two roles that may less."""
    return min(one, other, key=ROLES.index)


def add_user(database: Database, name: str, role: Role, password: str | None) -> User:
    """Let somebody in; None for a user whom only tokens let in.

    Raises `InputError` for a name that is taken or cannot be one, and for a password that is too short or too long.
    """
    if not _NAME.fullmatch(name):
        told = 'take up to 64 lower-case letters, digits, ".", "_" and "-", a letter or digit first'
        raise InputError(f'"{name[:64]}" cannot be the name of a user; {told}')
    hashed = None if password is None else _hashed(password)
    with database.alone() as connection:
        if connection.execute(select(users.c.name).where(users.c.name == name)).first() is not None:
            raise InputError(f"There is a user {name} already; take another name, or change the role or the password")
        made = {"name": name, "role": role, "password": hashed, "disabled": False, "created": now()}
        connection.execute(insert(users).values(**made))
    return user(database, name)


def user(database: Database, name: str) -> User:
    """One user; raises `NotInStore`."""
    for each in all_users(database):
        if each.name == name:
            return each
    raise NotInStore(f"There is no user {name}; list them with: goniometer user list")


def all_users(database: Database) -> list[User]:
    """Everybody who is known, by name."""
    rows = sorted(database.rows(select(users)), key=lambda row: row.name)  # a database sorts as its locale does
    return [User(row.name, row.role, row.disabled, row.password is not None, row.created) for row in rows]


def set_role(database: Database, name: str, role: Role) -> None:
    """Give somebody another role, at once; raises `NotInStore`, and `InputError` where no admin would be left."""
    with database.alone() as connection:
        _check_there(connection, name)
        if role != "admin":
            _check_not_last_admin(connection, name)
        connection.execute(update(users).where(users.c.name == name).values(role=role))


def set_disabled(database: Database, name: str, *, disabled: bool) -> None:
    """Keep somebody out, which ends their sessions, or let them in again. Raises as `set_role` does."""
    with database.alone() as connection:
        _check_there(connection, name)
        if disabled:
            _check_not_last_admin(connection, name)
            connection.execute(delete(sessions).where(sessions.c.user == name))
        connection.execute(update(users).where(users.c.name == name).values(disabled=disabled))


def set_password(database: Database, name: str, password: str) -> None:
    """Give somebody another password, which ends their sessions; raises `NotInStore`, `InputError` as `add_user`."""
    hashed = _hashed(password)
    with database.alone() as connection:
        _check_there(connection, name)
        connection.execute(delete(sessions).where(sessions.c.user == name))
        connection.execute(update(users).where(users.c.name == name).values(password=hashed))


def remove_user(database: Database, name: str) -> None:
    """Forget somebody, with their tokens and sessions; raises as `set_role` does."""
    with database.alone() as connection:
        _check_there(connection, name)
        _check_not_last_admin(connection, name)
        connection.execute(delete(users).where(users.c.name == name))


def check_password(database: Database, name: str, password: str) -> User | None:
    """The user whose name and password these are, None where they are nobody's.

    It takes as long for a name that nobody has. A hash made with other parameters than today's is made anew.
    """
    found = database.rows(select(users.c.password).where(users.c.name == name, ~users.c.disabled))
    stored = None if not found else found[0].password
    if not _matches(stored or _nobodys(), password[:LONGEST_PASSWORD]) or stored is None:
        return None
    if PasswordHasher().check_needs_rehash(stored):
        mine = (users.c.name == name) & (users.c.password == stored)
        with database.writing() as connection:
            connection.execute(update(users).where(mine).values(password=PasswordHasher().hash(password)))
    return user(database, name)


def _hashed(password: str) -> str:
    if not SHORTEST_PASSWORD <= len(password) <= LONGEST_PASSWORD:
        raise InputError(f"The password has {len(password)} characters; take {SHORTEST_PASSWORD} to {LONGEST_PASSWORD}")
    return PasswordHasher().hash(password)


@cache
def _nobodys() -> str:
    """A hash to try in vain, for names that nobody has."""
    return PasswordHasher().hash("")


def _matches(stored: str, password: str) -> bool:
    try:
        return PasswordHasher().verify(stored, password)
    except VerifyMismatchError:
        return False


def _check_there(connection: Connection, name: str) -> None:
    if connection.execute(select(users.c.name).where(users.c.name == name)).first() is None:
        raise NotInStore(f"There is no user {name}; list them with: goniometer user list")


def _check_not_last_admin(connection: Connection, name: str) -> None:
    admins = connection.execute(select(users.c.name).where(users.c.role == "admin", ~users.c.disabled)).scalars().all()
    if list(admins) == [name]:
        raise InputError(f"{name} is the only admin; make somebody else one first")
