"""The optical bench behind the simulated instruments: lamp, sample, detector, and the noise of each.

A read-out follows the light:

    halogen lamp x fibre and detector efficiency        the shape of the signal over wavelength
    x cos(theta_in) x BRDF through the aperture         what the sample sends into the detector
    + stray light                                       all that is left where the detector blocks the source
    -> electrons, Poisson                               shot noise
    + dark electrons, Poisson                           dark current at the sensor's temperature
    -> non-linearity, offset, read noise, whole counts, saturation

The light source is collimated, so the sample receives cos(theta_in) of its irradiance; the detector sees a spot
that always lies within the sample (2.5 mm across, 30 mm at 85 degrees, on a disc of 50 mm), so nothing is clipped
there. Left out: polarisation, inhomogeneous samples, offsets of angles and wavelengths.

Nothing is drawn from a running stream of random numbers. The noise of a read-out is a function of the seed, the
sample, where the stages truly stand, the integration time, shutter and lamp, and how many such read-outs went
before since the sample was mounted: a measurement that is killed and resumed reads the same counts as one that
was not.
"""

import hashlib
import math
from collections import Counter
from collections.abc import Callable
from typing import Protocol

import numpy as np

from drivers.arrays import CountArray, FloatArray
from drivers.clock import Clock
from goniometer.geometry import Geometry, from_stages
from goniometer.reference import NOMINAL_SRS99, reference_brdf
from simulators.materials import Material, Panel, material, true_brdf

PIXELS = 1044
"""Pixels of the detector array."""

WAVELENGTH_COEFFICIENTS = (250.5, 0.8085, -4.0e-5, -1.0e-9)
"""Wavelength of pixel i is the polynomial in i, nm: 250.5 to 1049.1."""

FULL_SCALE = 200_000
"""Largest count, at which a pixel is saturated."""

NONLINEARITY_COEFFICIENTS = (0.998, 5.0e-8, -7.5e-13, 1.0e-18, 0.0, 0.0, 0.0, 0.0)
"""Dark-subtracted counts x are the true ones times this polynomial in x: 0.998 at zero, 0.986 at full scale."""

GAIN = 5.0
"""Electrons per count."""

OFFSET = 1500.0
"""Counts of a read-out without light and dark current."""

READ_NOISE = 6.0
"""Standard deviation of one read-out of one pixel, counts."""

BRIGHTEST = 2000.0
"""Counts a second in the brightest pixel with Spectralon at theta_in = 0, theta_out = 45 degrees."""

STRAY_LIGHT = 1e-5
"""Stray light, as the BRDF times cos(theta_in) that would give the same signal, 1/sr; everywhere the same."""

BLOCKED_HALF_WIDTH = 4.95
"""Degrees from the source axis in which the detector truly shades the sample.

A little less than what `goniometer.geometry` leaves out, as that includes the errors of position.
"""

LAMP_TEMPERATURE = 2900.0
"""Colour temperature of the halogen lamp, kelvin."""

DRIFT_PERIOD = 3600.0
"""Period of the lamp's slow drift, seconds."""

_ANGLE_STEPS = 10_000
"""Steps per degree to which an angle counts as the same, so that rounding cannot change the noise."""


class Standing(Protocol):
    """An axis, as far as light is concerned."""

    def true_position(self) -> float:
        """Where the axis really stands now, degrees."""


