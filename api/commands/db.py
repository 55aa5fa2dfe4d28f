"""The commands that keep the database: what is in it is neither lost nor left behind."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.arguments import DATABASE, AsJson, emit, existing
from api.commands.logged import Logged, account
from api.terminal import stdout
from goniometer.errors import InputError, StoreOutdated

if TYPE_CHECKING:
    from goniometer.storage.store import Store
    from goniometer.upkeep.archiving import Moved
    from goniometer.upkeep.integrity import Findings

db = typer.Typer(help="Keep the database: back it up, restore, check, upgrade and archive it.", rich_markup_mode=None)
TheDatabase = Annotated[str, typer.Argument(help="SQLite file, or URL of a PostgreSQL database.", metavar="[DATABASE]")]
OfDatabase = Annotated[str, typer.Option("--database", "-d", help="Its file.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.add_typer(db, name="db")


@db.command(name="backup")
def backup_command(
    target: Annotated[Path, typer.Argument(help="File to write; there must be none.", show_default=False)],
    database: OfDatabase = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Copy the database to a file, also while a campaign runs; the copy is checked before it gets its name."""
    from goniometer.storage.database import Database, shown_place
    from goniometer.upkeep.backup import back_up

    store = Database.as_it_is(database)
    back_up(store, target)
    store.close()
    size = target.stat().st_size
    line = f"{shown_place(database)} is backed up as {target}, {size / 1e6:.1f} MB, and checked."
    _tell({"database": shown_place(database), "backup": str(target), "bytes": size}, [line], as_json=as_json)


@db.command(name="restore")
def restore_command(
    backup: Annotated[Path, typer.Argument(help="File that db backup has written.", show_default=False)],
    database: OfDatabase = DATABASE,
    replace: Annotated[
        bool, typer.Option("--replace", help="In place of the database that is there, which is kept beside it.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Let the database be what a backup holds, once the backup is seen to be whole."""
    from api.access import audit
    from goniometer.storage.database import shown_place
    from goniometer.storage.store import Store
    from goniometer.upkeep.backup import restore

    kept = restore(backup, database, replace=replace)
    lines = [f"{shown_place(database)} is what {backup} holds."]
    if kept is not None:
        lines.append(f"What it was before is kept as {kept}.")
    try:
        store = Store.open(database)
        about = {"backup": str(backup), "kept": None if kept is None else str(kept)}
        audit.record(store, account(), "db restore", about, "cli")
        store.close()
        current = True
    except StoreOutdated as error:
        lines.append(f"{error}.")
        current = False
    found = {"database": shown_place(database), "backup": str(backup), "kept": kept and str(kept), "current": current}
    _tell(found, lines, as_json=as_json)


@db.command(name="check")
def check_command(database: TheDatabase = DATABASE, as_json: AsJson = False) -> None:
    """Read the whole database and say in one line each what is wrong."""
    from goniometer.storage.database import shown_place

    found = examine(database)
    lines = [f"{fault}." for fault in found.faults] or [
        f"{shown_place(database)} is whole: {found.exposures} raw exposures are as they were written, "
        f"{found.datasets} datasets know what they were made of, and the log is complete."
    ]
    _tell(
        {"database": shown_place(database), "whole": not found.faults, **dataclasses.asdict(found)},
        lines,
        as_json=as_json,
    )
    if found.faults:
        raise typer.Exit(1)


@db.command(name="upgrade", cls=Logged)
def upgrade_command(database: TheDatabase = DATABASE, as_json: AsJson = False) -> None:
    """Bring the database of an older version to this one: all of it or nothing, after a backup beside it."""
    from goniometer.storage.database import shown_place
    from goniometer.upkeep.upgrade import upgrade

    done = upgrade(database)
    lines = done.steps or [f"{shown_place(database)} is of this version already."]
    if done.backup is not None:
        lines = [f"Backed up as {done.backup}.", *lines]
    found = {"database": shown_place(database), "steps": done.steps, "backup": done.backup and str(done.backup)}
    _tell(found, lines, as_json=as_json)


@db.command(name="archive", cls=Logged)
def archive_command(
    folder: Annotated[Path, typer.Option("--to", help="Folder for the files; it must be there.", show_default=False)],
    scan: Annotated[list[int] | None, typer.Option(help="Number of a scan; may be repeated.")] = None,
    before: Annotated[
        datetime | None, typer.Option(formats=["%Y-%m-%d"], help="All scans that ended before this day, UTC.")
    ] = None,
    database: OfDatabase = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Move raw counts of finished scans to HDF5 files, one a scan, from which they are read on as before."""
    from goniometer.upkeep.archiving import archive_scan, finished_before

    store = existing(database)
    if (scan is None) == (before is None):
        raise InputError("Say --scan or --before; the one names scans, the other a day")
    chosen = scan if before is None else finished_before(store, before.strftime("%Y-%m-%d"))
    moved = [archive_scan(store, number, folder) for number in chosen or []]
    _tell_moved(store, moved, as_json=as_json)


@db.command(name="unarchive", cls=Logged)
def unarchive_command(
    scan: Annotated[list[int], typer.Option(help="Number of a scan; may be repeated.", show_default=False)],
    database: OfDatabase = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Bring raw counts back into the database; their files are left where they are."""
    from goniometer.upkeep.archiving import unarchive_scan

    store = existing(database)
    _tell_moved(store, [unarchive_scan(store, number) for number in scan], as_json=as_json)


def _tell_moved(store: Store, moved: list[Moved], *, as_json: bool) -> None:
    from goniometer.upkeep.archiving import give_back

    smaller = give_back(store)
    freed, written = sum(each.freed for each in moved), sum(each.octets for each in moved)
    lines = [f"Scan {each.scan_id}: {each.path}, {each.octets / 1e6:.1f} MB." for each in moved]
    if freed < 0:
        lines.append(f"{-freed / 1e6:.1f} MB are in the database again; nothing needs these files any more.")
    else:
        how = f"which is {smaller / 1e6:.1f} MB smaller" if smaller else "where there is room for what comes next"
        told = f"{freed / 1e6:.1f} MB of raw counts left the database, {how}; the files have {written / 1e6:.1f} MB."
        lines.append(told if freed else "No raw counts left the database.")
    found = {"scans": [dataclasses.asdict(each) for each in moved], "freed": freed, "file_smaller_by": smaller}
    _tell(found, lines, as_json=as_json)


def examine(where: str) -> Findings:
    """Everything that is wrong with a database, the log of who did what included."""
    from api.access import audit
    from goniometer.storage.database import Database
    from goniometer.upkeep.integrity import check

    database = Database.as_it_is(where)
    try:
        found = check(database)
        if not found.complete:
            return found
        fault = audit.verify(database).fault
        return found if fault is None else dataclasses.replace(found, faults=[*found.faults, fault])
    finally:
        database.close()


def _tell(found: dict[str, Any], lines: list[str], *, as_json: bool) -> None:
    if as_json:
        emit(found)
        return
    out = stdout()
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
