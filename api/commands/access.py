"""The commands that say who may use the service, and show who did what."""

import sys
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import typer

from api.choices import FIRST_USER, Role
from api.commands.arguments import DATABASE, AsJson, DatabaseFile, emit, existing, opened
from api.commands.logged import Logged
from api.terminal import stdout
from goniometer.errors import InputError

user_app = typer.Typer(help="Who may use the service.", rich_markup_mode=None)
token_app = typer.Typer(help="Tokens, with which scripts use the service in somebody's name.", rich_markup_mode=None)
log_app = typer.Typer(help="Who did what.", rich_markup_mode=None)
Name = Annotated[str, typer.Argument(help="Name of the user.", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.add_typer(user_app, name="user")
    app.add_typer(token_app, name="token")
    app.add_typer(log_app, name="log")


@user_app.command(cls=Logged)
def add(
    name: Name,
    role: Annotated[Role, typer.Option(help="What they may do.")] = "viewer",
    no_password: Annotated[bool, typer.Option("--no-password", help="Only tokens let them in.")] = False,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Let somebody in; asks for a password, or reads it from a pipe."""
    from api.access.accounts import add_user

    store = opened(database)
    password = None if no_password else _new_password(name)
    made = add_user(store, name, role, password)
    _tell(asdict(made), f"{name} may use the service as {role}.", as_json=as_json)


@user_app.command(name="list")
def list_users(database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Everybody who may use the service."""
    from api.access.accounts import all_users

    users = [asdict(user) for user in all_users(existing(database))]
    _tell_table("users", users, as_json=as_json)


@user_app.command(cls=Logged)
def role(
    name: Name,
    role: Annotated[Role, typer.Argument(help="What they may do.", show_default=False)],
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Give somebody another role; it counts at once."""
    from api.access.accounts import set_role

    store = existing(database)
    set_role(store, name, role)
    _tell({"name": name, "role": role}, f"{name} may use the service as {role}.", as_json=as_json)


@user_app.command(cls=Logged)
def password(name: Name, database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Give somebody another password, asked for or read from a pipe; their sessions end."""
    from api.access.accounts import set_password

    store = existing(database)
    set_password(store, name, _new_password(name))
    _tell({"name": name}, f"{name} has another password.", as_json=as_json)


@user_app.command(cls=Logged)
def disable(name: Name, database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Keep somebody out, at once; what they are and their tokens are kept."""
    from api.access.accounts import set_disabled

    store = existing(database)
    set_disabled(store, name, disabled=True)
    _tell({"name": name, "disabled": True}, f"{name} is kept out.", as_json=as_json)


@user_app.command(cls=Logged)
def enable(name: Name, database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Let somebody in again who was kept out."""
    from api.access.accounts import set_disabled

    store = existing(database)
    set_disabled(store, name, disabled=False)
    _tell({"name": name, "disabled": False}, f"{name} is let in again.", as_json=as_json)


@user_app.command(cls=Logged)
def remove(name: Name, database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Forget somebody, with their tokens and sessions; the log keeps their name."""
    from api.access.accounts import remove_user

    store = existing(database)
    remove_user(store, name)
    _tell({"name": name, "removed": True}, f"{name} is forgotten.", as_json=as_json)


@token_app.command(cls=Logged)
def create(
    context: typer.Context,
    label: Annotated[str, typer.Argument(help="What it is for.")] = "made at the command line",
    user: Annotated[str, typer.Option(help="In whose name it works.")] = FIRST_USER,
    role: Annotated[Role | None, typer.Option(help="It may do no more than this; without it, what they may.")] = None,
    days: Annotated[float | None, typer.Option(min=0, max=36500, help="For which it holds; without it, ever.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Make a token; it is shown only now."""
    from api.access.tokens import create_token, ensure_first_user

    store = opened(database)
    ensure_first_user(store)
    expires = None if days is None else datetime.now(UTC) + timedelta(days=days)
    text, made = create_token(store, user, label, role, expires)
    context.meta["log number"] = made.id
    if as_json:
        emit(asdict(made) | {"token": text})
    else:
        stdout().print(text, markup=False, highlight=False, soft_wrap=True)


@token_app.command(name="list")
def list_tokens(database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Everybody's tokens; not what they are, which only who made them has seen."""
    from api.access.tokens import all_tokens

    _tell_table("tokens", [asdict(each) for each in all_tokens(existing(database))], as_json=as_json)


@token_app.command(cls=Logged)
def revoke(
    number: Annotated[int, typer.Argument(help="Number of the token.", show_default=False)],
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Make a token worthless, with the sessions that began with it."""
    from api.access.tokens import revoke_token, token

    store = existing(database)
    owner = token(store, number).user
    revoke_token(store, number)
    _tell({"id": number, "revoked": True}, f"Token {number} of {owner} opens nothing any more.", as_json=as_json)


@log_app.command()
def show(
    count: Annotated[int, typer.Option("--count", "-n", min=1, help="Rows to show.")] = 50,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """The newest rows, newest last."""
    from api.access import audit

    rows = [asdict(entry) for entry in reversed(audit.entries(existing(database), limit=count))]
    if as_json:
        emit({"log": rows})
        return
    out = stdout()
    for row in rows:
        line = f"{row['sequence']} {row['time']} {row['who']} ({row['via']}) {row['action']} {row['about']}"
        # an address that somebody asked for may hold the end of a line
        out.print(line.replace("\n", "\\n"), markup=False, highlight=False, soft_wrap=True)


@log_app.command()
def head(database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """The hash of the last row: noted elsewhere, it shows later that nothing before it was changed or cut off."""
    from api.access import audit

    last = audit.head(existing(database))
    if as_json:
        emit({"head": last})
    else:
        stdout().print(last, highlight=False)


@log_app.command()
def verify(
    head: Annotated[str | None, typer.Option(help="What `log head` said once.", show_default=False)] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Compute all hashes anew: whether a row was changed, removed or inserted since it was written."""
    from api.access import audit

    verdict = audit.verify(existing(database), head)
    told = verdict.fault or f"All {verdict.rows} rows are as they were written; the last hash is {verdict.head}"
    _tell(asdict(verdict), f"{told}.", as_json=as_json)
    if verdict.fault is not None:
        raise typer.Exit(1)


def _new_password(name: str) -> str:
    """What is typed twice, unseen, or the first line of what is piped in; never an argument, which others can see."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\r\n")
    try:
        typed: str = typer.prompt(f"Password of {name}", hide_input=True, err=True)
        again = typer.prompt("Once more", hide_input=True, err=True)
    except typer.Abort:
        raise InputError("No password was typed; run the command again") from None
    if typed != again:
        raise InputError("The two are not alike; run the command again")
    return typed


def _tell(found: dict[str, Any], line: str, *, as_json: bool) -> None:
    if as_json:
        emit(found)
    else:
        stdout().print(line, markup=False, highlight=False, soft_wrap=True)


def _tell_table(name: str, rows: list[dict[str, Any]], *, as_json: bool) -> None:
    from rich.table import Table

    if as_json:
        emit({name: rows})
        return
    table = Table(*(rows[0] if rows else ()))
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    stdout().print(table)
