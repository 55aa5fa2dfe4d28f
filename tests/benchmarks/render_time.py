"""What the shift costs a renderer, and whether its two ways into one give the same picture.

    python -m tests.benchmarks.render_time [--rounds N] [--page FILE]

needs Mitsuba. The vase under its spot light is rendered by turns with a metal (Sample 1) and a dielectric, without and
with shift, by Mitsuba's own formula, by the plugin ggx_shift and as a `.bsdf`, in every variant that works here. Times
are of all processors together, so that other work on the computer matters little; ratios are those of the pairs in one
round. The paper has up to 3 % for conductors.
"""

import argparse
import tempfile
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from analysis.bsdf.export import BsdfReport, write_bsdf
from analysis.errors import RenderError
from analysis.figures.page import figure, page
from analysis.figures.svg import SEQUENCE, new_axes, style, to_svg
from analysis.fits.brdf_fit import form_of
from analysis.mitsuba.export_plugin import plugin_material
from analysis.mitsuba.run import bsdf_element
from analysis.mitsuba.vase_render import VARIANTS, Pictures, Variant, compare, render_scenes
from analysis.mitsuba.vase_scene import DEPTH, SceneFiles, vase_scene
from analysis.reflectance.fresnel import load_conductor
from analysis.results import Albedo
from analysis.scenes.ladder import Microfacet
from drivers.arrays import FloatArray
from tests.benchmarks.figures import tell

ROUNDS = 24
SIZES = {"llvm_ad_spectral": (128, 32), "scalar_spectral": (64, 8)}
"""Pixels of a side, and samples of a pixel of one picture."""

BLOCK = 4
"""Pixels of a side that are averaged before pictures are compared, for noise."""


@dataclass(frozen=True)
class Way:
    """One material as it goes into a scene."""

    name: str
    element: str
    files: dict[str, bytes]
    plain: str = ""
    """Name of the same without shift; empty for one that has none."""
    exact: str = ""
    """Name of what it is a table of."""
    report: BsdfReport | None = None


def models() -> dict[str, tuple[Microfacet, Microfacet]]:
    """Two materials, each without and with shift."""
    aluminium = load_conductor()
    wavelengths = np.linspace(360, 830, 48)
    # a reddish patch
    albedo = Albedo(wavelengths, 0.15 + 0.45 / (1 + np.exp((600 - wavelengths) / 15)), np.zeros(48))
    metal, dielectric = (
        tuple(
            Microfacet(form_of(f"{name}{end}", conductor, "ggx"), np.array([*parameters, *more]), diffuse)
            for end, more in (("", ()), ("-shift", (1.6, 2.3)))
        )
        for name, conductor, parameters, diffuse in (
            ("cook-torrance", aluminium, (0.364,), None),
            ("dielectric", None, (0.3, 1.5), albedo),
        )
    )
    return {"metal": (metal[0], metal[1]), "dielectric": (dielectric[0], dielectric[1])}


def ways(folder: Path) -> list[Way]:
    """All that is rendered; `folder` is for files."""
    found = []
    for material, pair in models().items():
        if material == "metal":
            plugin = plugin_material(pair[0])
            own = plugin.replace("ggx_shift", "roughconductor").replace(
                "</bsdf>", '<string name="distribution" value="ggx"/></bsdf>'
            )
            found.append(Way("metal, Mitsuba's own", own, {}))
        for model, end in zip(pair, ("", " with shift"), strict=True):
            name = f"{material}{end}, plugin"
            found.append(Way(name, plugin_material(model), {}, f"{material}, plugin" if end else ""))
        for model, end in zip(pair, ("", " with shift"), strict=True):
            file = f"{material}{end.replace(' ', '-')}.bsdf"
            report = write_bsdf(folder / file, model)
            element = bsdf_element("measured", f'<string name="filename" value="{file}"/>')
            plain = f"{material}, .bsdf" if end else ""
            content = {file: (folder / file).read_bytes()}
            found.append(Way(f"{material}{end}, .bsdf", element, content, plain, f"{material}{end}, plugin", report))
    return found


def rendered(found: list[Way], variant: str, rounds: int, depth: int = DEPTH) -> Pictures:
    """All ways in one variant, `rounds` times by turns."""
    pixels, samples = SIZES[variant]
    scenes = []
    for way in found:
        scene = vase_scene(way.element, pixels, depth=depth)
        scenes.append(SceneFiles(scene.xml, scene.files | way.files))
    return render_scenes(scenes, Variant(variant), samples, tuple(range(1, rounds + 1)))


def ratio(pictures: Pictures, first: int, second: int) -> tuple[float, float, float, float]:
    """Median, quartiles and standard error of the median of second / first over the rounds."""
    each = pictures.cpu_seconds[:, second] / pictures.cpu_seconds[:, first]
    low, middle, high = np.quantile(each, [0.25, 0.5, 0.75])
    # of a median of normal numbers, with the spread from the quartiles
    error = 1.2533 * (high - low) / 1.349 / np.sqrt(len(each))
    return float(middle), float(low), float(high), float(error)


def block_error(pictures: Pictures, first: int, second: int) -> FloatArray:
    """Relative difference of Y of second to first, of all lit blocks that show nothing but the material."""
    whole = pictures.images[..., 1][:, [first, second]].mean(axis=0)
    side = whole.shape[1] // BLOCK
    means = whole.reshape(2, side, BLOCK, side, BLOCK).mean(axis=(2, 4))
    covered = pictures.covered.reshape(side, BLOCK, side, BLOCK).all(axis=(1, 3))
    lit = covered & (means[0] > 0.01 * means[0][covered].max())
    return np.asarray(means[1][lit] / means[0][lit] - 1)


