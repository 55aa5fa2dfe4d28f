"""`goniometer stability`: where fits converge, degrade and break, and whether they say so."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.arguments import AsJson, Page, emit, write_page
from api.terminal import stderr, stdout
from simulators.choices import ABOUT, METHODS

if TYPE_CHECKING:
    from simulators.stability.ensemble import Cell
    from simulators.stability.stability import Run

_LEVEL, _CELL = 36, 11
"""Characters of a column of the map."""


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="stability")(stability)


def stability(
    context: typer.Context,
    regime: Annotated[
        list[str] | None, typer.Option(help=f"Only this; may be repeated: {'; '.join(ABOUT)}.", show_default=False)
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help=f"Only this; may be repeated: {'; '.join(METHODS)}.", show_default=False)
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Measurements of every cell of the map.")] = 5,
    resume: Annotated[
        Path | None,
        typer.Option(help="File (JSON lines) that keeps all runs; what it holds is not made again."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes here; without it one for each processor.")
    ] = None,
    path: Page = None,
    as_json: AsJson = False,
) -> None:
    """Fit difficult measurements of known truth with every method, and draw the map of what fails and what says so."""
    from rich.progress import track

    from api.executor import processes
    from api.results.stability import TITLE, stability_body, stability_content
    from simulators.stability.ensemble import cells, ensemble, jobs

    wanted = jobs(regime or list(ABOUT), method or list(METHODS), runs)
    with processes(context.obj, workers) as executor:
        made = ensemble(wanted, executor, resume)
        found = list(track(made, "Fitting", len(wanted), console=stderr(), disable=not stderr().is_terminal))
    made_cells = cells(found)
    silent = [each for each in found if each.silent]
    written = None if path is None else write_page(path, TITLE, stability_body(made_cells, silent)).path
    if as_json:
        emit(stability_content(made_cells, found) | {"path": None if written is None else str(written)})
    else:
        _tell(made_cells, silent, written)
    if silent:
        raise typer.Exit(1)


def _tell(found: list[Cell], silent: list[Run], written: Path | None) -> None:
    from api.results.stability import HOW_TO_READ, rows_of, silent_line

    out = stdout()
    methods = [name for name in METHODS if any(cell.method == name for cell in found)]
    rows = rows_of(found)
    lines = [f"{'':{_LEVEL}}" + "".join(f"{number:>{_CELL}}" for number, _ in enumerate(methods, start=1))]
    for regime, group in groupby(rows, key=lambda row: row[0][0]):
        lines.append(regime)
        for (_, level), row in group:
            shown = "".join(f"{_shown(row[name]) if name in row else '':>{_CELL}}" for name in methods)
            lines.append(f"  {level:{_LEVEL - 2}}{shown}")
    lines += [f"{number} {name}" for number, name in enumerate(methods, start=1)]
    lines.append(f"{HOW_TO_READ}; x: how many failed and did not say so.")
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    for each in silent:
        out.print(f"Silent: {silent_line(each)}", markup=False, highlight=False, soft_wrap=True)
    if not silent:
        count = sum(cell.runs for cell in found)
        out.print(
            f"None of {count} fits is wrong by more than five standard errors under a good verdict.", highlight=False
        )
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def _shown(cell: Cell) -> str:
    from api.results.stability import percent

    text = f"{percent(cell.right)}/{percent(cell.trusted)}"
    return f"x{cell.silent} {text}" if cell.silent else text
