"""What was measured of the bench itself: signature, noise and repeatability, from readings to figures.

Instrument signature and noise-equivalent BRDF are those of ASTM E2387: what the instrument makes of a perfect mirror,
and the BRDF whose signal is as large as the noise of one exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import BoolArray, CountArray, FloatArray
from goniometer.characterisation.meter import BIN, Reading, Series, binned
from goniometer.characterisation.peaks import centre_and_width, propagated
from goniometer.constants import Constants
from goniometer.errors import CharacterisationError

FAR = 30.0
"""Degrees from the mirror direction beyond which a mirror shows the floor of the instrument only."""


@dataclass(frozen=True)
class Signature:
    """What the instrument makes of a mirror at one incident angle."""

    theta_in: float
    """Incident angle as read back, degrees."""
    angle: FloatArray
    """[points] reflected angle minus mirror direction as read back, ascending, degrees."""
    profile: FloatArray
    """[points] signal of all bands, divided by that of the peak."""
    u_profile: FloatArray
    """[points] standard uncertainty of `profile` by noise."""
    wavelengths: FloatArray
    """[bands] nm."""
    rate: FloatArray
    """[points, bands] counts per second."""
    u_rate: FloatArray
    """[points, bands] standard uncertainty by noise, counts per second."""
    centre: float
    """Middle of the peak, degrees from where the mirror direction is read."""
    u_centre: float
    """Standard uncertainty by noise and by how well stages repeat, degrees."""
    width: float
    """Full width at half maximum, degrees."""
    u_width: float
    """Standard uncertainty, degrees."""
    floor: FloatArray
    """[bands] mean signal farther than `FAR` degrees from the peak, divided by that of the peak."""
    u_floor: FloatArray
    """[bands] standard uncertainty of `floor` by noise."""

    @property
    def floor_level(self) -> float:
        """Weighted mean of `floor`."""
        return _mean(self.floor, self.u_floor)

    @property
    def u_floor_level(self) -> float:
        """Standard uncertainty of `floor_level` by noise."""
        return _u_mean(self.u_floor)


def evaluate_signature(measured: Series, u_angle: float) -> Signature:
    """Width, middle and floor of the mirror's peak in a sweep of the detector; points may come in any order.

    `u_angle` is the standard uncertainty of one stage position, degrees. Raises `CharacterisationError` where the
    sweep holds no whole peak or nothing farther away than `FAR`.
    """
    order = np.argsort(measured.detector)
    angle = (measured.detector - 2 * measured.sample)[order]
    rate, u_rate = measured.rate[order], measured.u[order]
    total, u_total = measured.total[order], measured.u_total[order]
    far = np.abs(angle) > FAR
    if not far.any():
        raise CharacterisationError(
            f"No direction of the sweep is farther than {FAR:g}° from the mirror direction, where the floor of the "
            f"instrument shows; choose another incident angle"
        )
    peak = int(np.argmax(total))
    near = np.abs(angle - angle[peak]) <= FAR / 10
    x, y, u_y = angle[near], total[near] / total[peak], u_total[near] / total[peak]
    centre, width = centre_and_width(x, y)
    # the sample stage rests: its error moves the peak by twice as much and does not change its width
    u_centre, u_width = propagated(centre_and_width, x, y, u_angle, u_y)
    own, dark = (u_rate[far] ** 2).mean(axis=0) / far.sum(), measured.u_dark[order][far].mean(axis=0) ** 2
    return Signature(
        theta_in=float(measured.sample.mean()),
        angle=angle,
        profile=total / total[peak],
        u_profile=u_total / total[peak],
        wavelengths=measured.wavelengths,
        rate=rate,
        u_rate=u_rate,
        centre=float(centre),
        u_centre=float(np.hypot(u_centre, 2 * u_angle)),
        width=float(width),
        u_width=float(u_width),
        floor=rate[far].mean(axis=0) / rate[peak],
        u_floor=np.sqrt(own + dark) / rate[peak],
    )


@dataclass(frozen=True)
class Noise:
    """Noise and stray light of one exposure as the BRDF that would give them at normal incidence, 1/sr.

    At another incident angle they are larger by 1 / cos(theta_in).
    """

    integration_time: float
    """Seconds."""
    scans: int
    """Exposures whose scatter was taken, each as a single one."""
    wavelengths: FloatArray
    """[bands] of 6 pixels, nm."""
    brdf: FloatArray
    """[bands] noise-equivalent BRDF: standard deviation of one exposure."""
    predicted: FloatArray
    """[bands] the same from the read-out noise of the darks and the shot noise of the light."""
    stray: FloatArray
    """[bands] stray-light-equivalent BRDF: mean signal with nothing to see."""
    u_stray: FloatArray
    """[bands] standard uncertainty of `stray` by noise."""
    reference_time: float
    """Integration time of the exposure of the white panel, seconds."""

    @property
    def stray_level(self) -> float:
        """Weighted mean of `stray`, 1/sr."""
        return _mean(self.stray, self.u_stray)

    @property
    def u_stray_level(self) -> float:
        """Standard uncertainty of `stray_level` by noise, 1/sr."""
        return _u_mean(self.u_stray)

    @property
    def u_relative(self) -> float:
        """Relative standard uncertainty of `brdf` in a band, as a standard deviation of so few exposures has it."""
        return float(1 / np.sqrt(2 * (self.scans - 1)))

    @property
    def ratio(self) -> float:
        """Root mean square of `brdf` over `predicted`: 1 where noise is what it should be."""
        return float(np.sqrt(np.mean((self.brdf / self.predicted) ** 2)))

    @property
    def u_ratio(self) -> float:
        """Standard uncertainty of `ratio` by the number of exposures and bands."""
        return self.u_relative / float(np.sqrt(len(self.brdf)))


def evaluate_noise(
    light: CountArray, darks: CountArray, time: float, panel: Reading, panel_brdf: FloatArray, constants: Constants
) -> Noise:
    """Noise-equivalent and stray-light-equivalent BRDF.

    `light` and `darks` are [scans, pixels] raw counts of `time` seconds with nothing to see; `panel` is a reading of
    the white panel at normal incidence and `panel_brdf` [pixels] its BRDF in that direction, 1/sr. A standard deviation
    is that of the mean of a band's pixels from exposure to exposure.
    """
    response = binned(panel.rate, constants.wavelengths) / binned(panel_brdf, constants.wavelengths)
    per_brdf = response * time  # counts for 1/sr
    # next to no light: the polynomial is that of zero counts
    level, dark_level = (binned(c / constants.nonlinearity[0], constants.wavelengths) for c in (light, darks))
    mean = level.mean(axis=0) - dark_level.mean(axis=0)
    read_out = float(darks.var(axis=0, ddof=1).mean()) / float(constants.nonlinearity[0]) ** 2
    predicted = np.sqrt((read_out + np.maximum(mean, 0) / constants.bench.gain) / BIN)
    u_mean = predicted * np.sqrt(1 / len(light) + 1 / len(darks))
    return Noise(
        integration_time=time,
        scans=len(light),
        wavelengths=binned(constants.wavelengths, constants.wavelengths),
        brdf=level.std(axis=0, ddof=1) / per_brdf,
        predicted=predicted / per_brdf,
        stray=mean / per_brdf,
        u_stray=u_mean / per_brdf,
        reference_time=panel.integration_time,
    )


@dataclass(frozen=True)
class StageRepeatability:
    """How well one stage comes back, seen on the flank of a mirror's peak."""

    stage: Literal["sample", "detector"]
    angle: FloatArray
    """[returns] where the stage said it stood, degrees."""
    from_above: BoolArray
    """[returns] whether it came from larger angles."""
    signal: FloatArray
    """[returns] of all bands, divided by the mean."""
    u_signal: FloatArray
    """[returns] standard uncertainty of `signal` by noise."""
    departure: FloatArray
    """[returns] true minus read angle as the signal tells it, less its mean and the backlash, degrees."""
    slope: float
    """Relative change of the signal per degree that the stage turns."""
    scatter: float
    """Standard deviation of the true angle around the read one beyond noise, degrees."""
    degrees_of_freedom: int
    """Of `scatter`."""
    backlash: float
    """True angle after coming from above minus that from below, at the same reading, degrees."""
    u_backlash: float
    """Standard uncertainty of `backlash`, degrees."""
    read_back: float
    """Root mean square of read minus wanted angle, degrees."""

    @property
    def u_scatter(self) -> float:
        """Standard uncertainty of `scatter` by the number of returns, degrees."""
        return self.scatter / float(np.sqrt(2 * self.degrees_of_freedom))


