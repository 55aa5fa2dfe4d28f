"""The simplest model that a scene needs: every rung of the ladder seen on the same vertices as the measurement.

The error of a rung is the mean CIEDE2000 over the pixels that show the material, between what it and what the
measurement make of the scene, both shown with one exposure. It is uncertain for two reasons, and both are carried
along. The measurement does not know everything: draws of its errors give as many scenes that are as probable, the
expected error of a rung is the mean over them, and its interval holds most of them. A model that is no further from
the measurement than the measurement may be from the truth may be the truth but for its parameters, which may be known
better: its interval then holds what their errors make as well. And the trace has few samples,
which its two halves tell: a rung meets the tolerance, or is refused, when the expected error is on that side of it by
two standard errors of the trace; else it is undetermined, and more samples are asked for before this is the answer. The
ladder is not monotone, so every rung is looked at; it is not climbed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.choices import State
from analysis.reflectance.fresnel import Conductor
from analysis.results import ModelFit
from analysis.scenes.asked import Asked, asked
from analysis.scenes.brdf_table import Reference, at_nodes, between_nodes
from analysis.scenes.ladder import DOUBT_STEP, Rung, ladder, table_rung
from analysis.scenes.vertices import DARK, Display, Vertices, display_for, image, to_pixels, xyz_of_vertices
from drivers.arrays import FloatArray

NODES = np.arange(400.0, 701.0, 10.0)
"""Wavelengths at which rungs are compared before they are reduced, nm."""

FEWER = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20)
"""Numbers of wavelengths to which the chosen rung is reduced, if that will do; more are not always better."""

FEW_SAMPLES, MANY_SAMPLES = 64, 256
"""Samples of a pixel at first, and where these leave a rung undetermined."""

INTERVAL = (5.0, 95.0)
"""Percentiles of the draws between which the interval of an error reaches, before the error of the trace is added."""

DOUBT_NODES = 6
"""Wavelengths at which it is looked what errors of the parameters do."""

_STANDARD_ERRORS = 2.0


@dataclass(frozen=True)
class Score:
    """How far a rung is from the measurement in a scene; colour differences are CIEDE2000."""

    mean: float
    """Over all pixels that show the material, if the measurement were exact; what noise made of it is taken off."""
    p95: float
    expected: float
    """Mean over what the measurement leaves possible."""
    u_trace: float
    """Standard error of `mean` and `expected` by the samples of the trace."""
    low: float
    """Ends of the interval: 90 % of what the measurement leaves possible, and two `u_trace` beyond; of a model that may
    be right, also of what the errors of its parameters do to it."""
    high: float


@dataclass(frozen=True)
class Judged:
    """One rung in a scene."""

    rung: Rung
    wavelengths: FloatArray
    """[nodes] nm, at which it was evaluated."""
    score: Score
    state: State
    nanoseconds: float
    """Of an evaluation of one direction at one wavelength, on this computer."""
    why: str
    """Why it is refused, or what speaks for it; a sentence."""

    @property
    def parameters(self) -> int:
        """Numbers that the model has."""
        return self.rung.parameters(self.wavelengths.size)

    @property
    def size(self) -> int:
        """Bytes of these numbers in single precision."""
        return 4 * self.parameters


@dataclass(frozen=True)
class Picture:
    """What the scene looks like; [target pixels, 3] XYZ each."""

    display: Display
    reference: FloatArray
    chosen: FloatArray | None
    """None where no rung was chosen."""
    clipped: float
    """Share of pixels that are brighter than the display."""
    dark: float
    """Share of pixels with Y below `DARK`, where a colour difference says little."""


@dataclass(frozen=True)
class Choice:
    """The answer for one scene."""

    tolerance: float
    judged: tuple[Judged, ...]
    """All rungs at all wavelengths, cheapest first."""
    chosen: Judged | None
    """The cheapest that meets the tolerance, with the fewest wavelengths; None where none does for certain."""
    tried: tuple[Judged, ...]
    """The chosen rung at fewer wavelengths, which do not suffice."""
    vertices: Vertices
    picture: Picture
    asked: Asked
    """Directions that the scene asks for."""


def least_directions(choice: Choice, judged: Judged) -> int:
    """How many directions must be measured for a model at the least.

    A model has as many unknowns as parameters that describe directions, each measured direction telling all
    wavelengths; a table has to know every cell that the scene asks for.
    """
    return choice.asked.cells if judged.rung.name == "table" else max(len(judged.rung.shape), 1)


def choose(
    trace: Callable[[int], Vertices],
    reference: Reference,
    fits: tuple[ModelFit, ...],
    metal: Conductor,
    tolerance: float,
) -> Choice:
    """The cheapest rung, and the fewest wavelengths, whose error in a scene stays below `tolerance`, a mean CIEDE2000.

    `trace` gives the vertices for a number of samples of a pixel; `fits` are those of the ladder, simplest first.
    """
    found = _choose(trace(FEW_SAMPLES), reference, fits, metal, tolerance)
    if any(judged.state == "undetermined" for judged in (*found.judged, *found.tried)):
        return _choose(trace(MANY_SAMPLES), reference, fits, metal, tolerance)
    return found


def _choose(
    vertices: Vertices, reference: Reference, fits: tuple[ModelFit, ...], metal: Conductor, tolerance: float
) -> Choice:
    seen = _Seen.of(vertices, reference)
    rungs = (*ladder(vertices, reference.table, NODES, fits, metal), table_rung(reference.table))
    doubts = [_of_parameters(seen, rung) for rung in rungs]
    judged = tuple(_judged(seen, rung, NODES, tolerance, doubt) for rung, doubt in zip(rungs, doubts, strict=True))
    meeting = next((each for each in judged if each.state == "meets"), None)
    tried: list[Judged] = []
    chosen = meeting
    if meeting is not None:
        doubt = doubts[judged.index(meeting)]
        for count in FEWER:
            fewer = _judged(seen, meeting.rung, nodes(count), tolerance, doubt)
            if fewer.state == "meets":
                chosen = fewer
                break
            tried.append(fewer)
    picture = Picture(
        seen.display,
        seen.reference.mean(axis=0),
        None if chosen is None else image(vertices, chosen.rung.model, chosen.wavelengths).mean(axis=0),
        *_unshown(seen),
    )
    return Choice(tolerance, judged, chosen, tuple(tried), vertices, picture, seen.asked)


def nodes(count: int) -> FloatArray:
    """[count] wavelengths, nm, evenly over where the eye sees most.

    >>> nodes(1).tolist(), nodes(3).tolist()
    ([550.0], [450.0, 550.0, 650.0])
    """
    edge = 150 * (count - 1) / count
    return np.linspace(550 - edge, 550 + edge, count) if count != 3 else np.array([450.0, 550.0, 650.0])


@dataclass(frozen=True)
class _Seen:
    """The scene by the measurement."""

    vertices: Vertices
    display: Display
    reference: FloatArray
    """[2, pixels, 3] XYZ of the halves."""
    possible: FloatArray
    """[draws, pixels, 3] XYZ of what the measurement leaves possible,"""
    own_error: float
    """and the mean difference from `reference` that all but the farthest of them have."""
    asked: Asked

    @classmethod
    def of(cls, vertices: Vertices, reference: Reference) -> "_Seen":
        """See the scene."""
        of_vertices = xyz_of_vertices(vertices, reference.table, NODES)
        pixels = to_pixels(vertices, of_vertices)
        place = between_nodes(reference.table, vertices.directions)
        possible = np.stack(
            [to_pixels(vertices, of_vertices * np.exp(at_nodes(draw, place))).mean(axis=0) for draw in reference.draws]
        )
        display = display_for(vertices, pixels.mean(axis=0))
        off = [float(display.difference(truth, pixels.mean(axis=0)).mean()) for truth in possible]
        own_error = float(np.percentile(off, INTERVAL[1]))
        return cls(vertices, display, pixels, possible, own_error, asked(vertices, of_vertices, display))


def _of_parameters(seen: _Seen, rung: Rung) -> FloatArray:
    """[draws] mean difference of a rung from itself with other parameters that are as probable; none without doubt.

    What small errors of the parameters do to an image is linear in them.
    """
    if not rung.doubt:
        return np.zeros(0)
    few = nodes(DOUBT_NODES)
    mine = image(seen.vertices, rung.model, few).mean(axis=0)
    moved = np.stack([image(seen.vertices, each, few).mean(axis=0) - mine for each in rung.doubt]) / DOUBT_STEP
    drawn = np.random.default_rng(1).standard_normal((len(seen.possible), len(moved)))
    others = mine + np.einsum("dk,kpc->dpc", drawn, moved)
    return np.array([float(seen.display.difference(other, mine).mean()) for other in others])


def _judged(seen: _Seen, rung: Rung, wavelengths: FloatArray, tolerance: float, doubt: FloatArray) -> Judged:
    found = _score(seen, image(seen.vertices, rung.model, wavelengths), doubt)
    edge = _STANDARD_ERRORS * found.u_trace
    state: State
    if rung.unknown:
        state, why = "not identified", " ".join(rung.unknown)
    elif found.expected + edge <= tolerance:
        state, why = "meets", f"Expected {found.expected:.2f} is below the tolerance of {tolerance:g}."
    elif found.expected - edge > tolerance:
        state, why = "fails", f"Expected {found.expected:.2f} is above the tolerance of {tolerance:g}."
    else:
        state = "undetermined"
        why = f"Expected {found.expected:.2f} is within {edge:.2f}, the error of the trace, of {tolerance:g}."
    return Judged(rung, wavelengths, found, state, rung.nanoseconds(seen.vertices.directions), why)


def _score(seen: _Seen, halves: FloatArray, doubt: FloatArray) -> Score:
    """Of an image [2, pixels, 3]; `doubt` [draws] as of `_of_parameters`."""
    mine = halves.mean(axis=0)
    whole = seen.display.difference(seen.reference.mean(axis=0), mine)
    parts = [seen.display.difference(a, b) for a, b in zip(seen.reference, halves, strict=True)]
    mean, noise = without_noise(float(whole.mean()), [float(part.mean()) for part in parts])
    p95, _ = without_noise(p95_of(whole), [p95_of(part) for part in parts])
    u_trace = math.hypot(0.5 * float(parts[0].mean() - parts[1].mean()), noise)
    possible = np.array([float(seen.display.difference(truth, mine).mean()) for truth in seen.possible])
    # the noise of the trace is in all of them as it is in the mean
    possible = np.sqrt(np.maximum(possible**2 - (float(whole.mean()) ** 2 - mean**2), 0.0))
    may_be_right = doubt.size > 0 and mean <= seen.own_error
    ends = np.percentile(possible, INTERVAL), *([np.percentile(doubt, INTERVAL)] if may_be_right else [])
    low, high = float(np.min(ends)), float(np.max(ends))
    edge = _STANDARD_ERRORS * u_trace
    return Score(mean, p95, float(possible.mean()), u_trace, max(low - edge, 0.0), high + edge)


def p95_of(differences: FloatArray) -> float:
    """95th percentile."""
    return float(np.percentile(differences, 95))


def without_noise(whole: float, halves: list[float]) -> tuple[float, float]:
    """A mean difference of noisy images without what the noise makes of it, and half of that as its standard error.

    `halves` are those of images from half of the samples each, in which the square of the noise is twice as large.
    Noise and difference add in squares.

    >>> without_noise(5.0, [34**0.5, 34**0.5])
    (4.0, 0.5)
    """
    square = 2 * whole**2 - (sum(halves) / len(halves)) ** 2
    clean = min(math.sqrt(max(square, 0.0)), whole)
    return clean, 0.5 * (whole - clean)


def _unshown(seen: _Seen) -> tuple[float, float]:
    """Shares of the target that are brighter than the display, and dark."""
    shown = seen.display.shown(seen.reference.mean(axis=0))
    bright = seen.reference.mean(axis=0)[:, 1] * seen.display.exposure
    return float(np.mean(shown.max(axis=1) >= 1.0)), float(np.mean(bright < DARK))
