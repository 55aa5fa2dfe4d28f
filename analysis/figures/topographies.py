"""Topographies as pictures (paper, Fig. 2), and what their heights and slopes are like.

Lengths are um. Every function takes plain arrays and a `name` that is unique in the page.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from analysis.figures.svg import INK, SEQUENCE, new_axes, style, to_svg
from drivers.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = "viridis"
_FIRST, _SECOND = SEQUENCE[0], SEQUENCE[5]
_FLAT = 5e-4
"""Half the range of heights that is shown of a flat surface, um."""

_SMALL = 300.0
"""Width of a figure, points, below which it stands in a row of many."""

_ELEVATION, _AZIMUTH = np.radians(38.0), np.radians(28.0)
"""From where the 3D view looks: above the horizon, and turned about the normal."""
_LIGHT = np.array([-0.5, 0.45, 0.74])
_WALL = (0.45, 0.45, 0.47, 1.0)
_RELIEF = 0.16
"""Height of the 3D view's relief, as a part of the longer side."""


def top_view(heights_um: FloatArray, pitch_um: float, name: str, title: str = "", width: float = 400) -> str:
    """The heights [y, x] from above, y upwards, between their 0.1 and 99.9 per cent quantiles; with a colour bar.

    Each pixel is the mean of the points that it stands for. `width` of the figure is in points; below `_SMALL` it has
    no names of the axes.
    """
    left, right, bottom, top = (46, 78, 38, 22) if width >= _SMALL else (28, 62, 22, 20)
    side = width - left - right
    shown, step = _coarser(heights_um, pitch_um, int(1.3 * side))
    low, high = _range(shown)
    with style():
        figure, axes = new_axes(width, side + bottom + top, left=left, right=right, bottom=bottom, top=top)
        extent = (0, shown.shape[1] * step, 0, shown.shape[0] * step)
        axes.imshow(shown, _COLOURS, vmin=low, vmax=high, extent=extent, origin="lower", interpolation="none")
        axes.locator_params(nbins=6 if width >= _SMALL else 4)
        axes.set_title(title, loc="left")
        axes.apply_aspect()
        box = axes.get_position()
        bar = figure.add_axes((box.x1 + 14 / width, box.y0, 12 / width, box.height))
        _bar(bar, low, high)
        if width >= _SMALL:
            axes.set(xlabel="x, µm", ylabel="y, µm")
            bar.set_ylabel("height, µm")
        return to_svg(figure, name, f"Heights from above, {low:.3g} to {high:.3g} µm. {title}")


def perspective(heights_um: FloatArray, pitch_um: float, name: str, title: str = "", width: float = 400) -> str:
    """The heights [y, x] seen from the side, lit from the left; heights are stretched, and the figure says how much.

    `width` of the figure is in points.
    """
    pixels = int(1.15 * width)
    shown, step = _coarser(heights_um, pitch_um, pixels)
    low, high = _range(shown)
    size = step * np.array([shown.shape[1], shown.shape[0]])
    stretch = _round_stretch(_RELIEF * float(size.max()) / (high - low))
    part = (np.clip(shown, low, high) - low) / (high - low)
    scale = pixels / (size[0] * np.cos(_AZIMUTH) + size[1] * np.sin(_AZIMUTH))
    image, corner = _rendered(part * stretch * (high - low), step, part, scale)
    with style():
        figure, axes = new_axes(width, 0.7 * width, left=0.1 * width, right=8, bottom=4, top=18)
        extent = (corner[0], corner[0] + image.shape[1] / scale, corner[1], corner[1] + image.shape[0] / scale)
        axes.imshow(image, extent=extent, origin="lower", interpolation="none")
        axes.axis("off")
        for letter, count, end, aligned in (("x", 1, (size[0], 0.0), "left"), ("y", 0, (0.0, size[1]), "right")):
            axes.annotate(
                f"{letter} {heights_um.shape[count] * pitch_um:.4g} µm",
                _project(np.array(end[0] / 2), np.array(end[1] / 2), np.array(0.0)),
                textcoords="offset points",
                xytext=(6 if aligned == "left" else -6, -5),
                ha=aligned,
                va="top",
            )
        axes.set_title(title, loc="left")
        axes.set_title(f"heights × {stretch:g}", loc="right", fontsize=8.5)
        axes.set(xlim=extent[:2], ylim=extent[2:])
        return to_svg(figure, name, f"3D view of the surface, heights {stretch:g} times too high. {title}")


