"""What was measured of the bench itself, as SVG panels in the style of a report."""

import numpy as np

from analysis.figures.svg import INK, SEQUENCE, line_colours, new_axes, style, to_svg
from goniometer.characterisation.alignment import Alignment, Sweep
from goniometer.characterisation.evaluation import FAR, Noise, Repeatability, Signature, StageRepeatability
from goniometer.characterisation.lines import WavelengthScale
from goniometer.datasets.budget import COVERAGE_FACTOR

BLUE, RED = SEQUENCE[0], SEQUENCE[4]

_WIDTH, _HEIGHT = 330.0, 250.0
_STRAY_MEANS = 12


def signature_panels(found: Signature) -> list[str]:
    """The peak with its width, and the whole profile on a logarithmic axis; bars are expanded uncertainties (k = 2)."""
    x, y, u = found.angle, found.profile, COVERAGE_FACTOR * found.u_profile
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT)
        half = found.width / 2
        axes.plot(x, y, "o-", color=BLUE, markersize=2.6, linewidth=1.1)
        axes.plot([found.centre - half, found.centre + half], [0.5, 0.5], color=RED, linewidth=1.4)
        axes.annotate(
            f"{found.width:.2f}°", (found.centre, 0.5), (0, 4), textcoords="offset points", ha="center", color=RED
        )
        axes.axvline(found.centre, color=RED, linewidth=0.8, dashes=(4, 3))
        axes.set(xlim=(-2.5, 2.5), ylim=(0, 1.05), title=f"Mirror at θ in = {found.theta_in:.1f}°: the peak")
        axes.set(xlabel="angle from the mirror direction / °", ylabel="signal / that of the peak")
        axes.grid(True)
        near = to_svg(figure, "signature-peak", f"peak of a mirror, {found.width:.3f} degrees wide at half maximum")
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT, left=54)
        clear = y > u
        axes.errorbar(x[clear], y[clear], u[clear], fmt="o", color=BLUE, markersize=2.6, elinewidth=0.8, label="signal")
        if not clear.all():
            # where nothing stands clear of the noise, the noise is the limit
            limit = np.maximum(y, 0) + u
            axes.plot(
                x[~clear], limit[~clear], "v", color=RED, markersize=3.5, label=f"upper limit (k = {COVERAGE_FACTOR})"
            )
        axes.axvspan(float(x.min()), -FAR, color=INK, alpha=0.08, linewidth=0)
        axes.axvspan(FAR, max(float(x.max()), FAR), color=INK, alpha=0.08, linewidth=0)
        axes.set(yscale="log", title="Down to the floor (shaded)", xlim=(float(x.min()), float(x.max())))
        axes.set(xlabel="angle from the mirror direction / °", ylabel="signal / that of the peak")
        axes.grid(True)
        axes.legend(loc="upper left", frameon=False)
        far = to_svg(figure, "signature-floor", "signal of a mirror over all directions, logarithmic")
    return [near, far]


def noise_panels(found: Noise) -> list[str]:
    """Noise-equivalent and stray-light-equivalent BRDF over wavelength, the latter as means over some bands."""
    parts = np.array_split(np.arange(len(found.wavelengths)), _STRAY_MEANS)
    places = np.array([found.wavelengths[part].mean() for part in parts])
    weights = [1 / found.u_stray[part] ** 2 for part in parts]
    stray = np.array([np.sum(w * found.stray[part]) / w.sum() for w, part in zip(weights, parts, strict=True)])
    u = np.array([1 / np.sqrt(w.sum()) for w in weights])
    clear = stray > COVERAGE_FACTOR * u
    with style():
        figure, axes = new_axes(2 * _WIDTH, _HEIGHT, left=54)
        axes.plot(found.wavelengths, found.brdf, "o", color=BLUE, markersize=2.8, label="noise of one exposure (k = 1)")
        axes.plot(found.wavelengths, found.predicted, color=BLUE, linewidth=1.2, label="predicted")
        axes.errorbar(
            places[clear], stray[clear], COVERAGE_FACTOR * u[clear],
            fmt="s", color=RED, markersize=4, elinewidth=0.9, label=f"stray light (bars: k = {COVERAGE_FACTOR})",
        )  # fmt: skip
        if not clear.all():
            limit = np.maximum(stray, 0) + COVERAGE_FACTOR * u
            axes.plot(places[~clear], limit[~clear], "v", color=RED, label=f"its upper limit (k = {COVERAGE_FACTOR})")
        lowest = min(float(found.predicted.min()), float(np.min(stray, where=clear, initial=np.inf)))
        axes.set(yscale="log", ylim=(0.3 * lowest, None))
        axes.set(title=f"Nothing mounted, {found.integration_time:g} s, {found.scans} exposures")
        axes.set(xlabel="wavelength / nm", ylabel="equivalent BRDF / (1/sr)")
        axes.grid(True)
        axes.legend(loc="upper center", frameon=False)
        return [to_svg(figure, "noise", "noise-equivalent and stray-light-equivalent BRDF over wavelength")]


