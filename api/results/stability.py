"""The map of where fits converge, degrade and break, and whether they say so: as JSON and as a page."""

import math
from dataclasses import asdict
from html import escape
from itertools import groupby
from typing import Any

from analysis.figures.page import figure
from analysis.figures.stability import MapCell, stability_map
from simulators.choices import METHODS
from simulators.stability.ensemble import Cell
from simulators.stability.regimes import REGIMES
from simulators.stability.stability import Run

TITLE = "Stability of the fits"

HOW_TO_READ = (
    "right / trusted, in per cent: how many came out as near to the truth as is of use (– where nothing has a truth), "
    "and how many have a good verdict"
)


def none_of(found: list[Cell]) -> str:
    """The sentence that no fit failed without a word."""
    count = sum(cell.runs for cell in found)
    return f"None of {count} fits is wrong by more than five standard errors under a good verdict."


def rows_of(found: list[Cell]) -> list[tuple[tuple[str, str], dict[str, Cell]]]:
    """By regime and level, the cells by method."""
    grouped = groupby(found, key=lambda cell: (cell.regime, cell.level))
    return [(key, {cell.method: cell for cell in row}) for key, row in grouped]


def percent(share: float) -> str:
    """A share for a person; a dash where nobody knows it."""
    return "–" if math.isnan(share) else f"{100 * share:.0f}"


def silent_line(each: Run) -> str:
    """A fit that was wrong and did not say so."""
    worst = max(each.z, key=lambda name: abs(each.z[name])) if each.z else None
    off = "says nothing" if worst is None else f"{worst} is off by {each.z[worst]:.1f} standard errors"
    return f"{each.job.regime}, {each.job.level}, {each.job.method}, seed {each.job.seed}: {off}"


def stability_body(found: list[Cell], silent: list[Run]) -> list[str]:
    """The map and all its numbers as chapters of a page."""
    rows = rows_of(found)
    methods = [name for name in METHODS if any(name in row for _, row in rows)]
    shown = {(cell.regime, cell.level, cell.method): _map_cell(cell) for cell in found}
    runs = sum(cell.runs for cell in found)
    told = "".join(f"<li>{escape(silent_line(each))}</li>" for each in silent)
    verdict = (
        f"<p>{len(silent)} of {runs} fits failed without a word:</p><ul>{told}</ul>"
        if silent
        else f"<p>{none_of(found)}</p>"
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
            f"In every cell {escape(HOW_TO_READ)}. Blue: right, orange: not right, grey: without a truth. A cross "
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
            percent(cell.right),
            percent(cell.trusted),
            percent(cell.covered),
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


def stability_content(found: list[Cell], runs: list[Run]) -> dict[str, Any]:
    """The map as JSON content, with all `runs` that it was made of."""
    return {
        "regimes": {each.name: each.about for each in REGIMES.values()},
        "cells": [asdict(cell) for cell in found],
        "silent_failures": [_run(each) for each in runs if each.silent],
        "runs": [_run(each) for each in runs],
    }


def _run(each: Run) -> dict[str, Any]:
    return asdict(each) | {"job": each.job._asdict()}
