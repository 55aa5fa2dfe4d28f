"""Curves of a dataset as SVG text, one panel each: distributions over angle, spectra, and slopes of spectra.

Figure numbers are those of Clausen et al. 2022. Every function takes a `name` that is unique in the page.
"""

import numpy as np
from numpy.typing import NDArray

from analysis.figures.filled import draw_filled, filled_legend
from analysis.figures.notation import superscript
from analysis.figures.svg import INK, SEQUENCE, line_colours, new_axes, style, to_svg
from analysis.fits.by_name import fitted_slope
from analysis.fits.noise import at_wavelength, clear_of_noise
from analysis.reflectance.directions import in_plane
from analysis.results import LocalFit, ModelFit
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.between import FEWEST, interpolate
from goniometer.datasets.budget import COVERAGE_FACTOR
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled
from goniometer.datasets.sector import is_hidden
from goniometer.geometry import BLOCKED_HALF_WIDTH

_SPECTRA_AT, _SPECTRA = 40.0, 7
"""Incident angle, degrees, of single spectra, and how many are shown."""

_LEAST_SIGNAL = 100.0
"""Signal over standard uncertainty of the counts below which a single spectrum would only show its noise."""


def distributions(
    dataset: Dataset, name: str, wavelength: float = 600.0, filled: Filled | None = None, *, dense: bool = False
) -> str:
    """Reflectance distributions at one wavelength, nm, of all incident angles on a logarithmic axis (Fig. 3).

    Dots are measured values, lines are read between them (`goniometer.datasets.between`), straight where the points are
    too few for that, or so `dense` that nothing need be read between. Bands are expanded uncertainties of both. Values
    that are not positive are left out; gaps are a sector that nobody saw, dashed where it is `filled`.
    """
    f, u = at_wavelength(dataset, wavelength)
    enough = not dense and np.count_nonzero(dataset.usable & np.isfinite(f)) >= FEWEST
    read = _between(dataset, wavelength) if enough else {}
    with style():
        figure, axes = new_axes(430, 300, right=62, top=10 if filled is None else 34)
        for (angle, order), colour in _by_incidence(dataset):
            theta, value, u_value = dataset.theta_out[order], f[order], u[order]
            axes.plot(theta, np.where(value > 0, value, np.nan), "o", color=colour, markersize=1.8)
            theta, value, u_value = read.get(angle, (theta, value, u_value))
            value = np.where(value > 0, value, np.nan)
            if is_hidden(dataset, angle):
                theta, value, u_value = _with_gap(-angle, theta, value, u_value)
            low = np.maximum(value - COVERAGE_FACTOR * u_value, 0.5 * value)
            axes.fill_between(theta, low, value + COVERAGE_FACTOR * u_value, color=colour, alpha=0.25, linewidth=0)
            axes.plot(theta, value, color=colour, linewidth=1.2, label=f"{angle:.0f}°")
            if filled is not None:
                draw_filled(axes, filled, angle, wavelength, colour)
        axes.set(yscale="log", xlim=(-90, 90), xticks=range(-90, 91, 30))
        axes.set(xlabel="reflected angle θ out / °", ylabel=f"BRDF at {wavelength:g} nm / (1/sr)")
        axes.yaxis.set_major_formatter(_power_of_ten)
        axes.grid(True)
        if filled is not None:
            filled_legend(axes, filled)
        axes.legend(title="θ in", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.2)
        return to_svg(figure, name, f"BRDF at {wavelength:g} nm over the reflected angle, one line an incident angle")


def _between(dataset: Dataset, wavelength: float) -> dict[float, tuple[FloatArray, FloatArray, FloatArray]]:
    """For each incident angle theta_out every half degree, and the BRDF and its combined standard uncertainty there."""
    rows = {angle: dataset.theta_out[order] for (angle, order), _ in _by_incidence(dataset)}
    grids = {}
    for angle, measured in rows.items():
        theta = np.union1d(measured, np.arange(np.ceil(measured[0]), measured[-1], 0.5))
        seen = np.abs(theta + angle) >= (BLOCKED_HALF_WIDTH - 0.1 if is_hidden(dataset, angle) else 0.0)
        grids[angle] = theta[seen]
    near = _at_wavelengths(dataset, wavelength)
    everywhere = np.concatenate([np.full(theta.size, angle) for angle, theta in grids.items()])
    read = interpolate(near, everywhere, np.concatenate(list(grids.values())))
    middle = near.wavelengths.size // 2
    at = {angle: everywhere == angle for angle in grids}
    return {a: (grids[a], read.brdf[mine, middle], read.u_total[mine, middle]) for a, mine in at.items()}