@dataclass(frozen=True)
class Repeatability:
    """How well both stages come back to the same direction."""

    sample: StageRepeatability
    detector: StageRepeatability
    wavelengths: FloatArray
    """[bands] nm."""
    band_scatter: FloatArray
    """[bands] relative standard deviation of the signal of a band beyond noise, as the detector stage returns."""

    @property
    def u_angle(self) -> float:
        """Standard uncertainty of one stage position, degrees: the larger of both."""
        return max(self.sample.scatter, self.detector.scatter)


def evaluate_returns(
    stage: Literal["sample", "detector"], wanted: FloatArray, from_above: BoolArray, measured: Series
) -> StageRepeatability:
    """Scatter of the angle from the scatter of the signal around a straight line over the read angle.

    `wanted` [returns] are angles that were asked for, spread a little, so that the same run tells the slope of the
    flank; a step between both sides of approach is the backlash. Raises `CharacterisationError` where the signal does
    not depend on the angle.
    """
    x = measured.sample if stage == "sample" else measured.detector
    y, u_y = measured.total / measured.total.mean(), measured.u_total / measured.total.mean()
    design, values, covariance, residual = _straight_line(x, from_above, y)
    freedom = len(y) - design.shape[1]
    slope = float(values[1])
    if abs(slope) < 5 * np.sqrt(covariance[1, 1]):
        raise CharacterisationError(
            f"The signal does not depend on the angle of the {stage} stage and cannot tell how well it comes back; "
            f"look whether the mirror is mounted"
        )
    beyond = max(float(np.sum(residual**2)) / freedom - float(np.mean(u_y**2)), 0.0)
    return StageRepeatability(
        stage=stage,
        angle=x,
        from_above=from_above,
        signal=y,
        u_signal=u_y,
        departure=residual / slope,
        slope=slope,
        scatter=float(np.sqrt(beyond) / abs(slope)),
        degrees_of_freedom=freedom,
        backlash=float(values[2] / slope),
        u_backlash=float(np.sqrt(covariance[2, 2]) / abs(slope)),
        read_back=float(np.sqrt(np.mean((x - wanted) ** 2))),
    )


