"""How the lamp drifts, from exposures in one direction that are repeated while a scan goes on.

A halogen lamp that becomes hotter becomes brighter and bluer. The ratio of a monitor exposure to the first one of its
scan is described by two numbers, level + tilt (600 nm / wavelength - 1): by Wien's law a change of the lamp's
temperature has level = tilt, a change of anything grey has tilt 0. Between monitors the two are interpolated linearly
in time. What the line misses is judged by the monitors themselves: a parabola departs from its chord by its second
difference / sqrt(120) in the mean square, and noise s of the monitors leaves third differences of sqrt(20) s.

The same lamp must be compared between two scans, and other samples lie on the bench in between. The lamp is taken as
unchanged between the last monitor of a scan and the first of the next, with an uncertainty: what it drifted in as
long a time while it was watched.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import CalibrationError
from goniometer.radiometry.raw import RawScan
from goniometer.radiometry.signal import CORRECTIONS_OF_A_SHOT, linear
from goniometer.uncertainty import Groups

REFERENCE_WAVELENGTH = 600.0
"""Where the tilt is zero, nm."""

BRIGHT = 0.1
"""Pixels of the monitor that have at least this part of its brightest one tell of the lamp."""


@dataclass(frozen=True)
class LampDrift:
    """What the monitors of one scan tell."""

    level: FloatArray
    """[points] relative change of the lamp at 600 nm since the first monitor, where the point was taken."""
    tilt: FloatArray
    """[points] the same of the tilt."""
    interval: Groups
    """[points] number of the pair of monitors between which a point was taken; its points share an error."""
    u_interval: float
    """Relative standard uncertainty of the lamp at a point: noise of the monitors, and what interpolation misses."""
    end: tuple[float, float]
    """Level and tilt at the last monitor."""
    pace: float
    """Relative change per second, root mean square between successive monitors."""
    begins: tuple[str, float]
    """Session and moment, seconds, of the first monitor."""
    ends: tuple[str, float]
    """Of the last one."""
    largest: float
    """Largest relative change of the level among the monitors."""


@dataclass(frozen=True)
class LampBetween:
    """How the lamp changed from the first monitor of one scan to the first of another."""

    level: float
    tilt: float
    u: float
    """Relative standard uncertainty."""


def factor(level: FloatArray, tilt: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[points, wavelengths] output of the lamp, 1 at the first monitor; `level`, `tilt` [points], nm."""
    shape = REFERENCE_WAVELENGTH / wavelengths - 1
    return np.asarray(1 + level[:, None] + tilt[:, None] * shape)


def lamp_drift(raw: RawScan) -> LampDrift | None:
    """What the monitors of a scan tell about its points; None where there are fewer than two.

    Level and tilt are linear in time between two monitors of the session in which a point was taken, and constant
    beyond its first and last. Raises `CalibrationError` where the monitors are saturated or a point has no spectrum.
    """
    if len(raw.monitors) < 2:
        return None
    levels, u_counts = _levels(raw)
    moments = np.array([m.moment for m in raw.monitors])
    first_ids = np.array([m.ids[0] for m in raw.monitors])
    # moments of two sessions cannot be compared, so nothing can be interpolated between them
    sessions = [m.session for m in raw.monitors]
    runs = np.cumsum([0, *(a != b for a, b in pairwise(sessions))])
    of_point = {shot.point: shot for shot in raw.shots}  # the last shot of a point stands for all of it
    if len(of_point) < len(raw.planned):
        raise CalibrationError(f"A point of scan {raw.scan_id} is done but has no spectrum; measure it again")
    shots = [of_point[i] for i in range(len(raw.planned))]
    before = np.array([np.searchsorted(first_ids, shot.ids[0]) - 1 for shot in shots], dtype=np.intp)
    found = np.zeros((len(shots), 2))
    for i, shot in enumerate(shots):
        mine = runs == runs[max(before[i], 0)]
        found[i] = [np.interp(shot.moment, moments[mine], column[mine]) for column in levels.T]
    steady = np.diff(runs) == 0
    u_interval = _interpolation(levels[:, 0], steady, u_counts, raw.constants.bench.u_lamp)
    return LampDrift(
        level=found[:, 0],
        tilt=found[:, 1],
        interval=before - before.min() if before.size else before,
        u_interval=u_interval,
        end=(float(levels[-1, 0]), float(levels[-1, 1])),
        pace=_pace(levels[:, 0], moments, steady),
        begins=(sessions[0], float(moments[0])),
        ends=(sessions[-1], float(moments[-1])),
        largest=float(np.abs(levels[:, 0]).max()),
    )


