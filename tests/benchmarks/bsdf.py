"""File size against error of `.bsdf` files: the tables that an error budget asks for, beside tables of a fixed size.

    python -m tests.benchmarks.bsdf [PAGE.html]

Aluminium with five roughnesses and about the shift of the bench's samples. "flat", "vndf", "flat-whole" and
"vndf-whole" are the layouts of the writer, each at several budgets. "fixed" is what the writer made of every model
before it knew budgets: 32 incident angles and 80 x 80 nodes, the lobe of GGX taken out of the table. "plain" has the
reflectance itself in an even table, at several sizes, as one would who did not look at errors. Errors are relative to
the model, over the pairs by which the writer judges its files, the worst of 48 wavelengths. The second table is what
the number of nodes of the lobe's own table does where all others are fine, and how far the shift is clamped.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.bsdf.energy import clamp, sampling_noise
from analysis.bsdf.error import RelativeError, probe, read_back
from analysis.bsdf.export import LAYOUTS
from analysis.bsdf.fields import LOBE_NODES, Grid, bsdf_fields, lobe_table
from analysis.bsdf.measured_bsdf import read_bsdf
from analysis.bsdf.rendered_model import RenderedModel, rendered
from analysis.bsdf.search import Budget, lobe_for, smallest_grid, wavelength_nodes
from analysis.bsdf.tensor_file import encode
from analysis.colour import xyz_weights
from analysis.figures.page import figure, titled_page
from analysis.figures.svg import new_axes, style, to_svg
from analysis.reflectance.distributions import ndf
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.microfacet import Form
from analysis.scenes.ladder import Microfacet
from drivers.arrays import FloatArray
from tests.benchmarks.figures import tell

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MODELS = ((0.005, 0.0, 0.0), (0.02, 0.7, 5.0), (0.1, 0.8, 4.8), (0.25, 1.5, 2.6), (0.4, 1.6, 2.3))
"""alpha, h in 1/um and w."""

BUDGETS = (0.1, 0.05, 0.02, 0.01)
USUAL = 0.02
"""Budget of an export without any wish."""
PLAIN = ((8, 16), (16, 32), (24, 64), (32, 80), (32, 128))
"""Incident angles and nodes of a side."""

COLOURS = {
    "flat": "#0072b2", "vndf": "#d55e00", "flat-whole": "#56b4e9", "vndf-whole": "#e69f00", "fixed": "#009e73",
    "plain": "#cc79a7",
}  # fmt: skip
MARKS = {"flat": "o-", "vndf": "s-", "flat-whole": "o--", "vndf-whole": "s--", "fixed": "D", "plain": "^:"}


@dataclass(frozen=True)
class File:
    """A file that was made."""

    method: str
    budget: float | None
    grid: Grid
    wavelengths: int
    size: int
    """Bytes."""
    error: RelativeError
    colour: float
    """99th percentile of CIEDE2000."""
    noise: float
    seconds: float
    """Processor time it took to find and make."""


LINE = "{:>6} {:>10} {:>7} {:>8} {:>7} {:>4} {:>3} {:>8} {:>8} {:>8} {:>8} {:>6} {:>5}"


def made(
    model: RenderedModel, method: str, wavelengths: FloatArray, grid: Grid, lobe: FloatArray, begin: float,
    budget: float | None = None, alpha: float | None = None,
) -> File:  # fmt: skip
    """A file with these tables, judged."""
    content = encode(bsdf_fields(model.reflectance, alpha or model.alpha, wavelengths, grid, lobe))
    seconds = time.process_time() - begin
    bsdf = read_bsdf(content)
    at = probe(model, np.linspace(*model.wavelengths, 48))
    found = read_back(bsdf, at)
    colour = float(np.percentile(at.colours(found), 99))
    noise = sampling_noise(bsdf, model.alpha)
    return File(method, budget, grid, wavelengths.size, len(content), at.relative(found), colour, noise, seconds)


def files(model: RenderedModel) -> Iterator[File]:
    """All files of one model."""
    for error in BUDGETS:
        for method, layout in LAYOUTS.items():
            begin = time.process_time()
            budget = Budget(error, 1e9)
            wavelengths, spent = wavelength_nodes(model, budget)
            lobe = lobe_for(model, wavelengths, budget)
            grid, _ = smallest_grid(model, wavelengths, lobe, layout, spent, error)
            yield made(model, method, wavelengths, grid, lobe, begin, error)
    wavelengths, _ = wavelength_nodes(model, Budget(0.025, 0.1))  # as many as it took for 0.05 dE00
    ggx = ndf(np.cos(np.linspace(0, 1, 2049) ** 2 * (np.pi / 2)), model.alpha)
    yield made(model, "fixed", wavelengths, Grid(32, 80, 0.0), ggx, time.process_time())
    for incident, table in PLAIN:
        flat = np.full(2, 4.0)
        yield made(model, "plain", wavelengths, Grid(incident, table, 0.0), flat, time.process_time(), alpha=1.0)


def lobe_errors(model: RenderedModel) -> list[float]:
    """99th percentile of the error with fine tables and each number of nodes of the lobe's table."""
    wavelengths = np.array([400.0, 600.0, 800.0])
    at = probe(model, wavelengths)
    errors = []
    for nodes in LOBE_NODES:
        lobe = lobe_table(model.reflectance, model.alpha, wavelengths, nodes)
        fields = bsdf_fields(model.reflectance, model.alpha, wavelengths, Grid(48, 96, 0.0), lobe)
        errors.append(at.relative(read_back(read_bsdf(encode(fields)), at)).p99)
    return errors


