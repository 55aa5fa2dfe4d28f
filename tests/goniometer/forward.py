"""A measurement computed forwards, from a known BRDF to raw counts, with every error that a budget knows of.

It shares no code with calibration: light times errors gives counts. Errors are given in units of the physical
quantity, so that a Monte Carlo draws them from the stated uncertainties and looks at what calibration makes of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from analysis.reflectance.directions import round_aperture, through_aperture
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.models import cook_torrance
from drivers.arrays import FloatArray
from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.constants import BenchData, Constants
from goniometer.geometry import Geometry
from goniometer.radiometry.raw import Dark, RawScan, Shot

PIXELS = 1044
WAVELENGTHS = np.linspace(250, 1050, PIXELS)
POLYNOMIAL = np.array([0.998, 5e-8, -7.5e-13])
GAIN, READ_NOISE, OFFSET, DARK_RATE, FULL = 5.0, 6.0, 1500.0, 4.0, 200_000
DATA = BenchData(gain=GAIN)
CONSTANTS = Constants("QE Pro QEP00001", {}, WAVELENGTHS, POLYNOMIAL, FULL, DATA)
CADENCE = 60.0
"""Seconds from one shot to the next."""
MONITOR = Geometry(30.0, 31.0)

Brdf = Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]
"""Of theta_in, theta_out [points], wavelengths and the full angle of the aperture: [points, wavelengths]."""


@dataclass(frozen=True)
class Wrong:
    """What is truly wrong; nothing by default."""

    sample_zero: float = 0.0
    detector_zero: float = 0.0
    position: float = 0.0
    """Standard deviation of each position, degrees."""
    wavelength: float = 0.0
    """True wavelength minus stated, nm."""
    nonlinearity: float = 0.0
    """Relative, at full scale."""
    panel: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    """In standard uncertainties of each error of the certificate."""
    drift: float = 0.0
    """Relative amplitude of the lamp at 600 nm over an hour's sine, coloured as a change of temperature."""
    stray: float = 0.0
    """1/sr."""
    aperture: float = 0.0
    """True full angle minus stated, degrees."""


RIGHT = Wrong()
"""Nothing is wrong."""


