"""The commands that keep the database: what is in it is neither lost nor left behind."""

from typing import Annotated

import typer
from rich.console import Console

from api.arguments import DATABASE, AsJson, emit
from api.logged import Logged
from goniometer.database import shown_place
from goniometer.upgrade import upgrade as upgrade_database

db = typer.Typer(help="Keep the database: back it up, restore, check and upgrade it.")
TheDatabase = Annotated[
    str, typer.Argument(help="SQLite database, or URL of a PostgreSQL one.", metavar="[DATABASE]", show_default=True)
]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.add_typer(db, name="db")


@db.command(cls=Logged)
def upgrade(database: TheDatabase = DATABASE, as_json: AsJson = False) -> None:
    """Bring the database of an older version to this one; it is backed up beside itself first."""
    done = upgrade_database(database)
    if as_json:
        emit(
            {
                "database": shown_place(database),
                "steps": done.steps,
                "backup": None if done.backup is None else str(done.backup),
            }
        )
        return
    lines = [f"{shown_place(database)} is of this version already."] if not done.steps else done.steps
    if done.backup is not None:
        lines = [f"Backed up as {done.backup}.", *lines]
    out = Console()
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
