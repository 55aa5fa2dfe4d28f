"""The optical bench behind the simulated instruments: lamp, sample, detector, and the noise of each.

A read-out follows the light:

    halogen lamp x fibre and detector efficiency        the shape of the signal over wavelength
    x cos(theta_in) x BRDF through the aperture         what the sample sends into the detector
    x share of the footprint that lies on the sample    what the detector sees beyond the sample is black
    + stray light                                       all that is left where the detector blocks the source
    + the lines of a calibration lamp                   where one is mounted in place of a sample
    averaged over the integration                       where a stage moves meanwhile
    -> electrons, Poisson                               shot noise
    + dark electrons, Poisson                           dark current at the sensor's temperature
    -> non-linearity, offset, read noise, whole counts, saturation

The light source is collimated and wider than any sample, so the sample receives cos(theta_in) of its irradiance. What
the bench does wrong, such as zeros of stages or a shifted wavelength scale, are its `Imperfections`. Left out:
polarisation, and the spectrometer's resolution for anything but the lines of a lamp.

Nothing is drawn from a running stream of random numbers. The noise of a read-out is a function of the seed, the
sample and the spot on it, the repeat of its measurement, where the stages truly stand (as it begins and as it ends,
where they move), the integration time, shutter and lamp, and how many such read-outs went before since the sample was
mounted: a measurement that is killed and resumed reads the same counts as one that was not.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from scipy.special import ndtr

from drivers.arrays import CountArray, FloatArray
from drivers.clock import Clock
from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.constants import BenchData
from goniometer.geometry import Geometry, from_stages
from simulators.bench.imperfections import IDEAL, Imperfections, generator
from simulators.materials.materials import NOTHING, Emitter, Mountable, Panel, material, true_brdf

STATED = BenchData()
"""What the operator of this bench believes; `Imperfections` are the true errors of it."""

PIXELS = 1044
"""Pixels of the detector array."""

WAVELENGTH_COEFFICIENTS = (250.5, 0.8085, -4.0e-5, -1.0e-9)
"""Wavelength of pixel i is the polynomial in i, nm: 250.5 to 1049.1."""

FULL_SCALE = 200_000
"""Largest count, at which a pixel is saturated."""

NONLINEARITY_COEFFICIENTS = (0.998, 5.0e-8, -7.5e-13, 1.0e-18, 0.0, 0.0, 0.0, 0.0)
"""Dark-subtracted counts x are the true ones times this polynomial in x: 0.998 at zero, 0.986 at full scale."""

GAIN = STATED.gain
"""Electrons per count."""

OFFSET = 1500.0
"""Counts of a read-out without light and dark current."""

READ_NOISE = 6.0
"""Standard deviation of one read-out of one pixel, counts."""

BRIGHTEST = 2000.0
"""Counts a second in the brightest pixel with Spectralon at theta_in = 0, theta_out = 45 degrees."""

RESOLUTION = 1.6
"""Full width at half maximum of a spectral line, nm."""

BLOCKED_HALF_WIDTH = 4.95
"""Degrees from the source axis in which the detector truly shades the sample.

