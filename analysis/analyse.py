"""Everything that is fitted when a scan ends."""

from dataclasses import replace

import numpy as np

from analysis.brdf_fit import cook_torrance_fit, shift_fit
from analysis.colour import colour_differences
from analysis.fresnel import Conductor, load_conductor
from analysis.global_fit import global_fit
from analysis.local_fit import local_fit
from analysis.noise import hue_is_known
from analysis.results import SampleAnalysis
from goniometer.dataset import Dataset


def analyse(dataset: Dataset, conductor: Conductor | None = None) -> SampleAnalysis:
    """Local fit, global fit, Cook-Torrance with and without shift, and their colour differences.

    `conductor` is aluminium unless given. The global model describes normalised spectra: for its colour
    difference, every point takes its scale from the local fit. Spectra whose hue is noise have no chromatic
    difference. Raises `OutOfRange` for wavelengths that the
    conductor does not cover and `FitError` for data that cannot be fitted.
    """
    conductor = conductor or load_conductor()
    local = local_fit(dataset, conductor)
    models = (
        global_fit(dataset, local, conductor),
        cook_torrance_fit(dataset, conductor),
        shift_fit(dataset, conductor),
    )
    fitted = {"local": local.fitted} | {model.model: model.fitted for model in models}
    dim = ~hue_is_known(dataset, local.lambda_n)
    differences = {}
    for name, values in fitted.items():
        found = colour_differences(dataset.brdf, values, dataset.wavelengths, dataset.theta_in)
        differences[name] = replace(found, chromatic=np.where(dim, np.nan, found.chromatic))
    return SampleAnalysis(dataset, local, models, differences)
