"""Which integration times a point gets, and how its spectra are taken.

Times come from a short ladder, so that a handful of dark spectra serves a whole scan. The choice depends on
stored exposures and on what the detector sees now, never on what a process remembers: a resumed scan chooses
as an uninterrupted one would have.

Without a wanted signal-to-noise ratio a point gets `scans` spectra of the longest time that keeps its brightest pixel
below `fill` of saturation. With one it gets the integration time and the number of spectra that reach the ratio in the
least time. The ratio is that of the median bin: pixels are binned as calibration does by default, six by six between
380 and 995 nm, and half of the bins do at least as well. Its noise is the random one of the point's own spectra,

    u^2 = (signal / gain + 6 read variance) / number of spectra,   in counts of one spectrum,

shot noise and the read-out noise that the repeated darks show, dark current included.

Where `exposures` allows it, a point also gets longer times, at which bright pixels saturate and dim ones fill.
"""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import CountArray, FloatArray
from drivers.interfaces import Spectrum
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Integration
from goniometer.constants import Constants
from goniometer.errors import CampaignError
from goniometer.radiometry.response import STANDARD
from goniometer.storage.records import Point

BIN = STANDARD.bin_size
"""Pixels of one bin."""

DIM = 0.1
"""The dim bins of a spectrum: this part of them is dimmer still."""

PROBE_FRACTION = 1 / 256
"""A probe lasts about this part of the longest integration time."""

STEP_DOWN = 16
"""After a saturated spectrum the integration time becomes shorter by this factor."""

TOO_DARK = 4
"""A spectrum is taken again when this many times its integration time would have been right."""

ALIKE = 2.0
"""Two neighbours predict the brightness between them when they differ by less than this factor."""

DARK_LEVEL = 2000.0
"""Counts set aside for offset and dark current when a time is chosen; `fill` leaves room for more."""

NEARLY = 1.1
"""Of two integration times whose costs differ by less than this factor the longer one is taken: fewer read-outs."""

MOST_SPECTRA = 1000
"""More are never averaged at one integration time."""

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Detector:
    """What exposure control must know of the detector."""

    saturation: int
    """Counts at and above which a pixel is saturated."""
    gain: float
    """Electrons per count."""
    bins: NDArray[np.intp]
    """[bins, BIN] the pixels of each bin."""


@dataclass(frozen=True)
class DarkSignal:
    """What the detector reads without light at one integration time."""

    mean: FloatArray
    """[pixels] counts."""
    read_variance: float
    """Variance of one read-out of one pixel, counts squared."""
    temperature: float
    """Of the detector, degrees Celsius."""


@dataclass(frozen=True)
class Brightness:
    """What a direction looked like in its shortest exposure; rates are dark-subtracted counts per second."""

    brightest: float
    """Of the brightest pixel; infinite when it was saturated."""
    median: float
    """Of the median bin."""
    dim: float
    """Of the bin at the quantile `DIM`."""
    read_variance: float
    """Variance of one read-out of one pixel at its integration time, counts squared."""


@dataclass(frozen=True)
class Taken:
    """The spectra of one point."""

    spectra: list[Spectrum]
    """Grouped by integration time, the shortest first."""
    moment: float
    """Mean time of the exposures, seconds on the clock of the bench."""
    brightness: Brightness
    signal_to_noise: float
    """Ratio that the spectra of the shortest time reach in the median bin."""
    reason: str
    """What is less than was wanted, as a sentence; empty otherwise."""


DarkOf = Callable[[float, float], Awaitable[DarkSignal]]
"""Dark signal of an integration time, s, at a detector temperature, degrees Celsius."""