A little less than what `goniometer.geometry` leaves out, as that includes the errors of position.
"""

LAMP_TEMPERATURE = 2900.0
"""Colour temperature of the halogen lamp, kelvin."""

FINE = 0.1
"""Degrees of a motion over which the light is taken as constant: small against the aperture."""

_ANGLE_STEPS = 10_000
"""Steps per degree to which an angle counts as the same, so that rounding cannot change the noise."""


class Standing(Protocol):
    """An axis, as far as light is concerned."""

    def true_positions(self, moments: FloatArray) -> FloatArray:
        """[moments] where the axis really stood or stands, degrees; `moments` in seconds, none later than now."""


class OpticalBench:
    """What the simulated spectrometer looks at; it implements `simulators.devices.qepro.Detector`."""

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
        imperfections: Imperfections = IDEAL,
    ) -> None:
        """Set the bench up with nothing mounted.

        With a lamp that drifts or warms up a resumed measurement is no longer the same bit by bit.
        """
        self.imperfections = imperfections
        """What it does wrong."""
        self._clock = clock
        self._seed = seed
        self._axes = sample_axis, detector_axis
        self._wavelengths = _true_wavelengths(np.arange(PIXELS, dtype=float), imperfections)
        self._throughput = throughput(self._wavelengths)
        self._dark_pattern = generator(seed, "dark current").lognormal(0, 0.3, PIXELS)
        self._offset = OFFSET + generator(seed, "offset").normal(0, 5, PIXELS)
        self._seen: tuple[Geometry, FloatArray] | None = None
        self._identical: Counter[tuple[object, ...]] = Counter()
        self._lay(NOTHING, 0)

    @property
    def mounted(self) -> str:
        """Canonical name of what is on the sample stage."""
        return self._mounted.name

    @property
    def spot(self) -> int:
        """Number of the spot on it that is looked at."""
        return self._spot

    @property
    def circumstances(self) -> tuple[object, ...]:
        """What random errors depend on beside where the stages stand: sample, spot, and a repeat beyond the first."""
        return (self.mounted, self.spot) if self._repeat == 1 else (self.mounted, self.spot, self._repeat)

    def mount(self, material_name: str, spot: int = 0) -> None:
        """Lay a material on the sample stage, so that `spot` of it is looked at.

        Raises `UnknownMaterial` and `UnfitTable` as `simulators.materials.materials.material`.
        Spot 0 is the first place or azimuth, 1 another one, and so on; only inhomogeneous samples look different there.
        """
        self._lay(material(material_name), spot)

    def begin(self, repeat: int) -> None:
        """From now on the random errors are those of measurement `repeat` of what is mounted, counted from 1."""
        self._repeat = repeat

    def read_out(
        self,
        integration_time: float,
        *,
        shutter_open: bool,
        lamp_on: bool,
        sensor_temperature: float,
        ended: float | None = None,
    ) -> CountArray:
        """[pixels] raw counts of `integration_time` seconds that ended at the moment `ended`, or end now.

        While a stage moves, the light is averaged over the integration. `sensor_temperature` in degrees Celsius sets
        the dark current. A calibration lamp that is mounted is switched together with the bench's own.
        """
        ended = self._clock.now() if ended is None else min(ended, self._clock.now())
        first, last = self._geometries(np.array([ended - integration_time, ended]))
        microseconds = round(integration_time * 1e6)
        # at rest only where the stages stand counts, and for the dark not even that they move
        standing = (last,) if first == last or not (shutter_open and lamp_on) else (first, last)
        key = (self._seed, *self.circumstances, *standing, microseconds, shutter_open, lamp_on)
        random = generator(*key, self._identical[key])
        self._identical[key] += 1
        light = np.zeros(PIXELS)
        if shutter_open and lamp_on:
            seen = self.light(last, ended) if first == last else self._mean_light(ended - integration_time, ended)
            light = random.poisson(GAIN * integration_time * seen) / GAIN
        dark = random.poisson(GAIN * integration_time * self.dark_current(sensor_temperature)) / GAIN
        counts = self.as_read(light) + dark + self._offset + random.normal(0, READ_NOISE, PIXELS)
        return np.clip(np.rint(counts), 0, FULL_SCALE).astype(np.uint32)

    def geometry(self) -> Geometry:
        """The true directions, as the stages stand now; rounded, so that nothing else can change the noise."""
        return self._geometries(np.array([self._clock.now()]))[0]

    def _geometries(self, moments: FloatArray) -> list[Geometry]:
        """The true directions at each of `moments`, seconds."""
        zeros = self.imperfections.sample_zero, self.imperfections.detector_zero
        samples, detectors = (
            [round(angle * _ANGLE_STEPS) / _ANGLE_STEPS for angle in (axis.true_positions(moments) + zero).tolist()]
            for axis, zero in zip(self._axes, zeros, strict=True)
        )
        return [from_stages(*angles) for angles in zip(samples, detectors, strict=True)]

    def light(self, geometry: Geometry, moment: float | None = None) -> FloatArray:
        """[pixels] true counts a second without noise, in the directions `geometry` at a `moment`, s, or now."""
        if self._seen is None or self._seen[0] != geometry:
            received = self.imperfections.stray_light + self._cosine_brdf([geometry])[0]
            self._seen = geometry, self._throughput * received
        return self._seen[1] * self._lamp(moment) + self._lines

    def _mean_light(self, began: float, ended: float) -> FloatArray:
        """[pixels] true counts a second, averaged over the motion of the stages between two moments, seconds."""
        count = 1
        while True:
            edges = self._geometries(np.linspace(began, ended, count + 1))
            angles = np.array([(g.sample_angle, g.detector_angle) for g in edges])
            widest = float(np.abs(np.diff(angles, axis=0)).max())
            if widest <= FINE + 1 / _ANGLE_STEPS:  # what rounding adds
                break
            count = math.ceil(count * widest / FINE)
        middles = self._geometries(began + (np.arange(count) + 0.5) / count * (ended - began))
        received = self.imperfections.stray_light + self._cosine_brdf(middles).mean(axis=0)
        return np.asarray(self._throughput * received * self._lamp(ended) + self._lines)

    def _lamp(self, moment: float | None) -> FloatArray:
        return self.imperfections.lamp(self._clock.now() if moment is None else moment, self._wavelengths)

    def dark_current(self, sensor_temperature: float) -> FloatArray:
        """[pixels] mean counts a second without light, at `sensor_temperature` degrees Celsius."""
        return dark_rate(sensor_temperature) * self._dark_pattern

    def as_read(self, light: FloatArray) -> FloatArray:
        """Mean counts that the device makes of true counts `light`, of any shape, before offset and dark current."""
        error = self.imperfections.nonlinearity * np.minimum(light, 2 * FULL_SCALE) / FULL_SCALE
        return np.interp(light * (1 + error), _TRUE, _READ)

    def _lay(self, mounted: Mountable, spot: int) -> None:
        self._mounted, self._spot, self._repeat = mounted, spot, 1
        self._lines = self._emission(mounted) if isinstance(mounted, Emitter) else np.zeros(PIXELS)
        self._seen = None
        self._identical.clear()

    def _emission(self, lamp: Emitter) -> FloatArray:
        """[pixels] counts a second of Gaussian lines, each integrated over the width of every pixel."""
        edges = _true_wavelengths(np.arange(PIXELS + 1, dtype=float) - 0.5, self.imperfections)
        std = RESOLUTION / math.sqrt(8 * math.log(2))
        shares = (np.diff(ndtr((edges - wavelength) / std)) * strength for wavelength, strength in lamp.lines)
        return sum(shares, np.zeros(PIXELS))

    def _cosine_brdf(self, geometries: Sequence[Geometry]) -> FloatArray:
        """[geometries, pixels] cos(theta_in) x BRDF x share of the footprint, 1/sr; zero in the blocked sector."""
        mounted, found = self._mounted, np.zeros((len(geometries), PIXELS))
        free = [i for i, g in enumerate(geometries) if abs(g.detector_angle) >= BLOCKED_HALF_WIDTH]
        if isinstance(mounted, Emitter) or not free:
            return found
        bench = self.imperfections
        theta_in = np.array([geometries[i].theta_in for i in free])
        theta_out = np.array([geometries[i].theta_out for i in free])
        aperture = STATED.aperture + bench.aperture_error
        field_of_view = STATED.field_of_view + bench.field_of_view_error
        if isinstance(mounted, Panel):
            wavelengths = _within(self._wavelengths, mounted.certificate.wavelengths)
            brdf = true_brdf(mounted, theta_in, theta_out, wavelengths)
            brdf = brdf * bench.panel(mounted.certificate, theta_in, theta_out, wavelengths)
        else:
            brdf = true_brdf(mounted, theta_in, theta_out, self._wavelengths, aperture, self._spot)
        seen = [
            math.cos(math.radians(g.theta_in)) * share_on_disc(g.theta_out, field_of_view, mounted.diameter_mm)
            for g in (geometries[i] for i in free)
        ]
        found[free] = np.array(seen)[:, None] * brdf
        return found


def positioning_error(seed: int, axis_name: str, std_deg: float = STATED.u_angle) -> Callable[..., float]:
    """How far an axis comes to rest from where it was sent, degrees, as a function of the target, degrees.

    Gaussian with standard deviation `std_deg`. The same target in the same circumstances, which are any further
    arguments, always gets the same error.
    """

    def error(target: float, *circumstances: object) -> float:
        return float(generator(seed, axis_name, round(target * _ANGLE_STEPS), *circumstances).normal(0, std_deg))

    return error


def dark_rate(sensor_temperature: float) -> float:
    """Mean dark current, counts a second, at `sensor_temperature` degrees Celsius: 4 at -10, doubling every 6."""
    return float(4.0 * 2 ** ((sensor_temperature + 10.0) / 6.0))


def share_on_disc(theta_out: float, field_of_view: float, diameter: float) -> float:
    """Share of what the detector sees that lies on a round sample under the middle of it.

    It sees an ellipse with the half axes b = `field_of_view` / 2 (mm) and a = b / cos(theta_out), of which the disc of
    radius R = `diameter` / 2 (mm), R > b, cuts the ends off where a > R. Their outlines meet at b s across the plane,
    s^2 = (a^2 - R^2) / (a^2 - b^2), and the integral of the shorter of the two lengths is elementary. `theta_out` in
    degrees.
    """
    b, radius = field_of_view / 2, diameter / 2
    a = b / max(math.cos(math.radians(theta_out)), 1e-9)
    if a <= radius:
        return 1.0
    s = math.sqrt((a**2 - radius**2) / (a**2 - b**2))
    return 2 / math.pi * (radius**2 / (a * b) * math.asin(b * s / radius) + math.acos(s))


def throughput(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths] true counts a second for cos(theta_in) x BRDF of 1/sr.

    Photons of a black body (Planck's law over the photon energy) times a smooth efficiency of fibre, grating and
    silicon that is best at 580 nm; scaled so that the brightest pixel sees `BRIGHTEST` on Spectralon.
    """
    second_radiation_constant = 1.438777e7  # h c / k in nm K (CODATA 2018)
    photons = wavelengths**-4 / np.expm1(second_radiation_constant / (wavelengths * LAMP_TEMPERATURE))
    efficiency = np.exp(-(((wavelengths - 580.0) / 300.0) ** 2))
    shape = photons * efficiency
    certified = _within(wavelengths, NOMINAL_SRS99.wavelengths)
    panel = NOMINAL_SRS99.brdf(np.array([0.0]), np.array([45.0]), certified)[0]
    return np.asarray(BRIGHTEST * shape / np.max(shape * panel))


def _within(wavelengths: FloatArray, table: FloatArray) -> FloatArray:
    """`wavelengths` without what a shifted scale carries beyond the ends of a `table`, where it is held constant."""
    return np.clip(wavelengths, table[0], table[-1])


def _true_wavelengths(pixels: FloatArray, imperfections: Imperfections) -> FloatArray:
    """Of the shape of `pixels`, which may be fractions, nm."""
    return _polynomial(pixels, WAVELENGTH_COEFFICIENTS) + imperfections.wavelength_offset


def _polynomial(x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """c0 + c1 x + c2 x^2 + ..., of the shape of `x`."""
    return np.asarray(np.polynomial.polynomial.polyval(x, coefficients), dtype=float)


_READ = np.linspace(0, 2 * FULL_SCALE, 4001)
_TRUE = _READ / _polynomial(np.minimum(_READ, FULL_SCALE), NONLINEARITY_COEFFICIENTS)
"""Dark-subtracted counts x of a non-linear detector, and the true ones x / polynomial(x): a table to invert that."""