class OpticalBench:
    """What the simulated spectrometer looks at; it implements `simulators.qepro.Detector`."""

    pixels = PIXELS
    wavelength_coefficients: tuple[float, ...] = WAVELENGTH_COEFFICIENTS
    nonlinearity_coefficients: tuple[float, ...] = NONLINEARITY_COEFFICIENTS

    def __init__(
        self,
        clock: Clock,
        *,
        seed: int,
        sample_axis: Standing,
        detector_axis: Standing,
        lamp_drift: float = 0.0,
    ) -> None:
        """Set the bench up with nothing mounted.

        `lamp_drift` is the relative amplitude of a slow sine of the lamp's output over the clock's time; with drift
        a resumed measurement is no longer the same bit by bit.
        """
        self._clock = clock
        self._seed = seed
        self._axes = sample_axis, detector_axis
        self._lamp_drift = lamp_drift
        self._wavelengths = _polynomial(np.arange(PIXELS, dtype=float), WAVELENGTH_COEFFICIENTS)
        self._throughput = _throughput(self._wavelengths)
        self._dark_pattern = _generator(seed, "dark current").lognormal(0, 0.3, PIXELS)
        self._offset = OFFSET + _generator(seed, "offset").normal(0, 5, PIXELS)
        self._mounted: Material | Panel | None = None
        self._identical: Counter[tuple[object, ...]] = Counter()
        self._seen: tuple[Geometry, FloatArray] | None = None

    @property
    def mounted(self) -> str | None:
        """Canonical name of the material on the sample stage; None while there is nothing."""
        return None if self._mounted is None else self._mounted.name

    def mount(self, material_name: str) -> None:
        """Lay a material on the sample stage; raises `UnknownMaterial`."""
        self._mounted, self._seen = material(material_name), None
        self._identical = Counter()

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float
    ) -> CountArray:
        """[pixels] raw counts after `integration_time` seconds, with everything standing as it does now.

        `sensor_temperature` in degrees Celsius sets the dark current.
        """
        sample, detector = (round(axis.true_position() * _ANGLE_STEPS) for axis in self._axes)
        microseconds = round(integration_time * 1e6)
        key = (self._seed, self.mounted, sample, detector, microseconds, shutter_open, lamp_on)
        random = _generator(*key, self._identical[key])
        self._identical[key] += 1
        light = np.zeros(PIXELS)
        if shutter_open and lamp_on:
            geometry = from_stages(sample / _ANGLE_STEPS, detector / _ANGLE_STEPS)
            light = random.poisson(GAIN * integration_time * self._light(geometry)) / GAIN
        dark_current = dark_rate(sensor_temperature) * self._dark_pattern
        dark = random.poisson(GAIN * integration_time * dark_current) / GAIN
        counts = _as_read(light) + dark + self._offset + random.normal(0, READ_NOISE, PIXELS)
        return np.clip(np.rint(counts), 0, FULL_SCALE).astype(np.uint32)

    def _light(self, geometry: Geometry) -> FloatArray:
        """[pixels] true counts a second without noise."""
        if self._seen is None or self._seen[0] != geometry:
            self._seen = geometry, self._throughput * (STRAY_LIGHT + self._cosine_brdf(geometry))
        drift = self._lamp_drift * math.sin(2 * math.pi * self._clock.now() / DRIFT_PERIOD)
        return self._seen[1] * (1 + drift)

    def _cosine_brdf(self, geometry: Geometry) -> FloatArray:
        """[pixels] cos(theta_in) x BRDF of what is mounted, 1/sr; zero where the detector blocks the source."""
        if self._mounted is None or abs(geometry.detector_angle) < BLOCKED_HALF_WIDTH:
            return np.zeros(PIXELS)
        theta_in, theta_out = np.array([geometry.theta_in]), np.array([geometry.theta_out])
        brdf = true_brdf(self._mounted, theta_in, theta_out, self._wavelengths)[0]
        return np.asarray(math.cos(math.radians(geometry.theta_in)) * brdf)


def positioning_error(seed: int, axis_name: str, std_deg: float = 0.005) -> Callable[..., float]:
    """How far an axis comes to rest from where it was sent, degrees, as a function of the target, degrees.

    Gaussian with standard deviation `std_deg`. The same target in the same circumstances, which are any further
    arguments, always gets the same error.
    """

    def error(target: float, *circumstances: object) -> float:
        return float(_generator(seed, axis_name, round(target * _ANGLE_STEPS), *circumstances).normal(0, std_deg))

    return error


def dark_rate(sensor_temperature: float) -> float:
    """Mean dark current, counts a second, at `sensor_temperature` degrees Celsius: 4 at -10, doubling every 6."""
    return float(4.0 * 2 ** ((sensor_temperature + 10.0) / 6.0))


def _generator(*key: object) -> np.random.Generator:
    """Random numbers that depend on `key` and on nothing else, in this process and in any other."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()))


def _throughput(wavelengths: FloatArray) -> FloatArray:
    """[pixels] true counts a second for cos(theta_in) x BRDF of 1/sr.

    Photons of a black body (Planck's law over the photon energy) times a smooth efficiency of fibre, grating and
    silicon that is best at 580 nm; scaled so that the brightest pixel sees `BRIGHTEST` on Spectralon.
    """
    second_radiation_constant = 1.438777e7  # h c / k in nm K (CODATA 2018)
    photons = wavelengths**-4 / np.expm1(second_radiation_constant / (wavelengths * LAMP_TEMPERATURE))
    efficiency = np.exp(-(((wavelengths - 580.0) / 300.0) ** 2))
    shape = photons * efficiency
    panel = reference_brdf(np.array([0.0]), np.array([45.0]), wavelengths, NOMINAL_SRS99)[0]
    return np.asarray(BRIGHTEST * shape / np.max(shape * panel))


def _polynomial(x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """c0 + c1 x + c2 x^2 + ..., of the shape of `x`."""
    return np.asarray(np.polynomial.polynomial.polyval(x, coefficients), dtype=float)


_READ = np.linspace(0, 2 * FULL_SCALE, 4001)
_TRUE = _READ / _polynomial(np.minimum(_READ, FULL_SCALE), NONLINEARITY_COEFFICIENTS)


def _as_read(true_counts: FloatArray) -> FloatArray:
    """Dark-subtracted counts x of a non-linear detector: the inverse of true = x / polynomial(x), by table."""
    return np.interp(true_counts, _TRUE, _READ)
