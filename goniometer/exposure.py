"""Which integration time a point gets, and how its spectra are taken.

Times come from a short ladder, so that a handful of dark spectra serves a whole scan. The choice depends on
stored exposures and on what the detector sees now, never on what a process remembers: a resumed scan chooses
as an uninterrupted one would have.
"""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from drivers.arrays import CountArray, FloatArray
from drivers.interfaces import Spectrum
from goniometer.campaign import Integration
from goniometer.errors import CampaignError
from goniometer.instrument import Instrument

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


@dataclass(frozen=True)
class Brightness:
    """What an earlier point of the same incident angle saw."""

    theta_out: float
    """Degrees."""
    rate: float
    """Dark-subtracted counts per second in the brightest pixel; infinite when it was saturated."""


def ladder(policy: Integration) -> tuple[float, ...]:
    """The allowed integration times, seconds, ascending whole microseconds: maximum, its half, ... minimum."""
    times = [policy.maximum]
    while times[-1] / 2 > policy.minimum:
        times.append(times[-1] / 2)
    return tuple(sorted({round(time * 1e6) / 1e6 for time in [policy.minimum, *times]}))


def check_limits(policy: Integration, instrument: Instrument) -> None:
    """Raise `CampaignError` where the spectrometer cannot take the times that the campaign asks for."""
    low, high = instrument.integration_limits
    if policy.minimum < low or policy.maximum >= high:
        raise CampaignError(
            f"Integration times of {policy.minimum:g} to {policy.maximum:g} s are not possible: this spectrometer "
            f"takes {low:g} s and more, but less than {high:g} s; change integration.minimum or maximum"
        )


def choose(rate: float, saturation: int, policy: Integration) -> float:
    """Longest time of the ladder that keeps the brightest pixel, `rate` counts per second, below the wanted fill."""
    times = ladder(policy)
    room = policy.fill * saturation - DARK_LEVEL
    fitting = [time for time in times if time * rate <= room]
    return max(fitting, default=times[0])


def predict(theta_out: float, seen: Sequence[Brightness]) -> float | None:
    """Brightness expected at `theta_out`, counts per second; None where the neighbours do not tell.

    Told by the nearest point on either side when they are alike; the brighter one is taken, to be safe.
    """
    below = [b for b in seen if b.theta_out < theta_out]
    above = [b for b in seen if b.theta_out > theta_out]
    if not below or not above:
        return None
    pair = max(below, key=lambda b: b.theta_out).rate, min(above, key=lambda b: b.theta_out).rate
    # Below one count per second everything is equally dark.
    return max(pair) if max(pair) < ALIKE * max(min(pair), 1.0) else None


def brightest(counts: CountArray, integration_time: float, dark: FloatArray, saturation: int) -> float:
    """Counts per second in the brightest pixel of the mean of `counts` [scans, pixels]; infinite when saturated.

    `dark` [pixels] is the mean dark signal of the same integration time, counts.
    """
    if counts.max() >= saturation:
        return float("inf")
    return float((counts.mean(axis=0) - dark).max() / integration_time)


async def take(
    instrument: Instrument,
    policy: Integration,
    scans: int,
    predicted: float | None,
    dark: Callable[[float], Awaitable[FloatArray]],
) -> list[Spectrum]:
    """`scans` valid spectra of where the instrument stands, all of one integration time.

    `predicted` is the brightness by `predict`; without it a short probe comes first. `dark` gives the mean
    dark signal [pixels] of an integration time. A spectrum that is saturated or far too dark is taken again
    at once; one that is saturated at the shortest time is accepted, and calibration flags it.
    """
    times = ladder(policy)
    if predicted is None:
        time = max((t for t in times if t <= policy.maximum * PROBE_FRACTION), default=times[0])
    else:
        time = choose(predicted, instrument.saturation, policy)
    probing = predicted is None
    ceiling = float("inf")
    while True:
        spectrum = await instrument.expose(time)
        if spectrum.counts.max() >= instrument.saturation:
            ceiling = min(ceiling, time)
            better = max((t for t in times if t <= time / STEP_DOWN), default=times[0])
        else:
            rate = brightest(spectrum.counts[None], time, await dark(time), instrument.saturation)
            wanted = choose(rate, instrument.saturation, policy)
            wanted = max((t for t in times if t <= wanted and t < ceiling), default=times[0])
            better = wanted if probing or wanted >= TOO_DARK * time else time
        if better == time:
            break
        probing = False
        time = better
    return [spectrum, *(await instrument.sequence(time, scans - 1) if scans > 1 else [])]