def height_histogram(heights_um: FloatArray, name: str) -> str:
    """Probability density of the heights about their mean, beside the normal distribution of the same rms."""
    centred = (heights_um - heights_um.mean()).ravel()
    rms = float(centred.std())
    with style():
        figure, axes = new_axes(310, 214)
        if rms > 0:
            _density(axes, [centred], [f"heights, Sq = {rms:.3g} µm"], rms)
        axes.set(xlabel="height about the mean, µm", ylabel="density, 1/µm")
        _plain(axes)
        return to_svg(figure, name, f"Histogram of the heights, rms {rms:.3g} µm")


def slope_distribution(slopes: FloatArray, name: str) -> str:
    """Probability density of slopes [facets, (dz/dx, dz/dy)] along x and along y, and a normal one of the same rms."""
    rms = float(np.sqrt((slopes**2).mean()))
    with style():
        figure, axes = new_axes(310, 214)
        if rms > 0:
            labels = [f"dz/d{c}, rms {np.sqrt((s**2).mean()):.3g}" for c, s in zip("xy", slopes.T, strict=True)]
            _density(axes, list(slopes.T), labels, rms)
        axes.set(xlabel="slope of the facets", ylabel="density")
        _plain(axes)
        return to_svg(figure, name, f"Distribution of the slopes, rms {rms:.3g} in each direction")


