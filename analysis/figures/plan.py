"""A plan as pictures: the directions as seen from the sample, and the way of the arm between them."""

from collections.abc import Sequence

import numpy as np

from analysis.figures.svg import INK, SEQUENCE, new_axes, style, to_svg
from goniometer.geometry import BLOCKED_HALF_WIDTH, Geometry

_PLANNED, _SOURCE = SEQUENCE[0], SEQUENCE[3]
_INNERMOST = 0.4
"""Radius of the arc of the first incident angle; the last one's is 1."""


def polar_view(planned: Sequence[Geometry], name: str) -> str:
    """The directions around the surface normal, one arc for each incident angle, the steepest inside.

    A dot is a direction; a triangle shows from where the light comes, a dash across the arc its mirror direction, and
    hatching where the detector blocks it. `name` is unique in a page.
    """
    angles = sorted({g.theta_in for g in planned})
    with style():
        figure, axes = new_axes(460, 276, left=8, right=8, bottom=40, top=20)
        axes.set(xlim=(-1.22, 1.22), ylim=(-0.06, 1.18), aspect="equal")
        axes.axis("off")
        axes.plot([-1.05, 1.05], [0, 0], color=INK, linewidth=1.2)
        for i, theta_in in enumerate(angles):
            radius = 1.0 if len(angles) == 1 else _INNERMOST + (1 - _INNERMOST) * i / (len(angles) - 1)
            axes.plot(*_arc(radius, -90, 90), color=INK, linewidth=0.5, alpha=0.3)
            half = 0.32 * (1 - _INNERMOST) / max(len(angles) - 1, 3)
            low, high = max(-theta_in - BLOCKED_HALF_WIDTH, -90), -theta_in + BLOCKED_HALF_WIDTH
            inner, outer = _arc(radius - half, low, high), _arc(radius + half, high, low)
            axes.fill(
                *np.hstack([inner, outer]), facecolor="none", edgecolor=INK, alpha=0.55, hatch="/////", linewidth=0.4
            )
            axes.plot(*_arc(radius, -theta_in, -theta_in), marker="v", color=_SOURCE, markersize=3.5)
            axes.plot(
                *np.column_stack([_at(radius - half, theta_in), _at(radius + half, theta_in)]), color=INK, linewidth=1.2
            )
            xs, ys = zip(*(_at(radius, g.theta_out) for g in planned if g.theta_in == theta_in), strict=True)
            axes.scatter(xs, ys, s=7, facecolor=_PLANNED, edgecolor="none", zorder=3)
        for angle in range(-90, 91, 30):
            axes.text(*_at(1.12, angle), f"{angle}°".replace("-", "−"), ha="center", va="center")
        shells = f"arcs: incident angles {angles[0]:g}° (inside) to {angles[-1]:g}° (outside)"
        shells = shells if len(angles) > 1 else f"incident angle {angles[0]:g}°"
        marks = "▾ light, ‒ mirror direction, hatched: blocked"
        axes.text(-1.2, 1.17, "theta_out around the normal", ha="left", va="top")
        axes.text(0, -0.04, f"{shells}\n{marks}", ha="center", va="top", linespacing=1.4)
        label = f"Polar view of {len(planned)} directions at {len(angles)} incident angles"
        return to_svg(figure, name, label)


def arm_view(path: Sequence[Geometry], name: str) -> str:
    """Where both stages stand, in the order of `path`; faint lines are the moves. `name` is unique in a page."""
    detector = [g.detector_angle for g in path]
    sample = [g.sample_angle for g in path]
    with style():
        figure, axes = new_axes(460, 276, bottom=38, top=26)
        low, high = -BLOCKED_HALF_WIDTH, BLOCKED_HALF_WIDTH
        axes.axvspan(low, high, facecolor="none", edgecolor=INK, alpha=0.45, hatch="/////", linewidth=0.4)
        axes.plot(detector, sample, color=INK, linewidth=0.7, alpha=0.45)
        axes.scatter(detector, sample, s=9, color=_PLANNED, edgecolor="none", zorder=3)
        axes.plot(detector[:1], sample[:1], marker="o", markersize=7, markerfacecolor="none", color=_SOURCE)
        axes.plot(detector[-1:], sample[-1:], marker="s", markersize=7, markerfacecolor="none", color=_SOURCE)
        for text, stage in (("start", 0), ("end", -1)):
            axes.annotate(
                text,
                (detector[stage], sample[stage]),
                textcoords="offset points",
                xytext=(7, 4),
                color=_SOURCE,
                fontsize=8.5,
            )
        blocked = f"blocked: detector in the beam, ±{BLOCKED_HALF_WIDTH:g}°"
        axes.annotate(
            blocked,
            (0, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8.5,
        )
        margin = 0.06 * max(max(sample) - min(sample), 10.0)
        axes.set(
            xlim=(-95, 180),
            ylim=(min(sample) - margin, max(sample) + margin),
            xlabel="detector stage from the source axis, degrees",
            ylabel="sample stage, degrees",
        )
        axes.set_xticks(range(-90, 181, 30))
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True)
        return to_svg(
            figure, name, f"Way of the arm through {len(path)} directions; hatched where it blocks the source"
        )


def _at(radius: float, angle: float) -> tuple[float, float]:
    """Place of an angle from the normal, degrees."""
    return radius * float(np.sin(np.radians(angle))), radius * float(np.cos(np.radians(angle)))


def _arc(radius: float, start: float, stop: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """[2, points] an arc between two angles from the normal, degrees."""
    angles = np.radians(np.linspace(start, stop, 61))
    return radius * np.stack([np.sin(angles), np.cos(angles)])
