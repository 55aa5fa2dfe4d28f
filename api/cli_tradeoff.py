"""`goniometer tradeoff`: charts of speed against accuracy."""

from enum import StrEnum
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from analysis.fresnel import load_conductor
from analysis.tradeoff import Chart, charts_json
from analysis.tradeoff_figure import tradeoff_chapter
from analysis.tradeoff_fits import fit_charts
from analysis.tradeoff_models import model_charts
from api.arguments import DATABASE, AsJson, DatabaseFile, chosen_dataset, emit, existing
from api.choose import mitsuba_is_there
from api.simulations import Page, write_page
from api.terminal import screen
from drivers.arrays import FloatArray
from goniometer.dataset import Dataset
from goniometer.plan_spec import PlanSpec
from simulators.materials import material, true_brdf
from simulators.tabulated import Tabulated
from simulators.tabulated_file import tabulated
from simulators.topography import topography
from simulators.tradeoff_bench import drawn
from simulators.tradeoff_scans import scan_charts
from simulators.tradeoff_simulations import simulation_charts


class Kind(StrEnum):
    """What is charted."""

    SCANS = "scans"
    FITS = "fits"
    MODELS = "models"
    SIMULATIONS = "simulations"


LARGEST_INCIDENT = 80.0
"""Of the scans that are charted, degrees."""

THETA_IN = tuple(float(angle) for angle in range(0, 81, 10))


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="tradeoff")(tradeoff_command)


def tradeoff_command(
    kinds: Annotated[
        list[Kind] | None, typer.Argument(help="What to chart; all without it.", show_default=False)
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
    own = None
    if dataset is not None:
        store = existing(database)
        own = store.dataset(chosen_dataset(store, dataset))
    charts: list[Chart] = []
    for kind in dict.fromkeys(kinds or Kind):
        charts += _charts(kind, own, sample, surface, dielectric, rounds)
    path = None if page is None else str(write_page(page, "Speed against accuracy", _chapters(charts)).path)
    if as_json:
        emit({"charts": charts_json(charts), "page": path})
        return
    out = Console()
    for chart in charts:
        for line in _lines(chart):
            out.print(line, markup=False, highlight=False, soft_wrap=True)
    if path is not None:
        out.print(f"Wrote {path}", markup=False, highlight=False, soft_wrap=True)


def _charts(kind: Kind, own: Dataset | None, sample: str, surface: str, dielectric: bool, rounds: int) -> list[Chart]:
    if kind in {Kind.FITS, Kind.MODELS}:
        datasets, known = ([own], None) if own is not None else drawn(sample, material(sample), rounds)
        if kind is Kind.MODELS:
            return model_charts(datasets[0], load_conductor(), dielectric, rounds, _tell, rendering=mitsuba_is_there())
        return fit_charts(datasets, load_conductor(), known, rounds, _tell)
    if kind is Kind.SCANS:
        what = material(sample) if own is None else tabulated(own)

        def truth(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
            return true_brdf(what, theta_in, theta_out, wavelengths) * np.cos(np.radians(theta_in))[:, None]

        spec = PlanSpec(THETA_IN)
        if isinstance(what, Tabulated):
            angles = tuple(row.theta_in for row in what.rows if row.theta_in <= LARGEST_INCIDENT)
            low, high = what.range_out
            spec = PlanSpec(angles, max(low, spec.lowest), min(high, spec.highest))
        return scan_charts(sample if own is None else own.sample, truth, spec, rounds, _tell)
    made = topography(surface, None, None, 1, micro=False)
    return simulation_charts(made.name, made.field, rounds, _tell)


def _tell(words: str) -> None:
    screen.print(words, style="dim", markup=False, highlight=False)


def _chapters(charts: list[Chart]) -> list[str]:
    return [tradeoff_chapter(chart) for chart in charts]


def _lines(chart: Chart) -> list[str]:
    """A chart as a table for a terminal; those on the front have a star."""
    lines = [chart.title, f"  {chart.cost.label:>24}  {chart.error.label}"]
    for index in sorted(range(len(chart.choices)), key=lambda i: chart.choices[i].cost):
        choice = chart.choices[index]
        star = "*" if index in chart.front else " "
        lines.append(f"{star} {choice.cost:24.4g}  {choice.error:<12.3g} {choice.family}: {choice.name}")
    return lines