def alignment_panels(found: Alignment) -> list[str]:
    """Mirror peaks, and both edges of the blocked sector laid over each other, as the stages read."""
    mirrors = [sweep for sweep in found.sweeps if sweep.kind == "mirror"]
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT, right=58)
        for sweep, colour in zip(mirrors, line_colours(len(mirrors)), strict=True):
            x = sweep.detector - 2 * sweep.sample
            label = f"{sweep.sample:.0f}°"
            axes.plot(x, sweep.signal / sweep.signal.max(), "o-", color=colour, markersize=2, linewidth=1, label=label)
        middle = 2 * found.sample_zero - found.detector_zero
        axes.axvline(middle, color=INK, linewidth=0.8, dashes=(4, 3))
        axes.set(ylim=(0, 1.05), title="Mirror peaks")
        axes.set(xlabel="detector − 2 × sample, as read / °", ylabel="signal / its largest")
        axes.grid(True)
        axes.legend(title="θ in", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.2)
        peaks = to_svg(figure, "alignment-peaks", f"mirror peaks as read, their middle at {middle:.4f} degrees")
    return [peaks, _edges([sweep for sweep in found.sweeps if sweep.kind != "mirror"])]


def _edges(sweeps: list[Sweep]) -> str:
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT)
        for kind, colour, marker in (("lower edge", BLUE, "o-"), ("upper edge", RED, "s--")):
            for number, sweep in enumerate(sweep for sweep in sweeps if sweep.kind == kind):
                share = sweep.signal / sweep.signal.max()
                label = f"{kind} ({'−' if kind == 'lower edge' else '+'})" if number == 0 else None
                axes.plot(np.abs(sweep.detector), share, marker, color=colour, markersize=2.4, linewidth=1, label=label)
                axes.axvline(abs(sweep.place), color=colour, linewidth=0.7, alpha=0.7)
        axes.set(ylim=(-0.05, 1.1), title="White panel: edges of the blocked sector")
        axes.set(xlabel="detector from the source axis, as read / °", ylabel="signal / its largest")
        axes.grid(True)
        axes.legend(loc="center right", frameon=False)
        return to_svg(figure, "alignment-edges", "signal at both edges of the blocked sector, laid over each other")


def repeatability_panels(found: Repeatability) -> list[str]:
    """Where each stage truly stood, told by the signal, against what it read."""
    return [_returns(found.sample), _returns(found.detector)]


def _returns(found: StageRepeatability) -> str:
    departure = 1000 * found.departure
    u = 1000 * COVERAGE_FACTOR * found.u_signal / abs(found.slope)
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT)
        for side, colour, marker, label in ((False, BLUE, "o", "from below"), (True, RED, "s", "from above")):
            at = found.from_above == side
            axes.errorbar(
                np.flatnonzero(at) + 1, departure[at], u[at],
                fmt=marker, color=colour, markersize=4, elinewidth=0.8, label=label,
            )  # fmt: skip
        limit = 1000 * COVERAGE_FACTOR * found.scatter
        axes.axhspan(-limit, limit, color=INK, alpha=0.08, linewidth=0)
        axes.axhline(0, color=INK, linewidth=0.6, alpha=0.5)
        axes.set(title=f"{found.stage.capitalize()} stage: scatter {1000 * found.scatter:.1f} m° (band: ±2 of it)")
        axes.set(xlabel="return", ylabel="true minus read angle, mean taken off / m°")
        axes.margins(y=0.2)
        axes.grid(True)
        axes.legend(loc="best", frameon=False)
        return to_svg(figure, f"repeatability-{found.stage}", f"departures of the {found.stage} stage over its returns")


def wavelength_panels(found: WavelengthScale) -> list[str]:
    """By how much every line lies where it should not."""
    known = np.array([line.known for line in found.lines])
    departure = 1000 * (known - np.array([line.found for line in found.lines]))
    u = 1000 * COVERAGE_FACTOR * np.array([line.u for line in found.lines])
    offset, band = 1000 * found.offset, 1000 * COVERAGE_FACTOR * found.u_offset
    with style():
        figure, axes = new_axes(2 * _WIDTH, _HEIGHT, left=54)
        for element, colour, marker in (("Hg", BLUE, "o"), ("Ar", RED, "s")):
            at = np.array([line.element == element for line in found.lines])
            axes.errorbar(
                known[at], departure[at], u[at], fmt=marker, color=colour, markersize=4, elinewidth=0.8, label=element
            )
        axes.axhline(offset, color=INK, linewidth=0.9, dashes=(4, 3))
        axes.axhspan(offset - band, offset + band, color=INK, alpha=0.1, linewidth=0)
        axes.set(title=f"Lines of a mercury-argon lamp (bars and band: k = {COVERAGE_FACTOR})")
        axes.set(xlabel="wavelength in air / nm", ylabel="known minus found / pm")
        axes.margins(y=0.2)
        axes.grid(True)
        axes.legend(loc="best", frameon=False)
        return [to_svg(figure, "wavelength", "known minus found wavelength of the lines of a mercury-argon lamp")]