def autocorrelation_figure(correlation: FloatArray, pitch_um: float, sal_um: float, fallen_to: float, name: str) -> str:
    """The autocorrelation [y, x], lag zero in the middle, along x, along y and averaged over all directions.

    `sal_um` is where it first falls to `fallen_to`, in the direction in which it does so soonest; NaN for nowhere.
    """
    middle = [count // 2 for count in correlation.shape]
    along = correlation[middle[0], middle[1] :], correlation[middle[0] :, middle[1]]
    ring = np.hypot(
        *np.ogrid[-middle[0] : correlation.shape[0] - middle[0], -middle[1] : correlation.shape[1] - middle[1]]
    )
    rings = np.rint(ring).astype(int).ravel()
    average = np.bincount(rings, correlation.ravel()) / np.bincount(rings)
    reach = min(middle) if np.isnan(sal_um) else min(int(6 * sal_um / pitch_um) + 4, *middle)
    with style():
        figure, axes = new_axes(310, 214)
        axes.axhline(0, color=INK, linewidth=0.6, alpha=0.4)
        for values, label, look in (
            (along[0], "along x", (_FIRST, "-")),
            (along[1], "along y", (_SECOND, "--")),
            (average, "mean of all directions", (INK, ":")),
        ):
            axes.plot(
                pitch_um * np.arange(reach),
                values[:reach],
                color=look[0],
                linestyle=look[1],
                label=label,
                linewidth=1.3,
            )
        if not np.isnan(sal_um):
            axes.plot(sal_um, fallen_to, marker="o", markersize=5, markerfacecolor="none", color=INK)
            axes.annotate(
                f"Sal = {sal_um:.3g} µm",
                (sal_um, fallen_to),
                textcoords="offset points",
                xytext=(8, 4),
            )
        axes.set(xlabel="lag, µm", ylabel="autocorrelation", xlim=(0, pitch_um * max(reach - 1, 1)))
        axes.legend(frameon=False, loc="upper right")
        _plain(axes)
        return to_svg(figure, name, "Autocorrelation of the heights over the lag")


def _plain(axes: "Axes") -> None:
    """Axes with a grid and without a frame at the top and at the right."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True)


def _density(axes: "Axes", samples: Sequence[FloatArray], labels: Sequence[str], rms: float) -> None:
    """Histograms as steps up to 4.5 rms and a normal distribution."""
    edges = np.linspace(-4.5 * rms, 4.5 * rms, 92)
    for values, label, colour, line in zip(samples, labels, (_FIRST, _SECOND), ("-", "--"), strict=False):
        counts = np.histogram(values, edges)[0] / (values.size * (edges[1] - edges[0]))
        axes.stairs(counts, edges, color=colour, linestyle=line, label=label, linewidth=1.3)
    fine = np.linspace(edges[0], edges[-1], 181)
    normal = np.exp(-((fine / rms) ** 2) / 2) / (np.sqrt(2 * np.pi) * rms)
    axes.plot(fine, normal, color=INK, linewidth=0.9, linestyle=":", label="normal, same rms")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0, 1.28 * axes.get_ylim()[1])
    axes.legend(frameon=False, loc="upper right", ncols=1)


def _coarser(heights_um: FloatArray, pitch_um: float, most: int) -> tuple[FloatArray, float]:
    """Means over square blocks, so that the longer side has about `most` of them at most, and their side, um."""
    block = max(1, -(-max(heights_um.shape) // most))
    rows, columns = (max(1, count // block) for count in heights_um.shape)
    whole = heights_um[: rows * block, : columns * block]
    return whole.reshape(rows, -1, columns, whole.shape[1] // columns).mean(axis=(1, 3)), block * pitch_um


def _range(heights_um: FloatArray) -> tuple[float, float]:
    """The heights that colours show, um; what lies beyond is a thousandth on either side."""
    low, high = np.quantile(heights_um, [0.001, 0.999])
    return (float(low), float(high)) if high > low else (float(low) - _FLAT, float(high) + _FLAT)


def _bar(axes: "Axes", low: float, high: float) -> None:
    """The colour bar of heights from `low` to `high`."""
    axes.imshow(np.linspace(0, 1, 128)[:, None], _COLOURS, extent=(0, 1, low, high), origin="lower", aspect="auto")
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")


def _round_stretch(wanted: float) -> float:
    """The 1, 2 or 5 times a power of ten that is next below what is wanted."""
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))


def _project(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right and up in the picture of a parallel projection; the surface's front left corner is nearest."""
    right = x * np.cos(_AZIMUTH) - y * np.sin(_AZIMUTH)
    away = x * np.sin(_AZIMUTH) + y * np.cos(_AZIMUTH)
    return right, away * np.sin(_ELEVATION) + z * np.cos(_ELEVATION)


def _rendered(
    relief: FloatArray, side: float, shade: FloatArray, scale: float
) -> tuple[FloatArray, tuple[float, float]]:
    """[up, right, rgba] picture with `scale` pixels per um, and the place of its lower left corner, um.

    In each column of the picture the points of the surface are gone through from the front to the back: what rises
    above all before it is seen. Below the front edge stands a wall down to the lowest height.
    """
    from matplotlib import colormaps  # noqa: PLC0415  (takes a second)

    rows, columns = relief.shape
    width, depth = columns * side, rows * side
    right = np.arange(-depth * np.sin(_AZIMUTH), width * np.cos(_AZIMUTH), 1 / scale)
    away = np.arange(0, width * np.sin(_AZIMUTH) + depth * np.cos(_AZIMUTH), side / 2)[:, None]
    x, y = right * np.cos(_AZIMUTH) + away * np.sin(_AZIMUTH), away * np.cos(_AZIMUTH) - right * np.sin(_AZIMUTH)
    inside = (x >= 0) & (x <= width) & (y >= 0) & (y <= depth)
    places = y / side - 0.5, x / side - 0.5
    dy, dx = np.gradient(relief, side)
    light = (_LIGHT[2] - dx * _LIGHT[0] - dy * _LIGHT[1]) / np.sqrt(1 + dx**2 + dy**2)
    z, colour, light = (
        scipy.ndimage.map_coordinates(v, places, order=1, mode="nearest") for v in (relief, shade, light)
    )
    rgba = colormaps[_COLOURS](np.clip(colour, 0, 1))
    rgba[..., :3] = np.clip(rgba[..., :3] * (0.4 + 0.75 * np.clip(light, 0, None))[..., None], 0, 1)
    up = np.where(inside, away * np.sin(_ELEVATION) + z * np.cos(_ELEVATION), -np.inf)
    horizon = np.maximum.accumulate(up, axis=0)
    levels = np.arange(0, horizon.max() + 1 / scale, 1 / scale)
    image = np.zeros((levels.size, right.size, 4))
    for i in np.flatnonzero(inside.any(axis=0)):
        seen = np.searchsorted(horizon[:, i], levels)
        front = int(np.argmax(inside[:, i]))
        shown = (seen < away.size) & (levels >= away[front, 0] * np.sin(_ELEVATION))
        image[shown, i] = rgba[seen[shown], i]
        image[shown & (levels < up[front, i]), i] = _WALL
    return image, (float(right[0]), 0.0)
