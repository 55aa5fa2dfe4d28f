"""A fitted model as a scene for the plugin `ggx_shift`, which has it exactly where a `.bsdf` has a table of it."""

import math
from pathlib import Path

import numpy as np

from analysis.bsdf.energy import clamp
from analysis.bsdf.export import clamping_words
from analysis.errors import ExportError
from analysis.mitsuba.run import bsdf_element
from analysis.mitsuba.vase_scene import SceneFiles, vase_scene
from analysis.scenes.ladder import Microfacet
from drivers.arrays import FloatArray

PLUGIN = "ggx_shift.py"
"""Name of the plugin's file beside the scene."""

SPECTRUM_STEP = 5.0
"""nm between the values of a spectrum in a scene."""

_RANGE = (360.0, 830.0)


def plugin_material(model: Microfacet) -> str:
    """XML of a BSDF with the id "sample" of the plugin.

    Raises `ExportError` for a model that the plugin does not have, and `OutOfRange` where the conductor's table does
    not cover 360 to 830 nm. The albedo of a dielectric continues as it is at the ends of its wavelengths.
    """
    form = model.form
    if form.distribution != "ggx" or form.shift == "two-component":
        raise ExportError(
            "The plugin ggx_shift has neither Beckmann's distribution nor a shift of two components; export a fit of "
            "cook-torrance-shift or dielectric-shift with ggx, or a .bsdf file."
        )
    wavelengths = np.arange(_RANGE[0], _RANGE[1] + 1, SPECTRUM_STEP)
    parameters = [_number("alpha", float(model.parameters[0]))]
    if form.conductor is None:
        assert model.albedo is not None  # every fit of a dielectric has one
        albedo = np.interp(wavelengths, model.albedo.wavelengths, model.albedo.values)
        parameters += [_number("int_ior", float(model.parameters[1]))]
        parameters += [_spectrum("diffuse_reflectance", wavelengths, albedo)]
    else:
        n, k = form.conductor.index(wavelengths)
        parameters += [_spectrum("eta", wavelengths, n), _spectrum("k", wavelengths, k)]
    if form.shift == "cosine":
        h, w = (float(value) for value in model.parameters[form.first_of_shift :])
        parameters += [_number("h", h), _number("w", w)]
    return bsdf_element("ggx_shift", "".join(f"\n    {parameter}" for parameter in parameters) + "\n  ")


def limiting_words(model: Microfacet) -> str:
    """What the plugin does to a model so that it reflects no more than all, a sentence; empty where it does nothing."""
    alpha, wavelengths = float(model.parameters[0]), np.arange(_RANGE[0], _RANGE[1] + 1, 2 * SPECTRUM_STEP)
    return clamping_words(clamp(model, alpha, wavelengths))


def plugin_scene(model: Microfacet, about: str) -> SceneFiles:
    """A scene that shows a model through the plugin, with the plugin's own file beside it.

    `about` is what a person has to know of the model; it stands in the scene as a comment. Raises as
    `plugin_material`.
    """
    found = vase_scene(plugin_material(model))
    comment = about.replace("--", "- -") + f"\nRender it with: python {PLUGIN} SCENE.xml IMAGE.exr [VARIANT]\n"
    xml = found.xml.replace(">\n", f">\n<!--\n{comment}-->\n", 1)
    plugin = Path(__file__).with_name(PLUGIN).read_bytes()
    return SceneFiles(xml, found.files | {PLUGIN: plugin})


def _number(name: str, value: float) -> str:
    assert math.isfinite(value)  # a fit has no other parameters
    return f'<float name="{name}" value="{value:.9g}"/>'


def _spectrum(name: str, wavelengths: FloatArray, values: FloatArray) -> str:
    pairs = ", ".join(f"{w:g}:{v:.7g}" for w, v in zip(wavelengths, values, strict=True))
    return f'<spectrum name="{name}" value="{pairs}"/>'
