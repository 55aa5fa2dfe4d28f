"""`goniometer stability`: where fits converge, degrade and break, and whether they say so."""

import math
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track

from analysis.page import figure
from analysis.stability_figure import MapCell, stability_map
from api.arguments import AsJson, emit
from api.derive import end_with_parent
from api.simulations import Page, write_page
from api.terminal import screen
from simulators.ensemble import Cell, cells, ensemble, jobs
from simulators.regimes import REGIMES
from simulators.stability import METHODS, Run

_HOW_TO_READ = (
    "right / trusted, in per cent: how many came out as near to the truth as is of use (– where nothing has a truth), "
    "and how many have a good verdict"
)

_LEVEL, _CELL = 36, 11
"""Characters of a column of the map."""


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="stability")(stability)


def stability(
    regime: Annotated[
        list[str] | None, typer.Option(help=f"Only this; may be repeated: {'; '.join(REGIMES)}.", show_default=False)
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help=f"Only this; may be repeated: {'; '.join(METHODS)}.", show_default=False)
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Measurements of every cell of the map.")] = 5,
    resume: Annotated[
        Path | None,
        typer.Option(help="File (JSON lines) that keeps all runs; what it holds is not made again."),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; without it one for each processor.")] = None,
    path: Page = None,
    as_json: AsJson = False,
) -> None:
    """Fit difficult measurements of known truth with every method, and draw the map of what fails and what says so."""
    wanted = jobs(regime or list(REGIMES), method or list(METHODS), runs)
    with _workers(workers) as executor:
        made = ensemble(wanted, executor, resume)
        found = list(track(made, "Fitting", len(wanted), console=screen, disable=not screen.is_terminal))
    made_cells = cells(found)
    silent = [each for each in found if each.silent]
    written = None if path is None else write_page(path, "Stability of the fits", _page(made_cells, silent)).path
    if as_json:
        emit(
            {
                "regimes": {each.name: each.about for each in REGIMES.values()},
                "cells": [asdict(cell) for cell in made_cells],
                "silent_failures": [asdict(each) for each in silent],
                "path": None if written is None else str(written),
            }
        )
    else:
        _tell(made_cells, silent, written)
    if silent:
        raise typer.Exit(1)


@contextmanager
def _workers(count: int | None) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each: several fits at once do more than one fit on several threads."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context, initializer=end_with_parent) as executor:
        yield executor


def _tell(found: list[Cell], silent: list[Run], written: Path | None) -> None:
    out = Console()
    methods = [name for name in METHODS if any(cell.method == name for cell in found)]
    rows = _rows(found)
    lines = [f"{'':{_LEVEL}}" + "".join(f"{number:>{_CELL}}" for number, _ in enumerate(methods, start=1))]
    for regime, group in groupby(rows, key=lambda row: row[0][0]):
        lines.append(regime)
        for (_, level), row in group:
            shown = "".join(f"{_shown(row[name]) if name in row else '':>{_CELL}}" for name in methods)
            lines.append(f"  {level:{_LEVEL - 2}}{shown}")
    lines += [f"{number} {name}" for number, name in enumerate(methods, start=1)]
    lines.append(f"{_HOW_TO_READ}; x: how many failed and did not say so.")
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    for each in silent:
        out.print(f"Silent: {_silent_line(each)}", markup=False, highlight=False, soft_wrap=True)
    if not silent:
        count = sum(cell.runs for cell in found)
        out.print(
            f"None of {count} fits is wrong by more than five standard errors under a good verdict.", highlight=False
        )
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def _none_of(found: list[Cell]) -> str:
    count = sum(cell.runs for cell in found)
    return f"None of {count} fits is wrong by more than five standard errors under a good verdict."


def _rows(found: list[Cell]) -> list[tuple[tuple[str, str], dict[str, Cell]]]:
    """By regime and level, the cells by method."""
    grouped = groupby(found, key=lambda cell: (cell.regime, cell.level))
    return [(key, {cell.method: cell for cell in row}) for key, row in grouped]


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.0f}"


