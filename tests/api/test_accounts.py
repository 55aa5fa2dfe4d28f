"""Passwords, tokens and sessions: who is let in, and that nobody can read from the database what lets them in."""

import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from argon2 import PasswordHasher, Type
from argon2.low_level import hash_secret, verify_secret

from api.access.accounts import (
    add_user,
    all_users,
    at_least,
    check_password,
    remove_user,
    set_disabled,
    set_password,
    set_role,
)
from api.access.tokens import (
    all_tokens,
    begin_session,
    create_token,
    csrf_token,
    end_session,
    first_token,
    revoke_token,
    session_caller,
    token_caller,
)
from goniometer.errors import InputError, NotInStore
from goniometer.storage.store import Store

PASSWORD = "correct horse battery staple"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "bench.db"


@pytest.fixture
def store(file: Path) -> Iterator[Store]:
    opened = Store.open(file)
    yield opened
    opened.close()


def sql(file: Path, statement: str, *values: object) -> list[tuple[object, ...]]:
    """What a statement finds or does in the database, past this program."""
    with sqlite3.connect(file) as connection:
        found = connection.execute(statement, values).fetchall()
    connection.close()
    return found


def test_a_password_is_kept_as_an_argon2_hash_that_another_verifier_accepts(store: Store, file: Path) -> None:
    add_user(store, "anna", "operator", PASSWORD)
    [(stored,)] = sql(file, "SELECT password FROM users")
    assert isinstance(stored, str)
    assert verify_secret(stored.encode(), PASSWORD.encode(), Type.ID)
    assert check_password(store, "anna", PASSWORD) == all_users(store)[0]
    for name, password in (("anna", PASSWORD + "x"), ("anna", ""), ("bert", PASSWORD), ("anna' OR 1=1 --", PASSWORD)):
        assert check_password(store, name, password) is None


def test_a_hash_of_weaker_parameters_is_replaced_when_its_owner_comes_in(store: Store, file: Path) -> None:
    add_user(store, "anna", "operator", None)
    weak = hash_secret(PASSWORD.encode(), b"saltsaltsalt", 1, 64, 1, 16, Type.ID).decode()
    sql(file, "UPDATE users SET password = ?", weak)
    assert check_password(store, "anna", "wrong") is None
    assert sql(file, "SELECT password FROM users") == [(weak,)]
    assert check_password(store, "anna", PASSWORD) is not None
    [(stored,)] = sql(file, "SELECT password FROM users")
    assert not PasswordHasher().check_needs_rehash(str(stored))
    assert verify_secret(str(stored).encode(), PASSWORD.encode(), Type.ID)


def test_nothing_in_the_database_lets_who_has_copied_it_in(store: Store, file: Path) -> None:
    add_user(store, "anna", "admin", PASSWORD)
    token, _ = create_token(store, "anna", "script")
    session = begin_session(store, "anna")
    store.close()
    content = b"".join(path.read_bytes() for path in file.parent.iterdir())
    assert b"script" in content  # so that what is looked for would be found
    for secret in (PASSWORD, token, token.removeprefix("gonio_"), session, csrf_token(session)):
        assert secret.encode() not in content


@pytest.mark.parametrize("name", ["", "Anna", "an na", "../etc", "-x", "a" * 65, "anna\n", "ann\u00e4", '<b>"'])
def test_a_name_is_one_that_no_page_path_or_header_misreads(store: Store, name: str) -> None:
    with pytest.raises(InputError, match="cannot be the name"):
        add_user(store, name, "viewer", None)


def test_a_short_password_is_refused(store: Store) -> None:
    with pytest.raises(InputError, match="9 characters"):
        add_user(store, "anna", "viewer", "123456789")
    assert all_users(store) == []


def test_the_last_admin_cannot_lock_the_door_behind_themselves(either: Store) -> None:
    add_user(either, "anna", "admin", None)
    add_user(either, "bert", "admin", None)
    set_disabled(either, "bert", disabled=True)
    for last in (lambda: set_role(either, "anna", "viewer"), lambda: remove_user(either, "anna")):
        with pytest.raises(InputError, match="only admin"):
            last()
    with pytest.raises(InputError, match="only admin"):
        set_disabled(either, "anna", disabled=True)
    set_disabled(either, "bert", disabled=False)
    set_role(either, "anna", "viewer")
    assert [user.role for user in all_users(either)] == ["viewer", "admin"]
    with pytest.raises(NotInStore):
        remove_user(either, "carl")