def detector_of(constants: Constants) -> Detector:
    """The detector of a scan; pixels that do not fill the last bin are left out."""
    wavelengths = constants.wavelengths
    used = np.flatnonzero((wavelengths >= STANDARD.lowest) & (wavelengths <= STANDARD.highest))
    return Detector(constants.saturation, constants.bench.gain, used[: len(used) // BIN * BIN].reshape(-1, BIN))


def ladder(policy: Integration) -> tuple[float, ...]:
    """The allowed integration times, seconds, ascending whole microseconds: maximum, its half, ... minimum."""
    times = [policy.maximum]
    while times[-1] / 2 > policy.minimum:
        times.append(times[-1] / 2)
    return tuple(sorted({round(time * 1e6) / 1e6 for time in [policy.minimum, *times]}))


def once(policy: Integration) -> Integration:
    """The policy of a single spectrum of the time that suits what is seen."""
    return policy.model_copy(update={"scans": 1, "signal_to_noise": None, "exposures": 1})


def step_down(time: float, policy: Integration) -> float:
    """Integration time, s, that is tried after a spectrum of `time` seconds was saturated; at least the shortest."""
    times = ladder(policy)
    return max((t for t in times if t <= time / STEP_DOWN), default=times[0])


def check_limits(policy: Integration, instrument: Instrument) -> None:
    """Raise `CampaignError` where the spectrometer cannot take the times that the campaign asks for."""
    low, high = instrument.integration_limits
    if policy.minimum < low or policy.maximum >= high:
        raise CampaignError(
            f"Integration times of {policy.minimum:g} to {policy.maximum:g} s are not possible: this spectrometer "
            f"takes {low:g} s and more, but less than {high:g} s; change integration.minimum or maximum"
        )


def brightness(counts: CountArray, integration_time: float, dark: DarkSignal, detector: Detector) -> Brightness:
    """What the mean of `counts` [scans, pixels] of one integration time, s, shows."""
    above = counts.mean(axis=0) - dark.mean
    bins = above[detector.bins].sum(axis=1) / integration_time
    saturated = counts.max() >= detector.saturation
    return Brightness(
        inf if saturated else float(above.max() / integration_time),
        float(np.median(bins)),
        float(np.quantile(bins, DIM)),
        dark.read_variance,
    )


def predict(theta_out: float, seen: Sequence[tuple[float, Brightness]]) -> Brightness | None:
    """Brightness expected at `theta_out`, degrees; None where the neighbours do not tell.

    `seen` is theta_out and brightness of earlier points of the same incident angle. The nearest point on either side
    tells when they are alike; the brighter one is taken, to be safe.
    """
    below = [s for s in seen if s[0] < theta_out]
    above = [s for s in seen if s[0] > theta_out]
    if not below or not above:
        return None
    pair = max(below, key=lambda s: s[0])[1], min(above, key=lambda s: s[0])[1]
    dimmer, brighter = sorted(pair, key=lambda b: b.brightest)
    # Below one count per second everything is equally dark.
    return brighter if brighter.brightest < ALIKE * max(dimmer.brightest, 1.0) else None


def signal_to_noise(rate: float, time: float, scans: int, read_variance: float, gain: float) -> float:
    """Ratio that `scans` spectra of `time` seconds reach in a bin of `rate` counts per second; 0 in the dark."""
    signal = rate * time
    return signal * sqrt(scans / (signal / gain + BIN * read_variance)) if signal > 0 else 0.0


def averages(rate: float, time: float, read_variance: float, gain: float, wanted: float) -> float:
    """Least number of spectra of `time` seconds that reach the `wanted` ratio in a bin; infinite in the dark."""
    once = signal_to_noise(rate, time, 1, read_variance, gain)
    return max(ceil((wanted / once) ** 2 - _ROUNDING), 1) if once > 0 else inf


def most(time: float, policy: Integration) -> int:
    """How many spectra of `time` seconds a point may have, at least one."""
    return min(max(int(policy.time_limit / time + _ROUNDING), 1), MOST_SPECTRA)


def choose(seen: Brightness, policy: Integration, detector: Detector, ceiling: float = inf) -> tuple[float, int]:
    """Integration time, s, and number of spectra for a direction that looks like `seen`.

    The brightest pixel stays below the wanted fill; times from `ceiling` on are known to saturate. Where the wanted
    signal-to-noise ratio cannot be reached in the allowed time, what comes nearest.
    """
    room = policy.fill * detector.saturation - DARK_LEVEL
    times = ladder(policy)
    fitting = [t for t in times if t * seen.brightest <= room and t < ceiling] or [times[0]]
    wanted = policy.signal_to_noise
    if wanted is None:
        return fitting[-1], policy.scans
    affordable = [t for t in fitting if t <= policy.time_limit] or fitting[:1]
    needed = {t: averages(seen.median, t, seen.read_variance, detector.gain, wanted) for t in affordable}
    enough = {t: n for t, n in needed.items() if n <= most(t, policy)}
    if enough:
        least = min(n * t for t, n in enough.items())
        time = max(t for t, n in enough.items() if n * t <= NEARLY * least)
        return time, int(enough[time])

    def reached(t: float) -> float:
        return signal_to_noise(seen.median, t, most(t, policy), seen.read_variance, detector.gain)

    time = max(affordable, key=lambda t: (reached(t), t))
    return time, most(time, policy)


def _correct(
    time: float, probing: bool, seen: Brightness, policy: Integration, detector: Detector, ceiling: float
) -> float:
    """Integration time to go on with, after the first spectrum of `time` seconds has shown `seen`."""
    better, scans = choose(seen, policy, detector, ceiling)
    too_dark = probing or better >= TOO_DARK * time
    if policy.signal_to_noise is None:
        return better if too_dark else time
    here = averages(seen.median, time, seen.read_variance, detector.gain, policy.signal_to_noise)
    if here <= most(time, policy):
        return better if (here - 1) * time > scans * better else time  # the first spectrum is paid for
    enough = averages(seen.median, better, seen.read_variance, detector.gain, policy.signal_to_noise) <= scans
    return better if too_dark or enough else time


def longer(seen: Brightness, time: float, scans: int, policy: Integration, detector: Detector) -> list[float]:
    """Further integration times, s, ascending, for the dim bins of a point that has `scans` spectra of `time` seconds.

    As long as the dim bins do not saturate and, where a signal-to-noise ratio is wanted, no longer than they need to
    reach it in one spectrum; the middle one of three times lies halfway on the ladder.
    """
    wanted, gain = policy.signal_to_noise, detector.gain
    left = inf if wanted is None else policy.time_limit - scans * time
    room = policy.fill * detector.saturation - DARK_LEVEL
    allowed = [t for t in ladder(policy) if t > time and t <= left and t * seen.dim / BIN <= room]
    if policy.exposures == 1 or not allowed:
        return []
    last = allowed[-1]
    if wanted is not None:
        if signal_to_noise(seen.dim, time, scans, seen.read_variance, gain) >= wanted:
            return []
        reaching = (t for t in allowed if signal_to_noise(seen.dim, t, 1, seen.read_variance, gain) >= wanted)
        last = next(reaching, last)
    between = [t for t in allowed if t < last and t + last <= left] if policy.exposures > 2 else []
    halfway = log(time * last) / 2
    return [*sorted(between, key=lambda t: abs(log(t) - halfway))[:1], last]


async def take(
    instrument: Instrument, detector: Detector, policy: Integration, predicted: Brightness | None, dark: DarkOf
) -> Taken:
    """Valid spectra of where the instrument stands.

    `predicted` is the brightness by `predict`; without it a short probe comes first. A spectrum that is saturated or
    of a bad integration time is taken again at once; one that is saturated at the shortest time is accepted, and
    calibration flags it. The time limit is for the spectra that are kept.
    """
    times = ladder(policy)
    moments: list[tuple[float, float]] = []

    async def expose(time: float, scans: int) -> list[Spectrum]:
        spectra = await (instrument.sequence(time, scans) if scans > 1 else _one(instrument, time))
        moments.append((instrument.clock.now() - scans * time / 2, scans * time))
        return spectra

    async def look(spectra: list[Spectrum]) -> Brightness:
        temperature = float(np.mean([s.detector_temperature for s in spectra]))
        time = spectra[0].integration_time
        return brightness(np.stack([s.counts for s in spectra]), time, await dark(time, temperature), detector)

    if predicted is None:
        time = max((t for t in times if t <= policy.maximum * PROBE_FRACTION), default=times[0])
    else:
        time, _ = choose(predicted, policy, detector)
    probing, ceiling, tried = predicted is None, inf, set[float]()
    while True:
        moments.clear()  # only what is kept counts
        spectra = await expose(time, 1)
        if spectra[0].counts.max() >= detector.saturation:
            if time == times[0]:
                break
            ceiling = min(ceiling, time)
            time = step_down(time, policy)
        else:
            tried.add(time)
            better = _correct(time, probing, await look(spectra), policy, detector, ceiling)
            if better in tried:
                break
            time = better
        probing = False
    seen = await look(spectra)
    while (missing := _missing(seen, time, len(spectra), policy, detector)) > 0:
        spectra = spectra + await expose(time, missing)
        seen = await look(spectra)
    reached = signal_to_noise(seen.median, time, len(spectra), seen.read_variance, detector.gain)
    reason = _shortfall(seen, time, len(spectra), policy, detector)
    for more in longer(seen, time, len(spectra), policy, detector):
        added = await expose(more, policy.scans if policy.signal_to_noise is None else 1)
        await look(added)  # a stored spectrum always has its dark
        spectra = spectra + added
    light = sum(weight for _, weight in moments)
    return Taken(spectra, sum(moment * weight for moment, weight in moments) / light, seen, reached, reason)


async def _one(instrument: Instrument, time: float) -> list[Spectrum]:
    return [await instrument.expose(time)]


def _missing(seen: Brightness, time: float, scans: int, policy: Integration, detector: Detector) -> int:
    """How many more spectra of `time` seconds a point needs that has `scans` and looks like `seen`."""
    if policy.signal_to_noise is None:
        return policy.scans - scans
    needed = averages(seen.median, time, seen.read_variance, detector.gain, policy.signal_to_noise)
    return int(min(needed, most(time, policy))) - scans


def below_wanted(points: Sequence[Point], wanted: float | None) -> str:
    """Which of the `points` of a scan missed the `wanted` signal-to-noise ratio, as a sentence; empty where none did.

    A point that did carries the reason.
    """
    short = [p for p in points if p.status == "done" and p.reason and p.signal_to_noise is not None]
    if wanted is None or not short:
        return ""
    worst = min(short, key=lambda p: p.signal_to_noise or 0.0)
    many = "1 point stayed" if len(short) == 1 else f"{len(short)} points stayed"
    return (
        f"{many} below the wanted signal-to-noise ratio, the worst at theta_in = {worst.geometry.theta_in:g} deg, "
        f"theta_out = {worst.geometry.theta_out:g} deg: reached {worst.signal_to_noise:.3g} of {wanted:g}."
    )


def _shortfall(seen: Brightness, time: float, scans: int, policy: Integration, detector: Detector) -> str:
    """By how much the wanted signal-to-noise ratio was missed, as a sentence; empty where it was reached."""
    wanted = policy.signal_to_noise
    if wanted is None or averages(seen.median, time, seen.read_variance, detector.gain, wanted) <= scans:
        return ""
    reached = signal_to_noise(seen.median, time, scans, seen.read_variance, detector.gain)
    limit = f"with {scans} spectra" if scans == MOST_SPECTRA else f"within {policy.time_limit:g} s"
    return f"reached a signal-to-noise ratio of {reached:.3g} of {wanted:g} {limit}"
