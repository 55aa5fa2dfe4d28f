"""A colour camera that looks at a topography under a collimated LED: spectra, pixels and their noise (section 3.3).

A value of 1 in a channel is a perfectly white, Lambertian panel under the same LED at normal incidence. The LED is the
CIE's phosphor-converted LED-B5 and the camera a Nikon D5100 as the National Physical Laboratory measured it, both from
`colour-science`; the paper's are a high power LED of unknown spectrum and a Nikon D810.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, cos, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from analysis.reflectance.directions import Aperture, in_plane, round_aperture
from analysis.reflectance.fresnel import Conductor, fresnel_conductor
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import Kernel
from simulators.topographies.heights import HeightField, complete
from simulators.waves.diffraction import Coherence
from simulators.waves.sampling import CoarseSampling, Sampling, sampling
from simulators.waves.speckle import Lens, Lighting, PhaseScreen, image_points, phase_screen, squared_field
from simulators.waves.waves import obliquity

FIRST_NM, LAST_NM = 400.0, 700.0
"""The camera sees no other wavelengths: its filters pass less than a thousandth of what they pass at best."""

MOST_LED = 10.0
"""Degrees, from edge to edge, above which an LED is not collimated."""

_STEP = 0.4
"""Of the radius of the pupil, by which the speckle of neighbouring wavelengths may be apart; 1 to 2 % in contrast."""

_FEWEST_STEPS = 30
"""Between wavelengths, enough for the spectra of LED and camera by themselves."""


@dataclass(frozen=True)
class Sensor:
    """Pixels with red, green and blue each at the same place, as three exposures of a shifted sensor would give."""

    pixel_um: float = 4.88
    """Side of a pixel, um; that of a Nikon D810."""
    full_well: float = 60_000.0
    """Electrons at which a pixel saturates."""
    read_noise: float = 5.0
    """Standard deviation, electrons."""
    dark_current: float = 0.1
    """Electrons per pixel and second."""
    panel: float = 1.5e6
    """Electrons per pixel and second in the most sensitive channel for a white panel at normal incidence."""
    black_level: int = 1024
    """Counts without light, so that noise is not cut off below."""

    def counts(self, values: FloatArray, sensitivity: FloatArray, exposure: float, seed: int) -> NDArray[np.uint16]:
        """[y, x, 3] counts of 16 bits for `values` of the same shape, with the noise of photons, dark and read-out.

        `sensitivity` [3] is relative to the most sensitive channel, `exposure` in seconds.
        """
        rng = np.random.default_rng(seed)
        expected = (np.maximum(values, 0) * sensitivity * self.panel + self.dark_current) * exposure
        electrons = rng.poisson(expected) + rng.normal(0, self.read_noise, expected.shape)
        counts = self.black_level + electrons * (65535 - self.black_level) / self.full_well
        return np.asarray(np.clip(np.round(counts), 0, 65535).astype(np.uint16))

    def exposure(self, values: FloatArray, sensitivity: FloatArray) -> float:
        """Seconds, in third stops from 1/8000 to 30, at which all but a thousandth stay below 0.7 of saturation."""
        brightest = float(np.quantile((values * sensitivity).max(axis=-1), 0.999))
        wanted = 0.7 * self.full_well / (self.panel * max(brightest, 1e-12))
        stops = np.floor(3 * np.log2(np.clip(wanted, 1 / 8000, 30.0)) + 1e-9)
        return float(2.0 ** (stops / 3))


@dataclass(frozen=True)
class Response:
    """What the channels of a camera make of light of an LED."""

    wavelengths: FloatArray
    """[wavelengths] nm, ascending."""
    weights: FloatArray
    """[wavelengths, 3] of red, green and blue; those of a channel add up to one."""
    sensitivity: FloatArray
    """[3] signals of a white panel, relative to the largest."""
    colour_matrix: FloatArray
    """[3, 3] takes white-balanced signals to linear sRGB, white to white; a least-squares fit of its filters to the
    CIE 1931 observer under the LED, of which no camera is a combination."""


def response(wavelengths: FloatArray) -> Response:
    """Of the LED and the camera, for spectra that are linear between `wavelengths` (nm, ascending)."""
    import colour  # noqa: PLC0415  (takes seconds)

    fine = np.arange(FIRST_NM, LAST_NM + 1)
    led = colour.SDS_ILLUMINANTS["LED-B5"]
    filters = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    light = np.interp(fine, led.wavelengths, led.values)
    seen, by_eye = (
        np.stack([np.interp(fine, table.wavelengths, table.values[:, i]) * light for i in range(3)], axis=1)
        for table in (filters, observer)
    )
    total = seen.sum(axis=0)
    matrix = np.asarray(colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB)
    # white is white on both sides, whatever the LED: von Kries in linear sRGB, as a white balance does it
    wanted = by_eye @ matrix.T
    wanted /= wanted.sum(axis=0)
    balanced = seen / total
    fitted = np.linalg.lstsq(balanced, wanted, rcond=None)[0].T
    # spreads what rows lack of one over their entries, which is the smallest change that keeps white white
    fitted += (1 - fitted.sum(axis=1, keepdims=True)) / 3
    return Response(wavelengths, _hats(wavelengths, fine).T @ balanced, total / total.max(), fitted)


def _hats(wavelengths: FloatArray, fine: FloatArray) -> FloatArray:
    """[fine, wavelengths] how much each of `wavelengths` counts in a linear interpolation at `fine`."""
    return np.stack([np.interp(fine, wavelengths, one) for one in np.eye(wavelengths.size)], axis=1)


@dataclass(frozen=True)
class Scene:
    """A topography, a lens and an LED, ready to be photographed."""

    screen: PhaseScreen
    lens: Lens
    lights: tuple[Lighting, ...]
    """One for each photograph."""
    size_um: tuple[float, float]
    """Of the topography, (across, along) the plane of incidence, um."""
    periodic: bool
    sampling: Sampling
    """Whether the topography is fine enough."""
    kernel: Kernel
    conductor: Conductor | None


def lighting_for(field: HeightField, lens: Lens, theta_in: float, led_angle: float, finer: int = 1) -> Lighting:
    """A round LED of `led_angle` degrees, from edge to edge, at `theta_in` in degrees, finely enough for `field`.

    Wavelengths lie even in wave numbers k, so that speckle changes little from each to the next. It follows
    exp(-(dkz Sq)^2 / 2) for a change dkz (Goodman, Speckle Phenomena in Optics, section 6.3), and a sum at steps of
    1 / Sq has the contrast of the integral to 1e-4; off the mirror direction it also wanders over the pupil, of which
    a step is `_STEP` of the radius. Rings of points of the LED are a quarter of the lens apart. `finer` times as many
    of both show whether that was enough. Raises `InputError` for an impossible LED.
    """
    if not 0 <= led_angle <= MOST_LED:
        raise InputError(f"A collimated LED is seen under 0 to {MOST_LED:g} degrees, but {led_angle:g} was given.")
    out, incident = radians(lens.theta_out), radians(theta_in)
    range_k, least_k = 2 * pi * (1e3 / FIRST_NM - 1e3 / LAST_NM), 2 * pi * 1e3 / LAST_NM
    phases = (cos(out) + cos(incident)) * range_k * float(np.std(complete(field)))
    radius = least_k * lens.numerical_aperture * cos(out)
    wandering = abs(sin(out) - sin(incident)) * range_k / (_STEP * radius)
    count = finer * ceil(max(_FEWEST_STEPS, phases, wandering)) + 1
    wavelengths = 1 / np.linspace(1 / FIRST_NM, 1 / LAST_NM, count)
    if led_angle == 0:
        return Lighting(theta_in, wavelengths, Aperture(np.zeros(1), np.zeros(1), np.ones(1)))
    rings = finer * (1 + ceil(radians(led_angle) / lens.numerical_aperture))
    return Lighting(theta_in, wavelengths, round_aperture(led_angle, rings, 6 * rings))


def scene(
    field: HeightField,
    lens: Lens,
    lights: Sequence[Lighting],
    conductor: Conductor | None = None,
    kernel: Kernel = Kernel.HARVEY_SHACK,
) -> Scene:
    """Of `field`, to be photographed in each of `lights`; without a `conductor` its material reflects all light.

    Warns of `CoarseSampling`. Raises `UnfitTopography` and `InputError` as `phase_screen` does, and `OutOfRange` beyond
    the conductor's table.
    """
    fineness = fineness_for(field, lens, lights)
    if not fineness.sufficient:
        warnings.warn(fineness.message, CoarseSampling, stacklevel=2)
    ny, nx = field.heights_um.shape
    size = ny * field.pitch_um, nx * field.pitch_um
    screen = phase_screen(field, lens, lights)
    return Scene(screen, lens, tuple(lights), size, field.periodic, fineness, kernel, conductor)


def fineness_for(field: HeightField, lens: Lens, lights: Sequence[Lighting]) -> Sampling:
    """Whether `field` is fine enough for all that `lens` sees of it, and else by how much to refine it.

    Raises `UnfitTopography` where heights are missing.
    """
    vectors = [light.wave_vectors(lens) for light in lights]
    kx, kz = (np.concatenate([v[axis].ravel() for v in vectors]) for axis in (0, 2))
    smallest = min(float(window_of(lens).size(light.wavelengths).min()) for light in lights)
    return sampling(field, kx, kz, smallest)


def window_of(lens: Lens) -> Coherence:
    """The Gaussian window that resolves angles like `lens`: of the same variance, see `diffraction.seen_through`."""
    return Coherence(0.6 / (np.sqrt(2) * pi * lens.numerical_aperture))


def spectral_factors(scene: Scene, lighting: Lighting) -> FloatArray:
    """[wavelengths] pi f cos(theta_in) over |E|^2 in 1/um^2: radiance relative to a white panel at normal incidence."""
    theta_in, theta_out = np.array([lighting.theta_in]), np.array([scene.lens.theta_out])
    wavelengths = lighting.wavelengths
    share = pi * float(np.cos(np.radians(theta_in[0]))) * obliquity(scene.kernel, theta_in, theta_out)[0]
    factors = share / (1e-3 * wavelengths) ** 2
    if scene.conductor is None:
        return np.asarray(factors)
    n, k = scene.conductor.index(wavelengths)
    return np.asarray(factors * fresnel_conductor(in_plane(theta_in, theta_out).cos_d, n, k))


def photograph(scene: Scene, sensor: Sensor, number: int) -> FloatArray:
    """[y, x, 3] white-balanced values of the pixels in the light of this `number`, without noise.

    x runs along the plane of incidence, where pixels see 1 / cos(theta_out) more of the surface.
    """
    lighting = scene.lights[number]
    points = image_points(scene.screen, scene.lens, lighting.wavelengths)
    weights = spectral_factors(scene, lighting)[:, None] * response(lighting.wavelengths).weights
    channels = np.zeros((3, *points))
    for i, weight in enumerate(weights):
        channels += weight[:, None, None] * squared_field(scene.screen, scene.lens, lighting, i, points)
    across, along = pixel_sizes(scene.lens, sensor)
    margin = 0.0 if scene.periodic else 1e-3 * LAST_NM / scene.lens.numerical_aperture
    rows = _pixels(points[0], scene.size_um[0], across, margin)
    columns = _pixels(points[1], scene.size_um[1], along, margin / cos(radians(scene.lens.theta_out)))
    return np.asarray(np.moveaxis(rows @ channels @ columns.T, 0, -1))


def pixel_sizes(lens: Lens, sensor: Sensor) -> tuple[float, float]:
    """(across, along) the plane of incidence, of a pixel on the surface, um."""
    across = sensor.pixel_um / lens.magnification
    return across, across / cos(radians(lens.theta_out))


def _pixels(points: int, size: float, pixel: float, margin: float) -> FloatArray:
    """[pixels, points] means over pixels of a band-limited, periodic function on `points` of a patch of `size` um.

    Exact: each harmonic is averaged over the pixel (a sinc) and evaluated at its middle. Pixels keep off the edges by
    `margin` um.
    """
    count = int((size - 2 * margin) / pixel)
    middles = size / 2 + (np.arange(count) - (count - 1) / 2) * pixel
    harmonic = np.fft.fftfreq(points, 1 / points)
    mean = np.sinc(harmonic * pixel / size) * np.exp(2j * pi * np.outer(middles / size, harmonic))
    return np.asarray(np.fft.fft(mean, axis=1).real / points)
