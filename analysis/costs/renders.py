"""What Mitsuba needs to render a scene with each model, and how far its image is off."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.choices import BRDF_MODELS
from analysis.costs.fits import Tell
from analysis.mitsuba.run import Material, Plugin, RenderTimes, bsdf_element, time_renders
from analysis.mitsuba.scene import write_mitsuba
from analysis.mitsuba.verify import material_of
from analysis.reflectance.fresnel import Conductor
from analysis.scenes.choose import NODES, nodes, without_noise
from analysis.scenes.ladder import Lambert, Microfacet, Rung
from analysis.scenes.scene import Scene
from analysis.scenes.vertices import Vertices, display_for
from analysis.tradeoff import Axis, Chart, Choice, Use
from drivers.arrays import FloatArray

SAMPLES = 64
"""Of a pixel, each time that an image is rendered."""

FEW = 4
"""Wavelengths of the smaller tables, which is about what a scene asks for."""

PRIMARIES = np.array([611.0, 549.0, 464.0])
"""Dominant wavelengths of red, green and blue of BT.709, nm."""


@dataclass(frozen=True)
class _Way:
    """One way to render."""

    name: str
    setting: str
    family: str
    material: Material | Plugin
    use: Use


def render_chart(
    sample: str,
    scene: Scene,
    vertices: Vertices,
    rungs: Sequence[Rung],
    table: Rung,
    alpha: float,
    rounds: int,
    tell: Tell,
) -> Chart:
    """Time of Mitsuba's rendering of `scene` against mean dE00 of its image, for each of `rungs`.

    Images are compared with that of `table`, all with the same random numbers; what noise makes of a difference is
    taken off. `vertices` are those of the scene, and `alpha` about the roughness of the sample. Raises `RenderError`.
    """
    ways = [way for rung in rungs for way in _ways(rung, alpha)]
    tell(f"Mitsuba: {len(ways)} renderings, {rounds} rounds")
    whole = Material(table.model, NODES, alpha)
    *found, right = time_renders(write_mitsuba(scene), [*(way.material for way in ways), whole], SAMPLES, rounds)
    return Chart(
        "rendering",
        "Renderings: Mitsuba's time for an image against its colour error",
        f"{sample}: a sphere under a sun and a sky, {vertices.columns} × {vertices.rows} pixels, {SAMPLES} samples "
        f"each, rendered by Mitsuba without the reading of the scene. Tables are the files that its plugin measured "
        f"reads, as goniometer choose renders them. Error: mean dE00 of the material's pixels against the table of all "
        f"points, which takes {right.middle:.2g} s; noise is taken off, and where it hides what is left, the error is "
        f"drawn as large as that of the noise.",
        Axis("time of an image", "s"),
        Axis("mean dE00 of the image", ""),
        tuple(_choice(way, each, right, vertices) for way, each in zip(ways, found, strict=True)),
    )


def _choice(way: _Way, found: RenderTimes, right: RenderTimes, vertices: Vertices) -> Choice:
    mine, theirs = found.halves[:, vertices.target], right.halves[:, vertices.target]
    valid = np.isfinite(np.stack([mine, theirs])).all(axis=(0, 1, 3))
    mine, theirs = mine[:, valid], theirs[:, valid]
    display = display_for(vertices, theirs.mean(axis=0))
    whole = float(display.difference(mine.mean(axis=0), theirs.mean(axis=0)).mean())
    parts = [float(display.difference(*both).mean()) for both in zip(mine, theirs, strict=True)]
    error, noise = without_noise(whole, parts)
    more = {"error of the noise": noise}
    return Choice(
        way.name, way.setting, way.family, found.middle, found.low, found.high, max(error, noise), more, way.use
    )


def _ways(rung: Rung, alpha: float) -> list[_Way]:
    tables = [
        _Way(
            rung.name,
            f"{rung.name} as a table of {at.size} wavelengths",
            f"table, {at.size} λ",
            material_of(rung, at, alpha),
            _table_use(rung),
        )
        for at in (NODES, nodes(FEW))
    ]
    model = rung.model
    if isinstance(model, Lambert):
        plugin = Plugin("diffuse", _spectrum("reflectance", NODES, np.interp(NODES, model.wavelengths, model.albedo)))
        words = "Mitsuba's diffuse, spectral"
        return [*tables, _Way(rung.name, words, "Mitsuba's formula", plugin, _plugin_use(plugin))]
    if isinstance(model, Microfacet) and model.form.conductor is not None and model.form.shift == "none":
        metal = model.form.conductor
        lobe = (
            f'<float name="alpha" value="{float(model.parameters[0]):.8g}"/>'
            f'<string name="distribution" value="{model.form.distribution}"/>'
        )
        spectral = Plugin("roughconductor", lobe + _index(metal))
        three = Plugin("roughconductor", lobe + _index_of_primaries(metal), "scalar_rgb")
        words = "Mitsuba's roughconductor"
        return [
            *tables,
            _Way(rung.name, f"{words}, spectral", "Mitsuba's formula", spectral, _plugin_use(spectral)),
            _Way(rung.name, f"{words}, RGB", "Mitsuba's formula, RGB", three, _plugin_use(three)),
        ]
    return tables


def _table_use(rung: Rung) -> Use:
    """The command that writes such a table; how many wavelengths it has follows from its budget."""
    if rung.name in BRDF_MODELS:
        text = f"goniometer export DATASET --to mitsuba --model {rung.name}"
        return Use("text", {"text": text}, "The file has as many wavelengths as its budget of errors asks for.")
    return Use("text", {"text": "goniometer choose DATASET --scene SCENE --bsdf FILE.bsdf"})


def _plugin_use(plugin: Plugin) -> Use:
    return Use("text", {"text": bsdf_element(plugin.name, plugin.settings)}, f"For Mitsuba's {plugin.variant}.")


def _index(metal: Conductor) -> str:
    """n and k as spectra."""
    n, k = metal.index(NODES)
    return _spectrum("eta", NODES, n) + _spectrum("k", NODES, k)


def _index_of_primaries(metal: Conductor) -> str:
    """n and k as a renderer takes them that knows three colours."""
    return "".join(
        f'<rgb name="{name}" value="{", ".join(f"{v:.8g}" for v in values)}"/>'
        for name, values in zip(("eta", "k"), metal.index(PRIMARIES), strict=True)
    )


def _spectrum(name: str, wavelengths: FloatArray, values: FloatArray) -> str:
    pairs = ", ".join(f"{w:g}:{v:.8g}" for w, v in zip(wavelengths, values, strict=True))
    return f'<spectrum name="{name}" value="{pairs}"/>'