def show(found: list[Way], pictures: Pictures, once: Pictures, variant: str) -> None:
    """Tables of one variant; `once` are pictures in which light is reflected once, which leaves them no noise."""
    names = [way.name for way in found]
    pixels, samples = SIZES[variant]
    million = pixels**2 * samples / 1e6
    print(f"\n{variant}, {pixels} x {pixels} pixels, {samples} samples, {len(pictures.seconds)} rounds by turns")
    print(f"{'':34}{'CPU s':>8}{'quartiles':>17}{'to plain':>10}{'quartiles':>17}{'error':>8}{'wall s':>8}")
    for i, way in enumerate(found):
        low, middle, high = np.quantile(pictures.cpu_seconds[:, i] / million, [0.25, 0.5, 0.75])
        line = f"{way.name:34}{middle:8.3f}{low:9.3f} -{high:6.3f}"
        if way.plain:
            middle, low, high, error = ratio(pictures, names.index(way.plain), i)
            line += f"{middle:10.4f}{low:9.3f} -{high:6.3f}{error:8.4f}"
        else:
            line += " " * 35
        print(f"{line}{np.median(pictures.seconds[:, i]) / million:8.3f}")
    print("CPU s and wall s are per million ways of light; to plain: CPU time with shift over that without")
    heads = f"{'dE00':>8}{'±':>7}{'p95':>7}{'Y median':>10}{'|Y| p99':>9}"
    print(f"\n{'':34}{'reflected once':^41}{'six segments':^41}")
    print(f"{'.bsdf against the plugin':34}{2 * heads}{'file p99':>10}")
    for i, way in enumerate(found):
        if way.report is None:
            continue
        line, exact = f"{way.name:34}", names.index(way.exact)
        for each in (once, pictures):
            seen, errors = compare(each, exact, i), block_error(each, exact, i)
            line += f"{seen.mean:8.3f}{seen.u_mean:7.3f}{seen.p95:7.3f}{np.median(errors):10.2%}"
            line += f"{np.percentile(np.abs(errors), 99):9.2%}"
        print(f"{line}{way.report.written.error.p99:10.2%}")
    for i, way in enumerate(found):
        if way.plain:
            middle, _, _, error = ratio(pictures, names.index(way.plain), i)
            slow = "plugin" in way.name and variant.startswith("scalar")
            because = "Python evaluates a plugin in this variant" if slow else ""
            what = f"{variant}: {way.name}: render time of the shift"
            tell(what, 100 * (middle - 1), f"± {100 * error:.1f} %", "<= 3", because)
    for i, way in enumerate(found):
        if way.report is not None:
            off = np.percentile(np.abs(block_error(once, names.index(way.exact), i)), 99)
            because = "no error is stated beyond 80° from the normal, where silhouettes are"
            what = f"{variant}: {way.name} against the plugin, 99th percentile of blocks, reflected once"
            tell(what, 100 * off, "%", f"<= {100 * way.report.written.error.p99:.2f}", because)
    worst = np.nanmax(compare(pictures, 0, 1).difference)
    tell(f"{variant}: plugin without shift against Mitsuba's own, largest dE00 of a pixel", worst)
    print("Y: relative difference of blocks of 4 x 4 pixels; file p99: what the file says of itself")


def chart(found: list[Way], by_variant: dict[str, Pictures]) -> str:
    """CPU time of all ways in all variants."""
    rows = [(variant, i) for variant in by_variant for i in range(len(found))]
    with style():
        drawing, axes = new_axes(620, 40 + 17 * len(rows), left=270, top=8, bottom=36)
        for row, (variant, i) in enumerate(rows):
            pixels, samples = SIZES[variant]
            low, middle, high = np.quantile(
                by_variant[variant].cpu_seconds[:, i] / (pixels**2 * samples / 1e6), [0.25, 0.5, 0.75]
            )
            colour = SEQUENCE[0] if found[i].plain else SEQUENCE[4]
            axes.plot([low, high], [row, row], color=colour, linewidth=6, alpha=0.45, solid_capstyle="butt")
            axes.plot([middle], [row], marker="D" if found[i].plain else "o", color=colour, markersize=5)
        axes.set(xscale="log", ylim=(len(rows) - 0.4, -0.6))
        axes.set_xlabel("CPU time of a million ways of light / s; ◆ with shift, ● without")
        ticks = [v for v in (0.2, 0.5, 1, 2, 5, 10, 20, 50) if axes.get_xlim()[0] <= v <= axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{v:g}" for v in ticks])
        axes.minorticks_off()
        labels = [f"{found[i].name} · {variant.split('_')[0]}" for variant, i in rows]
        axes.set_yticks(range(len(rows)), labels)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, axis="x")
        return to_svg(drawing, "render-time", "Render time of all ways in all variants")


def main() -> None:
    """Render, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = ways(Path(folder))
    by_variant: dict[str, Pictures] = {}
    for variant in VARIANTS:
        try:
            by_variant[variant] = rendered(found, variant, arguments.rounds)
        except RenderError as error:
            print(f"{variant}: {error}")
            continue
        show(found, by_variant[variant], rendered(found, variant, 2, depth=2), variant)
    tell("variants of Mitsuba that work here", len(by_variant), f"of {len(VARIANTS)}: {', '.join(by_variant)}")
    if arguments.page is not None:
        caption = escape("Median and quartiles of the rounds, rendered by turns.")
        body = ["<h1>Render times</h1>", figure([chart(found, by_variant)], caption, "alone")]
        arguments.page.write_text(page("Render times", body), encoding="utf-8")


if __name__ == "__main__":
    main()
