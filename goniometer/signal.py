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
from scipy.ndimage import uniform_filter1d

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import CalibrationError
from goniometer.raw import Dark, RawScan, Shot

STRAY_WINDOW = 51
"""Pixels over which stray light is smoothed; the lamp's spectrum is straight over so few."""

SAME_INCIDENCE = 0.05
"""Incident angles closer than this belong to one position of the sample stage, degrees."""


@dataclass(frozen=True)
class Signal:
    """Linear signal of one scan, without dark and stray light; all arrays [points, pixels] in counts per second."""

    rate: FloatArray
    """The signal."""
    variance: FloatArray
    """Variance of `rate` by shot and read-out noise of the point's own spectra."""
    dark: tuple[tuple[str, FloatArray], ...]
    """For each set of dark spectra its name and the standard uncertainty that its noise gives; points share it."""
    stray: FloatArray
    """Stray light that was subtracted; zero where none was measured."""
    u_stray: FloatArray
    """Standard uncertainty of `stray` by noise; shared by the points of one incident angle."""
    nonlinearity: FloatArray
    """Change of `rate` where the linearised signal errs by a relative 1 at full scale, in proportion to the counts."""
    saturated: BoolArray
    """Whether all shots of a point were saturated there."""


@dataclass(frozen=True)
class _Linear:
    """One shot, [pixels] in counts per second."""

    rate: FloatArray
    variance: FloatArray
    u_dark: FloatArray
    nonlinearity: FloatArray
    saturated: BoolArray
    dark: int
    """Number of the set of dark spectra that was used."""


def signal(raw: RawScan, corrections: Set[str]) -> Signal:
    """The signal of every point; `corrections` may hold "dark", "non-linearity" and "stray light".

    Shot noise comes from the signal and the gain. The noise of a dark read-out (electronics and dark current) comes
    from the scatter of the repeated darks, pooled over the pixels. What a correction that is left out would have
    changed counts as uncertainty of its part. Raises `CalibrationError` where fewer than two darks of an integration
    time exist, or a point has no shot.
    """
    shape = len(raw.planned), raw.constants.wavelengths.size
    weight, kept = np.zeros(shape), np.zeros(shape)
    rate, variance, nonlinearity = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    u_dark = {number: np.zeros(shape) for number in range(len(raw.darks))}
    shots = [[] for _ in range(shape[0])]  # type: list[list[Shot]]
    for shot in raw.shots:
        assert shot.point is not None  # shots without a point are not among these
        shots[shot.point].append(shot)
    for point, mine in enumerate(shots):
        if not mine:
            raise CalibrationError(f"Point {point} of scan {raw.scan_id} is done but has no spectrum; measure it again")
        parts = [linear(raw, shot, corrections) for shot in mine]
        lights = [len(shot.counts) * shot.integration_time for shot in mine]
        shortest = min(range(len(mine)), key=lambda i: mine[i].integration_time)
        everywhere_saturated = np.all([part.saturated for part in parts], axis=0)
        for i, (part, light) in enumerate(zip(parts, lights, strict=True)):
            w = light * ~part.saturated + (everywhere_saturated * light if i == shortest else 0.0)
            weight[point] += w
            rate[point] += w * part.rate
            variance[point] += w**2 * part.variance
            nonlinearity[point] += w * part.nonlinearity
            u_dark[part.dark][point] += w * part.u_dark
        kept[point] = everywhere_saturated
    rate, nonlinearity, variance = rate / weight, nonlinearity / weight, variance / weight**2
    dark = tuple((_name(raw.darks, i), u / weight) for i, u in u_dark.items() if u.any())
    stray, u_stray = _stray(raw, corrections)
    return Signal(rate - stray, variance, dark, stray, u_stray, nonlinearity, kept.astype(bool))


def linear(raw: RawScan, shot: Shot, corrections: Set[str]) -> _Linear:
    """One shot without its dark signal and made linear; raises as `signal` does."""
    constants = raw.constants
    number = _dark_of(raw, shot)
    darks = raw.darks[number].counts
    dark = darks.mean(axis=0)
    read_out = float(darks.var(axis=0, ddof=1).mean())
    above = shot.counts.mean(axis=0) - dark
    factor = np.polynomial.polynomial.polyval(above, constants.nonlinearity)
    if "non-linearity" in corrections:
        change = above / factor * above / constants.saturation
    else:
        # in units of the uncertainty that is stated for what the polynomial leaves
        change = (above / factor - above) / constants.bench.u_nonlinearity
        factor = np.ones_like(factor)
    true = above / factor
    u_dark = np.sqrt(read_out / len(darks)) / factor
    if "dark" not in corrections:
        true, u_dark = true + dark / factor, dark / factor
    time, scans = shot.integration_time, len(shot.counts)
    variance = (np.maximum(above / factor, 0) / constants.bench.gain + read_out / factor**2) / scans / time**2
    saturated = np.any(shot.counts >= constants.saturation, axis=0)
    return _Linear(true / time, variance, u_dark / time, change / time, saturated, number)


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
    if "stray light" not in corrections or not raw.stray:
        return np.zeros(shape), np.zeros(shape)
    parts = [linear(raw, shot, corrections) for shot in raw.stray]
    levels = np.array([uniform_filter1d(part.rate, STRAY_WINDOW, mode="nearest") for part in parts])
    noises = np.array(
        [
            # the running sums of the filter may round a zero to less
            np.sqrt(np.maximum(uniform_filter1d(part.variance + part.u_dark**2, STRAY_WINDOW, mode="nearest"), 0.0))
            / np.sqrt(STRAY_WINDOW)
            for part in parts
        ]
    )
    angles = np.array([shot.geometry.theta_in for shot in raw.stray])
    nearest = [int(np.argmin(np.abs(angles - g.theta_in))) for g in raw.planned]
    return levels[nearest], noises[nearest]
