"""From raw counts to the linear signal of each point of a scan, with the errors that counts have.

For each shot and pixel

    s = x / polynomial(x) / integration time,   x = mean counts - mean dark,

with the dark of the same integration time whose temperature is nearest. Shots of different integration times of one
point are averaged with the weight of their light, integration time x number of spectra, where they are not saturated:
that is the weighting of shot noise, and as it does not look at the counts it has no bias. Then stray light, seen with
the detector in front of the source, is subtracted, smoothed over wavelength because it has the smooth spectrum of the
lamp.
"""

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
import scipy

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import CalibrationError
from goniometer.radiometry.raw import Dark, RawScan, Shot

STRAY_WINDOW = 51
"""Pixels over which stray light is smoothed; the lamp's spectrum is straight over so few."""

CORRECTIONS_OF_A_SHOT = frozenset({"dark", "non-linearity"})
"""All that `linear` can correct, for what is read from single shots: the others need more of a scan than one."""

DARK_DOUBLING = 6.0
"""Degrees Celsius by which a silicon detector must be warmer for twice the dark current."""


@dataclass(frozen=True)
class Signal:
    """Linear signal of one scan, without dark and stray light; all arrays [points, pixels] in counts per second."""

    rate: FloatArray
    """The signal."""
    variance: FloatArray
    """Variance of `rate` by shot and read-out noise of the point's own spectra."""
    dark: tuple[tuple[str, FloatArray], ...]
    """For each set of dark spectra its name and the standard uncertainty that its noise gives; points share it."""
    dark_left: FloatArray
    """Dark signal that was not subtracted, because that was not wanted."""
    dark_warming: FloatArray
    """Dark signal by which a point differs from its dark spectra, because the detector was warmer or colder."""
    stray: FloatArray
    """Stray light as measured, subtracted or not; zero where none was measured."""
    u_stray: FloatArray
    """Standard uncertainty of `stray` by noise; shared by the points of one incident angle."""
    nonlinearity: FloatArray
    """Change of `rate` for one standard uncertainty of what the polynomial leaves, or by leaving it out."""
    saturated: BoolArray
    """Whether all shots of a point were saturated there."""


@dataclass(frozen=True)
class Linear:
    """One shot, [pixels] in counts per second; fields as those of `Signal`."""

    rate: FloatArray
    variance: FloatArray
    u_dark: FloatArray
    dark_left: FloatArray
    dark_warming: FloatArray
    nonlinearity: FloatArray
    saturated: BoolArray
    dark: int
    """Number of the set of dark spectra that was used."""


_ADDED = ("rate", "dark_left", "dark_warming", "nonlinearity")
"""What is averaged over the shots of a point as it is."""


def signal(raw: RawScan, corrections: Set[str]) -> Signal:
    """The signal of every point; `corrections` may hold "dark", "non-linearity" and "stray light".

    Shot noise comes from the signal and the gain. The noise of a dark read-out (electronics and dark current) comes
    from the scatter of the repeated darks, pooled over the pixels. Raises `CalibrationError` where there are no points,
    a point has no shot, fewer than two darks of an integration time exist, or stray light is saturated.
    """
    if not raw.planned:
        raise CalibrationError(f"Scan {raw.scan_id} has no measured point; measure it first")
    shape = len(raw.planned), raw.constants.wavelengths.size
    weight, variance, saturated = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=bool)
    added = {name: np.zeros(shape) for name in _ADDED}
    u_dark = {number: np.zeros(shape) for number in range(len(raw.darks))}
    shots: list[list[Shot]] = [[] for _ in range(shape[0])]
    for shot in raw.shots:
        assert shot.point is not None  # shots without a point are not among these
        shots[shot.point].append(shot)
    for point, mine in enumerate(shots):
        if not mine:
            raise CalibrationError(f"Point {point} of scan {raw.scan_id} is done but has no spectrum; measure it again")
        parts = [linear(raw, shot, corrections) for shot in mine]
        lights = [len(shot.counts) * shot.integration_time for shot in mine]
        shortest = min(range(len(mine)), key=lambda i: mine[i].integration_time)
        saturated[point] = np.all([part.saturated for part in parts], axis=0)
        for i, (part, light) in enumerate(zip(parts, lights, strict=True)):
            w = light * ~part.saturated + (saturated[point] * light if i == shortest else 0.0)
            weight[point] += w
            variance[point] += w**2 * part.variance
            u_dark[part.dark][point] += w * part.u_dark
            for name in _ADDED:
                added[name][point] += w * getattr(part, name)
    dark = tuple((_name(raw.darks, i), u / weight) for i, u in u_dark.items() if u.any())
    mean = {name: total / weight for name, total in added.items()}
    stray, u_stray = _stray(raw, corrections)
    if "stray light" in corrections:
        mean["rate"] = mean["rate"] - stray
    return Signal(variance=variance / weight**2, dark=dark, stray=stray, u_stray=u_stray, saturated=saturated, **mean)


