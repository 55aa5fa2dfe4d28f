"""The command that writes a dataset in a format of others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import BRDF_MODELS, USUAL_COLOUR_ERROR, USUAL_ERROR
from api.choices import WRITTEN
from api.commands.arguments import DATABASE, AsJson, DatabaseFile, DatasetName, chosen_dataset, emit, existing
from api.commands.logged import Logged
from api.terminal import stdout

if TYPE_CHECKING:
    from api.written import Export

_ABOUT = "; ".join(f"{name}: {about}" for name, about in WRITTEN.items())


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="export", cls=Logged)(export)


def export(
    dataset: DatasetName,
    to: Annotated[str, typer.Option(help=f"{_ABOUT}.", show_default=False)],
    path: Annotated[Path | None, typer.Option("--output", "-o", help="File to write.")] = None,
    raw: Annotated[bool, typer.Option("--raw", help="hdf5: with all raw exposures.")] = False,
    about: Annotated[
        Path | None,
        typer.Option(help="bird, package: YAML file with the keys provenance, license, sample, environment, ..."),
    ] = None,
    license_: Annotated[str | None, typer.Option("--license", help="package: SPDX identifier, e.g. CC-BY-4.0.")] = None,
    creator: Annotated[
        list[str] | None,
        typer.Option(help='package: who made the data, "Family, Given" or an organisation; may be repeated.'),
    ] = None,
    attach: Annotated[
        list[Path] | None,
        typer.Option(help="package: photograph, topography or another file of the sample; may be repeated."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help=f"mitsuba: {', '.join(BRDF_MODELS)}; the one fitted last unless given.", show_default=False),
    ] = None,
    budget: Annotated[
        float, typer.Option(min=1e-4, max=1, help="mitsuba: relative error that 99 of 100 directions may have.")
    ] = USUAL_ERROR,
    colour_budget: Annotated[
        float, typer.Option(min=0.01, help="mitsuba: dE00 that 99 of 100 directions may have.")
    ] = USUAL_COLOUR_ERROR,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Write a dataset, its fits, or its fitted model for a renderer, to a file."""
    from api.exports.formats import Options, export_dataset

    store = existing(database)
    said = Options(
        raw=raw,
        license=license_,
        creators=tuple(creator or ()),
        attached=tuple(attach or ()),
        about=about,
        model=model,
        budget=budget,
        colour_budget=colour_budget,
    )
    tell_export(export_dataset(store, chosen_dataset(store, dataset), to, path, said), as_json=as_json)


def tell_export(written: Export, *, as_json: bool) -> None:
    """Say what was written and where."""
    if as_json:
        emit({"format": written.file_format, "path": str(written.path), "sha256": written.sha256} | written.facts)
        return
    out = stdout()
    out.print(f"Wrote {written.path}", markup=False, highlight=False)
    for line in written.notes:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