def panel(alpha: float, found: list[File], *, first: bool) -> str:
    """One roughness of the chart."""
    with style():
        drawing, axes = new_axes(300, 240, left=52, bottom=40, top=24)
        axes.set(xscale="log", yscale="log", xlim=(6e3, 1e8), ylim=(1e-3, 200), title=f"α = {alpha:g}")
        axes.set(xlabel="file size / MB", ylabel="99th percentile of the error")
        axes.set_xticks([1e4, 1e5, 1e6, 1e7, 1e8], ["0.01", "0.1", "1", "10", "100"])
        axes.set_yticks([1e-3, 1e-2, 1e-1, 1, 10, 100], ["0.1 %", "1 %", "10 %", "100 %", "×10", "×100"])
        axes.minorticks_off()
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        for method, mark in MARKS.items():
            _draw(axes, [file for file in found if file.method == method], method, mark)
        axes.axhline(0.02, color="#808080", linewidth=0.8, linestyle="--")
        if first:
            axes.legend(frameon=False, loc="upper right")
        label = f"File size against error for alpha {alpha:g}"
        return to_svg(drawing, f"bsdf-{alpha:g}", label)


def _draw(axes: "Axes", some: list[File], method: str, mark: str) -> None:
    sizes, errors = [file.size for file in some], [file.error.p99 for file in some]
    axes.plot(sizes, errors, mark, color=COLOURS[method], markersize=4.5, linewidth=1.0, label=method)


def main(page: Path | None) -> None:
    """Print the tables, and write the chart."""
    xyz_weights(np.linspace(400, 700, 48))  # colour-science takes seconds to load
    panels, rows = [], []
    head = (
        "alpha", "method", "budget", "size kB", "theta_i", "side", "nm",
        "median", "p99", "max", "dE00 p99", "noise", "s",
    )  # fmt: skip
    print(LINE.format(*head))
    lobes = []
    for alpha, h, w in MODELS:
        model = rendered(Microfacet(Form(load_conductor(), "cosine"), np.array([alpha, h, w]), None))
        clamped = clamp(model.reflectance, alpha, np.linspace(*model.wavelengths, 48))
        lobes.append((alpha, lobe_errors(model), 1.0 if clamped is None else float(clamped.factor.min())))
        model = model if clamped is None else replace(model, reflectance=clamped)
        found = list(files(model))
        for file in found:
            budget = "" if file.budget is None else f"{file.budget:.1%}"
            row = (
                f"{alpha:g}", file.method, budget, f"{file.size / 1e3:.0f}", str(file.grid.incident),
                str(file.grid.table), str(file.wavelengths), f"{file.error.median:.3%}", f"{file.error.p99:.2%}",
                f"{file.error.maximum:.2%}", f"{file.colour:.2f}", f"{file.noise:.2f}", f"{file.seconds:.1f}",
            )  # fmt: skip
            rows.append(row)
            print(LINE.format(*row), flush=True)
        panels.append(panel(alpha, found, first=not panels))
        usual = min((file for file in found if file.budget == USUAL), key=lambda file: file.size)
        how = f"kB ({usual.method}, dE00 p99 {usual.colour:.2f})"
        tell(f"alpha {alpha:g}: smallest file with a budget of {100 * USUAL:g} %", usual.size / 1e3, how)
        for what, error, aim in (
            ("median", usual.error.median, "< 1"),
            ("99th percentile", usual.error.p99, f"<= {100 * USUAL:g}"),
            ("largest", usual.error.maximum, "< 10"),
        ):
            tell(f"alpha {alpha:g}: {what} of its error", 100 * error, "%", aim)
    print("\n99th percentile of the error by nodes of the lobe's table, and the smallest factor of clamping")
    print("alpha  " + "".join(f"{nodes:>9}" for nodes in LOBE_NODES) + "   factor")
    for alpha, errors, factor in lobes:
        print(f"{alpha:<7g}" + "".join(f"{error:>9.2%}" for error in errors) + f"   {factor:.3f}")
    if page is not None:
        caption = (
            "Error of .bsdf files against their model, up to 80° from the normal, for five roughnesses of aluminium "
            "with shift. Better is to the left and below. flat to vndf-whole: the layouts of the writer, each at "
            "budgets of 10, 5, 2 and 1 %; the dashed grey line is the usual budget. fixed: 32 × 80 × 80 nodes for "
            "every model. plain: the reflectance itself in an even table of a size that is not looked for."
        )
        cells = "".join("<tr>" + "".join(f"<td>{value}</td>" for value in row) + "</tr>" for row in rows)
        table = (
            '<div class="wide"><table><thead><tr>'
            + "".join(f"<th>{name}</th>" for name in head)
            + f"</tr></thead><tbody>{cells}</tbody></table></div>"
        )
        page.write_text(titled_page("Size and error of .bsdf files", [figure(panels, caption), table]), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
