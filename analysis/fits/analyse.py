"""Everything that is fitted when a scan ends, and anything else on demand."""

from dataclasses import replace

import numpy as np

from analysis.choices import Distribution, Engine, Weight
from analysis.colour import colour_differences, has_colour
from analysis.fits.by_name import fit_models, local_fit_for
from analysis.fits.noise import hue_is_known
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.results import ColourDifferences, SampleAnalysis
from goniometer.datasets.dataset import Dataset

AT_THE_END_OF_A_SCAN = ("global", "cook-torrance", "cook-torrance-shift")
"""Models that are fitted when a scan ends, beside the local fit: those of the paper for a metal."""


def analyse(
    dataset: Dataset,
    conductor: Conductor | None = None,
    models: tuple[str, ...] = AT_THE_END_OF_A_SCAN,
    engine: Engine = "fast",
    distribution: Distribution = "ggx",
    weight: Weight = "none",
) -> SampleAnalysis:
    """Local fit and `models` (names of `analysis.choices.MODELS`), with their verdicts and colour differences.

    `conductor` is aluminium unless given; `engine`, `distribution` and `weight` as in `analysis.fits.brdf_fit`. The
    global model describes normalised spectra: for its colour difference, every point takes its scale from the local
    fit. Spectra whose hue is noise have no chromatic difference, and those that do not cover what the eye sees have
    none at all. Raises `OutOfRange` for wavelengths that the conductor does
    not cover and `FitError` for data that cannot be fitted.
    """
    metal = conductor or load_conductor()
    local = local_fit_for(dataset, models, metal, engine)
    fits = fit_models(dataset, local, models, metal, engine, distribution, weight)
    fitted = {"local": local.fitted} | {fit.model: fit.fitted for fit in fits}
    differences = {}
    if not has_colour(dataset.wavelengths):
        unknown = np.full(dataset.theta_in.size, np.nan)
        return SampleAnalysis(dataset, local, fits, dict.fromkeys(fitted, ColourDifferences(unknown, unknown)), metal)
    dim = ~hue_is_known(dataset, local.lambda_n)
    for name, values in fitted.items():
        found = colour_differences(dataset.brdf, values, dataset.wavelengths, dataset.theta_in)
        differences[name] = replace(found, chromatic=np.where(dim, np.nan, found.chromatic))
    return SampleAnalysis(dataset, local, fits, differences, metal)
