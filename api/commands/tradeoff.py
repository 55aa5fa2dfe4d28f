"""`goniometer tradeoff`: charts of speed against accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from api.choices import ChartKind
from api.commands.arguments import DATABASE, AsJson, DatabaseFile, Page, chosen_dataset, emit, existing, write_page
from api.terminal import stderr, stdout

if TYPE_CHECKING:
    from analysis.tradeoff import Chart


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="tradeoff")(tradeoff_command)


def tradeoff_command(
    kinds: Annotated[
        list[ChartKind] | None, typer.Argument(help="What to chart; all without it.", show_default=False)
    ] = None,
    dataset: Annotated[
        str | None, typer.Option(help="Number of a dataset, or name of a sample, to chart instead of the bench's.")
    ] = None,
    sample: Annotated[str, typer.Option(help="Material of the simulated bench, whose truth is known.")] = "sample-4",
    surface: Annotated[str, typer.Option(help="Surface of the simulations, as in goniometer simulate.")] = "sample-1",
    dielectric: Annotated[bool, typer.Option("--dielectric", help="Models: take the ladder of a dielectric.")] = False,
    rounds: Annotated[int, typer.Option(min=1, help="How often everything is timed, with other noise each time.")] = 5,
    page: Page = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Chart speed against accuracy on this machine: scans, fits, models and renderings, simulations."""
    from analysis.tradeoff import charts_json
    from api.results.tradeoff import TITLE, chapters, charts

    own = None
    if dataset is not None:
        store = existing(database)
        own = store.dataset(chosen_dataset(store, dataset))
    found: list[Chart] = []
    for kind in dict.fromkeys(kinds or ChartKind):
        found += charts(kind, own, sample, surface, rounds, _tell, dielectric=dielectric)
    path = None if page is None else str(write_page(page, TITLE, chapters(found)).path)
    if as_json:
        emit({"charts": charts_json(found), "page": path})
        return
    out = stdout()
    for chart in found:
        for line in _lines(chart):
            out.print(line, markup=False, highlight=False, soft_wrap=True)
    if path is not None:
        out.print(f"Wrote {path}", markup=False, highlight=False, soft_wrap=True)


def _tell(words: str) -> None:
    stderr().print(words, style="dim", markup=False, highlight=False)


def _lines(chart: Chart) -> list[str]:
    """A chart as a table for a terminal; those on the front have a star."""
    lines = [chart.title, f"  {chart.cost.label:>24}  {chart.error.label}"]
    for index in sorted(range(len(chart.choices)), key=lambda i: chart.choices[i].cost):
        choice = chart.choices[index]
        star = "*" if index in chart.front else " "
        lines.append(f"{star} {choice.cost:24.4g}  {choice.error:<12.3g} {choice.family}: {choice.name}")
    return lines