def _at_wavelengths(dataset: Dataset, wavelength: float) -> Dataset:
    """The few wavelengths of a dataset around one, nm."""
    middle = int(np.argmin(np.abs(dataset.wavelengths - wavelength)))
    return dataset.at_wavelengths(slice(max(middle - 2, 0), middle + 3))


def spectra(
    dataset: Dataset,
    local: LocalFit,
    name: str,
    least_signal: float = _LEAST_SIGNAL,
) -> str:
    """Normalised spectra from forward to back at the incident angle nearest 40 degrees, with their local fits (Fig. 6).

    Each spectrum is divided by its fitted value at lambda_n. Bands are the measurement with the expanded
    uncertainty of its counts (an error that all wavelengths share does not change their ratio), lines the local fit.
    Spectra that are unreliable or weaker than `least_signal` standard uncertainties of their counts are not chosen.
    """
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    nearest = groups[np.argmin(np.abs(dataset.theta_in - _SPECTRA_AT))]
    clear = clear_of_noise(dataset, local.lambda_n, least_signal)
    usable = np.flatnonzero((groups == nearest) & local.reliable & clear)
    usable = usable[np.argsort(dataset.theta_out[usable])]
    directions = dataset.theta_out[usable]
    wanted = np.linspace(directions.min(), directions.max(), _SPECTRA) if usable.size else directions
    chosen = usable[np.unique(np.argmin(np.abs(directions[:, None] - wanted), axis=0))] if usable.size else usable
    angle = float(dataset.theta_in[groups == nearest].mean())
    scale = local.scale[chosen, None]
    measured, u, fitted = (values[chosen] / scale for values in (dataset.brdf, dataset.u_counts, local.fitted))
    with style():
        figure, axes = new_axes(430, 300, right=62, top=22)
        for i, colour in enumerate(line_colours(chosen.size)):
            low, high = measured[i] - COVERAGE_FACTOR * u[i], measured[i] + COVERAGE_FACTOR * u[i]
            axes.fill_between(dataset.wavelengths, low, high, color=colour, alpha=0.4, linewidth=0)
            axes.plot(dataset.wavelengths, fitted[i], color=colour, linewidth=1.3)
        axes.axvline(local.lambda_n, color=INK, linewidth=0.6, alpha=0.5)
        shortest, longest = float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])
        axes.set(xlim=(shortest, longest), title=f"θ in = {angle:.0f}°")
        axes.set(xlabel="wavelength / nm", ylabel=f"BRDF, divided by its value at {local.lambda_n:g} nm")
        axes.grid(True)
        if chosen.size:  # the lines decide the scale, not the noise of the darkest spectrum
            margin = max(0.12 * float(np.ptp(fitted)), 0.1)
            axes.set_ylim(float(fitted.min()) - margin, float(fitted.max()) + margin)
        else:
            axes.text(0.5, 0.5, "no spectrum stands clear of its noise", transform=axes.transAxes, ha="center")
        # labels stand at the ends of their lines, pushed apart where these meet
        bottom, top = axes.get_ylim()
        ends = _spread(fitted[:, -1], 0.05 * (top - bottom))
        for end, colour, point in zip(ends, line_colours(chosen.size), chosen, strict=True):
            text = f"{dataset.theta_out[point]:.0f}°".replace("-", "−")
            axes.annotate(text, (longest, end), (4, 0), textcoords="offset points", color=colour, va="center")
        axes.text(1.01, 1.03, "θ out", transform=axes.transAxes, va="bottom")
        return to_svg(figure, name, f"normalised spectra at an incident angle of {angle:.0f} degrees with local fits")