def band_scatter(from_above: BoolArray, measured: Series) -> FloatArray:
    """[bands] relative standard deviation of the signal beyond noise, of a series that `evaluate_returns` takes."""
    mean = measured.rate.mean(axis=0)
    design, _, _, residual = _straight_line(measured.detector, from_above, measured.rate / mean)
    beyond = (residual**2).sum(axis=0) / (len(residual) - design.shape[1]) - np.mean((measured.u / mean) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(beyond, 0)))


def _straight_line(
    x: FloatArray, from_above: Sequence[bool] | BoolArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Design matrix, parameters, their covariance (for the first column of y) and residuals of y over x and side."""
    design = np.column_stack([np.ones(len(x)), x - x.mean(), np.asarray(from_above, dtype=float)])
    values, *_ = np.linalg.lstsq(design, y, rcond=None)
    residual = y - design @ values
    scale = float(np.sum(residual.reshape(len(x), -1)[:, 0] ** 2)) / (len(x) - design.shape[1])
    return design, values, scale * np.linalg.inv(design.T @ design), residual


def _mean(values: FloatArray, u: FloatArray) -> float:
    """Weighted mean."""
    return float(np.sum(values / u**2) / np.sum(u**-2))


def _u_mean(u: FloatArray) -> float:
    """Standard uncertainty of a weighted mean."""
    return float(1 / np.sqrt(np.sum(u**-2)))