def linear(raw: RawScan, shot: Shot, corrections: Set[str]) -> Linear:
    """One shot without its dark signal and made linear; raises as `signal` does."""
    constants, time, scans = raw.constants, shot.integration_time, len(shot.counts)
    number = _dark_of(raw, shot)
    darks = raw.darks[number].counts
    dark = darks.mean(axis=0)
    read_out = float(darks.var(axis=0, ddof=1).mean())
    above = shot.counts.mean(axis=0) - dark
    factor = np.polynomial.polynomial.polyval(above, constants.nonlinearity)
    true = above / factor
    if "non-linearity" in corrections:
        change = constants.bench.u_nonlinearity * true * above / constants.saturation
    else:
        change, true, factor = above - true, above, np.ones_like(factor)
    u_dark, left = np.sqrt(read_out / len(darks)) / factor, np.zeros_like(dark)
    if "dark" not in corrections:
        u_dark, left = left, dark / factor
    # what all integration times have is offset and not dark current
    current = dark - min(raw.darks, key=lambda d: d.integration_time).counts.mean(axis=0)
    warming = current * np.log(2) / DARK_DOUBLING * (shot.temperature - raw.darks[number].temperature)
    return Linear(
        rate=(true + left) / time,
        variance=(np.maximum(true, 0) / constants.bench.gain + read_out / factor**2) / scans / time**2,
        u_dark=u_dark / time,
        dark_left=left / time,
        dark_warming=warming / factor / time,
        nonlinearity=change / time,
        saturated=np.any(shot.counts >= constants.saturation, axis=0),
        dark=number,
    )


def _dark_of(raw: RawScan, shot: Shot) -> int:
    """Number of the set of dark spectra of the same integration time and the nearest temperature."""
    alike = [i for i, dark in enumerate(raw.darks) if dark.integration_time == shot.integration_time]
    if not alike:
        raise CalibrationError(
            f"Scan {raw.scan_id} has no dark spectrum of {shot.integration_time:g} s, so its points of that time have "
            f"no zero; measure the dark, or leave these points out"
        )
    best = min(alike, key=lambda i: abs(raw.darks[i].temperature - shot.temperature))
    if len(raw.darks[best].counts) < 2:
        raise CalibrationError(
            f"Scan {raw.scan_id} has only {len(raw.darks[best].counts)} dark spectrum of {shot.integration_time:g} s; "
            f"two are needed for the noise"
        )
    return best


def _name(darks: tuple[Dark, ...], number: int) -> str:
    """Integration time of a set, and its place among those of the same time where there are several."""
    time = darks[number].integration_time
    alike = [i for i, dark in enumerate(darks) if dark.integration_time == time]
    return f"{time:g} s" if len(alike) == 1 else f"{time:g} s, set {alike.index(number) + 1}"


def _stray(raw: RawScan, corrections: Set[str]) -> tuple[FloatArray, FloatArray]:
    """[points, pixels] stray light and its standard uncertainty, from the shots at the nearest incident angle."""
    shape = len(raw.planned), raw.constants.wavelengths.size
    if not raw.stray:
        return np.zeros(shape), np.zeros(shape)
    parts = [linear(raw, shot, corrections) for shot in raw.stray]
    if any(part.saturated.any() for part in parts):
        raise CalibrationError(
            f"The stray light of scan {raw.scan_id} saturates the detector; look what shines into it, and measure again"
        )
    levels = np.array([scipy.ndimage.uniform_filter1d(part.rate, STRAY_WINDOW, mode="nearest") for part in parts])
    noises = np.array(
        [
            # the running sums of the filter may round a zero to less
            np.sqrt(
                np.maximum(
                    scipy.ndimage.uniform_filter1d(part.variance + part.u_dark**2, STRAY_WINDOW, mode="nearest"), 0.0
                )
            )
            / np.sqrt(STRAY_WINDOW)
            for part in parts
        ]
    )
    angles = np.array([shot.geometry.theta_in for shot in raw.stray])
    nearest = [int(np.argmin(np.abs(angles - g.theta_in))) for g in raw.planned]
    return levels[nearest], noises[nearest]
