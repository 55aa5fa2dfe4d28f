"""The command that writes a dataset in a format of others."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from api.arguments import DATABASE, AsJson, DatabaseFile, DatasetName, chosen_dataset, emit, existing
from api.derive import Export
from api.exports import FORMATS, Options, export_dataset

_ABOUT = "; ".join(f"{name}: {each.about}" for name, each in FORMATS.items())


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="export")(export)


def export(
    dataset: DatasetName,
    to: Annotated[str, typer.Option(help=f"{_ABOUT}.", show_default=False)],
    path: Annotated[Path | None, typer.Option("--output", "-o", help="File to write.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Write a dataset, its fits, or its fitted model for a renderer, to a file."""
    store = existing(database)
    tell_export(export_dataset(store, chosen_dataset(store, dataset), to, path, Options()), as_json=as_json)


def tell_export(written: Export, *, as_json: bool) -> None:
    """Say what was written and where."""
    if as_json:
        emit({"format": written.file_format, "path": str(written.path), "sha256": written.sha256} | written.facts)
        return
    out = Console()
    out.print(f"Wrote {written.path}", markup=False, highlight=False)
    for line in written.notes:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