def slopes(dataset: Dataset, local: LocalFit, fit: ModelFit, name: str, other: ModelFit | None = None) -> list[str]:
    """One panel an incident angle: slope of every spectrum with its error bar, and a model's curve (Fig. 9).

    `fit` is any model with a shift; the curve of an `other` one is dashed. Error bars are expanded uncertainties;
    points that the local fit calls unreliable are hollow and without bar. All panels share their axes.
    """
    theta = np.linspace(-90, 90, 181)
    sound = local.slope[local.reliable]
    low, high = (float(np.percentile(sound, q)) for q in (0.5, 99.5)) if sound.size else (-1.0, 1.0)
    margin = max(0.2 * (high - low), 0.1)
    panels = []
    for number, ((angle, order), _) in enumerate(_by_incidence(dataset)):
        directions = in_plane(np.full_like(theta, angle), theta)
        good, poor = order[local.reliable[order]], order[~local.reliable[order]]
        with style():
            figure, axes = new_axes(215, 150, left=40, right=8, bottom=34, top=18)
            axes.axhline(0, color=INK, linewidth=0.6, alpha=0.5)
            if is_hidden(dataset, angle):
                sector = -angle - BLOCKED_HALF_WIDTH, -angle + BLOCKED_HALF_WIDTH
                axes.axvspan(*sector, color=INK, alpha=0.1, linewidth=0)
            axes.plot(theta, fitted_slope(fit, directions), color=SEQUENCE[-2], linewidth=1.5)
            if other is not None:
                axes.plot(theta, fitted_slope(other, directions), color=INK, linewidth=1.2, dashes=(4, 2))
            axes.errorbar(
                dataset.theta_out[good], local.slope[good], COVERAGE_FACTOR * local.u_slope[good],
                fmt="o", color=SEQUENCE[0], markersize=2.6, elinewidth=0.8,
            )  # fmt: skip
            axes.plot(
                dataset.theta_out[poor], local.slope[poor],
                "o", color=SEQUENCE[0], markersize=2.6, markerfacecolor="none", markeredgewidth=0.7,
            )  # fmt: skip
            axes.set(xlim=(-90, 90), ylim=(low - margin, high + margin), xticks=(-90, -45, 0, 45, 90))
            axes.set(xlabel="θ out / °", ylabel="slope m / (1/µm)", title=f"θ in = {angle:.0f}°")
            panels.append(to_svg(figure, f"{name}-{number}", f"slopes at an incident angle of {angle:.0f} degrees"))
    return panels


def _by_incidence(dataset: Dataset) -> list[tuple[tuple[float, NDArray[np.intp]], str]]:
    """Mean incident angle, the points of it in order of theta_out, and a colour."""
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    count = int(groups.max()) + 1
    rows = []
    for g in range(count):
        members = np.flatnonzero(groups == g)
        rows.append((float(dataset.theta_in[members].mean()), members[np.argsort(dataset.theta_out[members])]))
    return list(zip(rows, line_colours(count), strict=True))


def _with_gap(centre: float, theta: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
    """Ascending `theta` and its values with a NaN at the blocked direction `centre`, so that lines break there."""
    at = int(np.searchsorted(theta, centre))
    return np.insert(theta, at, centre), *(np.insert(v, at, np.nan) for v in values)


def _power_of_ten(value: float, _position: object) -> str:
    """Tick of a logarithmic axis."""
    return f"10{superscript(round(np.log10(value)))}"


def _spread(places: FloatArray, distance: float) -> FloatArray:
    """`places` moved as little as keeps them `distance` apart, in their own order.

    With the required distances taken off, this is an isotonic regression (pool adjacent violators).
    """
    if not places.size:
        return places
    order = np.argsort(places)
    blocks: list[list[float]] = []  # sum and number of members
    for i, place in enumerate(places[order]):
        blocks.append([place - i * distance, 1])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, number = blocks.pop()
            blocks[-1][0] += total
            blocks[-1][1] += number
    level = np.concatenate([np.full(int(number), total / number) for total, number in blocks])
    moved = np.empty_like(places)
    moved[order] = level + distance * np.arange(places.size)
    return moved