def lamp(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths] true counts per second for cos(theta_in) f = 1/sr."""
    return np.asarray(4000 * np.exp(-(((wavelengths - 650) / 180) ** 2)))


def lobe(alpha: float = 0.18, h: float = 1.2, w: float = 3.4) -> Brdf:
    """Cook-Torrance with shift on a metal whose index does not end where the detector does not."""
    metal = Conductor("metal", np.array([200.0, 1200.0]), np.array([0.7, 1.6]), np.array([3.0, 9.0]))

    def brdf(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, aperture: float) -> FloatArray:
        rule = round_aperture(aperture)
        nodes = through_aperture(theta_in, theta_out, rule)
        return np.asarray(np.einsum("n,pnw->pw", rule.weights, cook_torrance(nodes, wavelengths, alpha, metal, h, w)))

    return brdf


def spectralon(wrong: Wrong = RIGHT) -> Brdf:
    """The panel as its certificate says, but for its errors."""

    def brdf(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, _: float) -> FloatArray:
        wavelengths = np.clip(wavelengths, 250.0, 1050.0)  # beyond, nobody looks
        errors = NOMINAL_SRS99.errors(theta_in, theta_out, wavelengths)
        off = sum(number * error for number, error in zip(wrong.panel, errors.values(), strict=True))
        return np.asarray(NOMINAL_SRS99.brdf(theta_in, theta_out, wavelengths) * (1 + off))

    return brdf


def as_read(true: FloatArray) -> FloatArray:
    """Dark-subtracted counts x with true = x / polynomial(x), by fixed-point iteration."""
    x = true
    for _ in range(30):
        x = true * np.polynomial.polynomial.polyval(x, POLYNOMIAL)
    return np.asarray(x)


class Bench:
    """Takes shots one after the other, at its own time."""

    def __init__(self, wrong: Wrong = RIGHT, seed: int = 0, *, noisy: bool = True) -> None:
        self.wrong, self.noisy = wrong, noisy
        self.random = np.random.default_rng(seed)
        self.session, self.moment = "one", 0.0
        self.ids = 0

    def scan(
        self,
        angles: Sequence[Geometry],
        brdf: Brdf,
        times: Sequence[float] | float,
        *,
        scan_id: int = 1,
        scans: int = 1,
        stray_time: float | None = None,
        monitor_every: int = 0,
        monitor_time: float = 1.0,
        diameter: float = 50.0,
    ) -> RawScan:
        """A raw scan; a time for each point, or several for one (`times` of tuples)."""
        per_point = [times] * len(angles) if isinstance(times, (int, float)) else list(times)
        error, here = 0.0, None  # of the sample stage, anew whenever it has been elsewhere
        shots, stray, monitors = [], [], []
        if stray_time is not None:
            for theta_in in sorted({angle.theta_in for angle in angles}):
                stray.append(self.shot(Geometry(theta_in, -theta_in), None, stray_time, 2, 0.0, None))
        for i, (angle, time) in enumerate(zip(angles, per_point, strict=True)):
            if monitor_every and i % monitor_every == 0:
                monitors.append(self.shot(MONITOR, brdf, monitor_time, 1, 0.0, None))
                here = None if here != MONITOR.theta_in else here
            if here != angle.theta_in:
                error, here = self.random.normal(0, self.wrong.position), angle.theta_in
            for each in time if isinstance(time, tuple) else (time,):
                shots.append(self.shot(angle, brdf, each, scans, error, i))
        if monitor_every:
            monitors.append(self.shot(MONITOR, brdf, monitor_time, 1, 0.0, None))
        used = sorted({shot.integration_time for shot in (*shots, *stray, *monitors)})
        return RawScan(
            scan_id,
            "a sample",
            diameter,
            date(2026, 1, 1),
            CONSTANTS,
            tuple(angles),
            tuple(angles),
            tuple(shots),
            tuple(self.dark(time) for time in used),
            tuple(stray),
            tuple(monitors),
        )

    def shot(
        self, angle: Geometry, brdf: Brdf | None, time: float, scans: int, sample_error: float, point: int | None
    ) -> Shot:
        """`scans` spectra; without a `brdf` only stray light is seen."""
        wrong = self.wrong
        self.moment += CADENCE
        sample = angle.theta_in + wrong.sample_zero + sample_error
        detector = angle.theta_in + angle.theta_out + wrong.detector_zero
        detector += self.random.normal(0, wrong.position) if point is not None else 0.0
        wavelengths = WAVELENGTHS + wrong.wavelength
        seen = np.full(PIXELS, wrong.stray)
        if brdf is not None:
            there = np.array([sample]), np.array([detector - sample])
            seen = seen + np.cos(np.radians(sample)) * brdf(*there, wavelengths, DATA.aperture + wrong.aperture)[0]
        change = 1 + wrong.drift * np.sin(2 * np.pi * self.moment / 3600) * 600 / wavelengths
        light = self._light(lamp(wavelengths) * change * seen * time, scans)
        light = light * (1 + wrong.nonlinearity * light / FULL)
        counts = as_read(light) + self._dark(time, scans)
        self.ids += scans
        ids = tuple(range(self.ids - scans, self.ids))
        return Shot(
            angle,
            time,
            np.clip(np.rint(counts), 0, FULL).astype(np.uint32),
            -10.0,
            self.session,
            self.moment,
            ids,
            point,
        )

    def dark(self, time: float, number: int = 4) -> Dark:
        """A set of dark spectra."""
        self.ids += number
        ids = tuple(range(self.ids - number, self.ids))
        return Dark(time, np.rint(self._dark(time, number)).astype(np.uint32), -10.0, ids)

    def _light(self, mean: FloatArray, scans: int) -> FloatArray:
        if not self.noisy:
            return np.tile(mean, (scans, 1))
        return np.asarray(self.random.poisson(GAIN * mean, (scans, PIXELS)) / GAIN)

    def _dark(self, time: float, scans: int) -> FloatArray:
        if not self.noisy:
            return np.full((scans, PIXELS), OFFSET)
        current = self.random.poisson(GAIN * DARK_RATE * time, (scans, PIXELS)) / GAIN
        return np.asarray(current + OFFSET + self.random.normal(0, READ_NOISE, (scans, PIXELS)))


def truth(angles: Sequence[Geometry], brdf: Brdf, wavelengths: FloatArray, aperture: float = 1.0) -> FloatArray:
    """[points, wavelengths] what an ideal calibration gives."""
    theta_in, theta_out = (np.array([getattr(g, name) for g in angles]) for name in ("theta_in", "theta_out"))
    return brdf(theta_in, theta_out, wavelengths, aperture)
