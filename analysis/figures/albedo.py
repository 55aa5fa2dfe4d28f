"""Diffuse albedo of a dielectric over wavelength."""

from collections.abc import Sequence

import numpy as np

from analysis.choices import MODEL_NAMES
from analysis.figures.svg import line_colours, new_axes, style, to_svg
from analysis.results import ModelFit
from goniometer.datasets.budget import COVERAGE_FACTOR


def albedo_curves(fits: Sequence[ModelFit], name: str) -> str:
    """One line a fit that has an albedo, with its expanded uncertainty as a band."""
    with style():
        figure, axes = new_axes(430, 260, right=150, top=10)
        for fit, colour in zip(fits, line_colours(len(fits)), strict=True):
            if fit.albedo is None:
                continue
            wavelengths, value = fit.albedo.wavelengths, fit.albedo.values
            u = np.where(np.isfinite(fit.albedo.u), COVERAGE_FACTOR * fit.albedo.u, 0.0)
            axes.fill_between(wavelengths, np.maximum(value - u, 0), value + u, color=colour, alpha=0.25, linewidth=0)
            axes.plot(wavelengths, value, color=colour, linewidth=1.3, label=MODEL_NAMES[fit.model])
        axes.set(xlabel="wavelength / nm", ylabel="diffuse albedo r_d", ylim=(0, None))
        axes.grid(True)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.2)
        return to_svg(figure, name, "diffuse albedo over wavelength, one line a model")
