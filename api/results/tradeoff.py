"""Charts of speed against accuracy on this machine: which are made, and of what."""

from collections.abc import Callable

import numpy as np

from analysis.costs.fits import fit_charts
from analysis.costs.models import model_charts
from analysis.figures.tradeoff import tradeoff_chapter
from analysis.reflectance.fresnel import load_conductor
from analysis.tradeoff import Chart
from api.choices import ChartKind
from api.results.choose import mitsuba_is_there
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.plans.plan_spec import PlanSpec
from simulators.costs.measurements import drawn
from simulators.costs.scans import scan_charts
from simulators.costs.simulations import simulation_charts
from simulators.materials.materials import material, true_brdf
from simulators.materials.tabulated import Tabulated
from simulators.materials.tabulated_file import tabulated
from simulators.topographies.topography import topography

TITLE = "Speed against accuracy"


LARGEST_INCIDENT = 80.0
"""Of the scans that are charted, degrees."""

THETA_IN = tuple(float(angle) for angle in range(0, 81, 10))


def charts(
    kind: ChartKind,
    own: Dataset | None,
    sample: str,
    surface: str,
    rounds: int,
    tell: Callable[[str], None],
    *,
    dielectric: bool,
) -> list[Chart]:
    """Charts of one kind: of the dataset `own`, or without it of the material `sample` of the simulated bench.

    `surface` is that of the simulations, as in `goniometer simulate`; everything is timed `rounds` times, with other
    noise each time; `tell` is told what is being done. Raises `InputError` for a material or surface that is not there.
    """
    if kind in {ChartKind.FITS, ChartKind.MODELS}:
        datasets, known = ([own], None) if own is not None else drawn(sample, material(sample), rounds)
        if kind is ChartKind.MODELS:
            return model_charts(datasets[0], load_conductor(), dielectric, rounds, tell, rendering=mitsuba_is_there())
        return fit_charts(datasets, load_conductor(), known, rounds, tell)
    if kind is ChartKind.SCANS:
        what = material(sample) if own is None else tabulated(own)

        def truth(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
            return true_brdf(what, theta_in, theta_out, wavelengths) * np.cos(np.radians(theta_in))[:, None]

        spec = PlanSpec(THETA_IN)
        if isinstance(what, Tabulated):
            angles = tuple(row.theta_in for row in what.rows if row.theta_in <= LARGEST_INCIDENT)
            low, high = what.range_out
            spec = PlanSpec(angles, max(low, spec.lowest), min(high, spec.highest))
        return scan_charts(sample if own is None else own.sample, truth, spec, rounds, tell)
    made = topography(surface, None, None, 1, micro=False)
    return simulation_charts(made.name, made.field, rounds, tell)


def chapters(found: list[Chart]) -> list[str]:
    """The charts as chapters of a page."""
    return [tradeoff_chapter(chart) for chart in found]