def _shown(cell: Cell) -> str:
    text = f"{_percent(cell.right)}/{_percent(cell.trusted)}"
    return f"x{cell.silent} {text}" if cell.silent else text


def _silent_line(each: Run) -> str:
    worst = max(each.z, key=lambda name: abs(each.z[name])) if each.z else None
    off = "says nothing" if worst is None else f"{worst} is off by {each.z[worst]:.1f} standard errors"
    return f"{each.job.regime}, {each.job.level}, {each.job.method}, seed {each.job.seed}: {off}"


def _page(found: list[Cell], silent: list[Run]) -> list[str]:
    rows = _rows(found)
    methods = [name for name in METHODS if any(name in row for _, row in rows)]
    shown = {(cell.regime, cell.level, cell.method): _map_cell(cell) for cell in found}
    runs = sum(cell.runs for cell in found)
    told = "".join(f"<li>{escape(_silent_line(each))}</li>" for each in silent)
    verdict = (
        f"<p>{len(silent)} of {runs} fits failed without a word:</p><ul>{told}</ul>"
        if silent
        else f"<p>{_none_of(found)}</p>"
    )
    about = "".join(
        f"<li><strong>{escape(each.name)}</strong>: {escape(each.about)}.</li>"
        for each in REGIMES.values()
        if any(each.name == regime for (regime, _), _ in rows)
    )
    return [
        "<p>Difficult measurements of surfaces whose parameters are known, each made many times with other errors, and "
        "fitted with every method that describes such a surface.</p>",
        verdict,
        figure(
            [stability_map([key for key, _ in rows], methods, shown, "stability")],
            f"In every cell {escape(_HOW_TO_READ)}. Blue: right, orange: not right, grey: without a truth. A cross "
            "with a number in a frame: so many failed and did not say so. Orange with few good verdicts is where a "
            "method breaks and says it. A pointer on a cell shows what the verdicts say.",
        ),
        f"<h2>What is difficult</h2><ul>{about}</ul>",
        _details(found),
    ]


def _map_cell(cell: Cell) -> MapCell:
    parts = [f"{cell.regime}, {cell.level}, {cell.method}: {cell.runs} runs"]
    if not math.isnan(cell.covered):
        parts.append(
            f"{100 * cell.covered:.0f} % of the 95 % intervals hold the truth, worst {cell.worst:.1f} errors off"
        )
    if cell.said:
        parts.append(cell.said)
    return MapCell(cell.right, cell.trusted, cell.silent, ". ".join(part.rstrip(".") for part in parts) + ".")


def _details(found: list[Cell]) -> str:
    """Everything of every cell in a table."""
    head = ("regime", "level", "method", "right", "trusted", "covered", "worst", "bias", "random starts", "mostly said")
    rows = []
    for cell in found:
        bias = ", ".join(f"{name} {value:+.2g}" for name, value in cell.bias.items() if not math.isnan(value))
        starts = "" if math.isnan(cell.reached) else f"{100 * cell.reached:.0f} % reach it"
        lower = f", {cell.lower} end lower" if cell.lower else ""
        values: list[Any] = [
            cell.regime,
            cell.level,
            cell.method,
            _percent(cell.right),
            _percent(cell.trusted),
            _percent(cell.covered),
            f"{cell.worst:.1f}",
            bias,
            starts + lower,
            cell.said,
        ]
        rows.append("<tr>" + "".join(f"<td>{escape(str(value))}</td>" for value in values) + "</tr>")
    return (
        '<h2>All numbers</h2><details><summary>Every cell of the map</summary><div class="wide"><table><thead><tr>'
        + "".join(f"<th>{each}</th>" for each in head)
        + f"</tr></thead><tbody>{''.join(rows)}</tbody><caption>Shares in per cent. Covered: 95 % intervals under a "
        "good verdict that hold the truth. Worst: largest deviation under a good verdict, in standard errors. Bias: "
        "mean of fitted − true. Random starts: how many led downhill to where the fit ended."
        "</caption></table></div></details>"
    )