@dataclass(frozen=True)
class LampSeries:
    """What every monitor of one scan tells; all arrays [monitors]."""

    moments: FloatArray
    """Seconds since the first one; those of two sessions cannot be compared."""
    sessions: tuple[str, ...]
    level: FloatArray
    """Relative change of the lamp at 600 nm since the first one."""
    tilt: FloatArray
    """The same of the tilt."""


def lamp_series(raw: RawScan) -> LampSeries | None:
    """What the monitors of a scan tell one by one; None where there are fewer than two.

    Raises `CalibrationError` where they are saturated.
    """
    if len(raw.monitors) < 2:
        return None
    moments = np.array([m.moment for m in raw.monitors])
    levels, _ = _levels(raw)
    sessions = tuple(m.session for m in raw.monitors)
    return LampSeries(moments - moments[0], sessions, levels[:, 0], levels[:, 1])


def lamp_between(scans: list[RawScan]) -> LampBetween | None:
    """Change of the lamp from the first monitor of the first of successive `scans` to the first of the last one.

    A scan between them that has no monitors makes the pause longer. None where the first or the last has too few.
    Raises as `lamp_drift`.
    """
    drifts = [lamp_drift(scan) for scan in scans]
    if drifts[0] is None or drifts[-1] is None:
        return None
    u_lamp = scans[0].constants.bench.u_lamp
    level, tilt, variance = 0.0, 0.0, 0.0
    for here, then in pairwise(drift for drift in drifts if drift is not None):
        level, tilt = (1 + level) * (1 + here.end[0]) - 1, tilt + here.end[1]
        if here.ends[0] == then.begins[0]:
            gap = max(here.pace, then.pace) * (then.begins[1] - here.ends[1])
        else:  # nobody knows how long it was, or whether the lamp burned
            gap = max(here.largest, u_lamp)
        variance += gap**2 + here.u_interval**2
    return LampBetween(level, tilt, float(np.sqrt(variance)))


def _levels(raw: RawScan) -> tuple[FloatArray, float]:
    """[monitors, 2] level and tilt of each monitor relative to the first, by weighted least squares.

    Also the standard uncertainty of a level by the noise of the counts. Raises `CalibrationError` where the monitors
    are saturated.
    """
    parts = [linear(raw, shot, CORRECTIONS_OF_A_SHOT) for shot in raw.monitors]
    first = parts[0].rate
    unsaturated = ~np.any([part.saturated for part in parts], axis=0)
    if not unsaturated.any():
        raise CalibrationError(
            f"The looks at the lamp of scan {raw.scan_id} are saturated; calibrate without the correction for drift"
        )
    bright = unsaturated & (first > BRIGHT * first[unsaturated].max())
    shape = REFERENCE_WAVELENGTH / raw.constants.wavelengths[bright] - 1
    columns = np.stack([np.ones_like(shape), shape], axis=1)
    root_weight = np.sqrt(first[bright])  # relative shot noise falls with the root of the signal
    changes = np.array([part.rate[bright] / first[bright] - 1 for part in parts])
    estimator = np.linalg.pinv(columns * root_weight[:, None]) * root_weight
    variance = (parts[0].variance + parts[-1].variance)[bright] / first[bright] ** 2
    return np.asarray(changes @ estimator.T), float(np.sqrt(estimator[0] ** 2 @ variance))


def _pace(level: FloatArray, moments: FloatArray, steady: BoolArray) -> float:
    """Relative change per second, root mean square over pairs of monitors of one session."""
    steps, pauses = np.diff(level)[steady], np.diff(moments)[steady]
    return float(np.sqrt(np.mean((steps / pauses) ** 2))) if steps.size else 0.0


def _interpolation(level: FloatArray, steady: BoolArray, u_counts: float, u_lamp: float) -> float:
    """Relative standard uncertainty of what is interpolated between monitors."""
    mean_squares = []
    for order in (2, 3):
        differences = np.diff(level, n=order)
        # only those of which all monitors belong to one session
        whole = [bool(steady[i : i + order].all()) for i in range(differences.size)]
        mean_squares.append(float(np.mean(differences[whole] ** 2)) if any(whole) else None)
    second, third = mean_squares
    if second is None:
        # two monitors say how much the lamp changed and not how it went there and back
        return float(np.hypot(np.abs(level).max() / 2, u_lamp / 4))
    noise = second / 6 if third is None else min(third / 20, second / 6)
    judged = np.sqrt(max(second - 6 * noise, 0.0) / 120 + 2 / 3 * noise)
    return float(np.hypot(judged, u_counts))