def test_each_role_may_do_what_those_before_it_may() -> None:
    order = ["viewer", "operator", "metrologist", "admin"]
    assert [[at_least(a, b) for b in order] for a in order] == [
        [True, False, False, False],
        [True, True, False, False],
        [True, True, True, False],
        [True, True, True, True],
    ]


def test_a_token_never_may_more_than_its_owner_may_now(either: Store) -> None:
    add_user(either, "root", "admin", None)
    add_user(either, "anna", "metrologist", None)
    with pytest.raises(InputError, match="cannot have the role admin"):
        create_token(either, "anna", "too much", "admin")
    text, _ = create_token(either, "anna", "script", "operator")
    for role, may in (("metrologist", "operator"), ("admin", "operator"), ("viewer", "viewer")):
        set_role(either, "anna", role)
        caller = token_caller(either, text)
        assert caller is not None
        assert (caller.name, caller.role) == ("anna", may)


def test_a_token_ends_by_expiry_revocation_and_with_its_owner(store: Store, file: Path) -> None:
    add_user(store, "root", "admin", None)
    add_user(store, "anna", "viewer", None)
    brief, made = create_token(store, "anna", "brief", expires=datetime.now(UTC) + timedelta(days=1))
    lasting, _ = create_token(store, "anna", "lasting")
    assert made.expires is not None
    assert abs(datetime.fromisoformat(made.expires) - datetime.now(UTC) - timedelta(days=1)) < timedelta(minutes=1)
    assert token_caller(store, brief) is not None
    past = (datetime.now(UTC) - timedelta(seconds=1)).isoformat()
    sql(file, "UPDATE tokens SET expires = ? WHERE id = ?", past, made.id)
    assert token_caller(store, brief) is None
    assert token_caller(store, lasting) is not None
    assert all_tokens(store)[1].used is not None
    set_disabled(store, "anna", disabled=True)
    assert token_caller(store, lasting) is None
    set_disabled(store, "anna", disabled=False)
    assert token_caller(store, lasting) is not None
    revoke_token(store, made.id)
    remove_user(store, "anna")
    assert token_caller(store, lasting) is None
    assert all_tokens(store) == []
    with pytest.raises(NotInStore, match="no token"):
        revoke_token(store, made.id)


@pytest.mark.parametrize(
    ("column", "age", "lives"),
    [
        ("used", timedelta(hours=11), True),
        ("used", timedelta(hours=13), False),
        ("created", timedelta(days=6), True),
        ("created", timedelta(days=8), False),
    ],
)
def test_a_session_ends_when_it_was_idle_or_is_old(
    store: Store, file: Path, column: str, age: timedelta, lives: bool
) -> None:
    add_user(store, "anna", "viewer", None)
    secret = begin_session(store, "anna")
    sql(file, f"UPDATE sessions SET {column} = ?", (datetime.now(UTC) - age).isoformat(timespec="milliseconds"))
    assert (session_caller(store, secret) is not None) is lives
    begin_session(store, "anna")
    assert sql(file, "SELECT count(*) FROM sessions") == [(1 + lives,)]  # what has ended is not kept


def test_a_session_ends_with_the_password_the_token_and_the_person_that_began_it(either: Store) -> None:
    add_user(either, "root", "admin", None)
    add_user(either, "anna", "operator", PASSWORD)
    add_user(either, "bert", "operator", None)
    _, token = create_token(either, "anna", "page", "viewer")
    others = begin_session(either, "bert")
    by_token = begin_session(either, "anna", token.id)
    caller = session_caller(either, by_token)
    assert caller is not None
    assert caller.role == "viewer"
    revoke_token(either, token.id)
    assert session_caller(either, by_token) is None
    first, second = begin_session(either, "anna"), begin_session(either, "anna")
    end_session(either, first)
    assert session_caller(either, first) is None
    assert session_caller(either, second) is not None
    set_password(either, "anna", PASSWORD + "!")
    assert session_caller(either, second) is None
    third = begin_session(either, "anna")
    set_disabled(either, "anna", disabled=True)
    set_disabled(either, "anna", disabled=False)
    assert session_caller(either, third) is None
    assert session_caller(either, others) is not None


def test_the_first_start_lets_somebody_in_and_later_ones_nobody(either: Store) -> None:
    text = first_token(either)
    assert text is not None
    caller = token_caller(either, text)
    assert caller is not None
    assert (caller.name, caller.role) == ("local", "admin")
    assert first_token(either) is None
    assert check_password(either, "local", "") is None
