"""A measurement without the wire: the bench's light, noise and errors, straight to a calibrated dataset.

Ensembles of thousands of measurements need one in milliseconds, not minutes. So no device is driven and nothing is
stored: directions are taken as a dynamic plan takes them, the counts of a bin of pixels follow from the bench's own
throughput, gain, dark current and read noise, and every error that is stated of the bench is drawn once. What a dataset
says of its uncertainty is put together by calibration's own `goniometer.radiometry.sources`.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from analysis.reflectance.distributions import lobe_width
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, along_theta_out, aperture_excess, incidence_groups
from goniometer.datasets.checks import noise_flags
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.radiometry.drift import REFERENCE_WAVELENGTH
from goniometer.radiometry.footprint import CLIPPED_BELOW, share_on_sample
from goniometer.radiometry.response import STANDARD
from goniometer.radiometry.sources import Chain, Sums, error_sources
from goniometer.uncertainty import Groups
from simulators.bench.optics import FULL_SCALE, GAIN, READ_NOISE, STATED, dark_rate, throughput
from simulators.materials.materials import PANEL_CERTIFICATE
from simulators.materials.specimens import Specimen, specimen_brdf
from simulators.materials.surfaces import Surface

DETECTOR_TEMPERATURE = -10.0
"""Degrees Celsius."""

SHORTEST, LONGEST = 0.008, 10.0
"""Integration times between which the bench chooses, s."""

DARKS = 0.1
"""Noise of the mean dark, which all points share, as a part of that of a value."""

_SPECTROMETER_STEP = 0.77
"""Mean distance of two pixels, nm."""


@dataclass(frozen=True)
class Setup:
    """How it is measured."""

    wavelengths: FloatArray = field(default_factory=lambda: np.arange(385.0, 995.0, 20.0))
    """[wavelengths] centres of the bins, nm; a bin reaches half way to the next."""
    incident: tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0)
    """Incident angles, degrees."""
    shortest: float = SHORTEST
    longest: float = LONGEST
    """Shortest and longest integration time, s."""
    saturation_known: bool = True
    """Whether the calibration was told of full scale: saturated values then are gone and the point is flagged."""
    diameter_mm: float = 50.0
    """Of the sample."""
    diameter_known: bool = True
    """Whether the calibration was told of it: it then divides by the share of the footprint, and flags the point."""


def directions_of(alpha: float, incident: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out [points], degrees, as a dynamic plan takes them: dense in the lobe, none blocked."""
    width = max(lobe_width(alpha), STATED.aperture)
    near = width * np.array([-1.5, -1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0, 1.5])
    pairs = []
    for theta in incident:
        far = np.arange(-80.0, 81.0, 12.0)
        far = far[np.abs(far - theta) > 1.7 * width]
        outs = np.concatenate([theta + near, far])
        pairs += [(theta, out) for out in np.unique(outs) if abs(out) <= 85 and abs(theta + out) >= 5]
    theta_in, theta_out = np.array(pairs).T
    return theta_in, theta_out


def measure(specimen: Specimen | Surface, setup: Setup, seed: int, name: str = "simulated") -> Dataset:
    """The dataset of one measurement; the same `seed` gives the same errors. Raises `OutOfRange` as `specimen_brdf`."""
    rng = np.random.default_rng([seed, 20230])
    theta_in, theta_out = directions_of(specimen.alpha, setup.incident)
    incidence = incidence_groups(theta_in, SAME_INCIDENCE)
    light, at_reference = _received(specimen, setup, theta_in, theta_out, incidence, rng)
    cosine = np.cos(np.radians(theta_in))[:, None]
    ratio, sums = _counted(light, at_reference, setup, (theta_in, theta_out, incidence), rng)
    share = np.ones(theta_in.size)
    u_share = np.zeros(theta_in.size)
    if setup.diameter_known:
        share, wider = (
            share_on_sample(theta_out, STATED.field_of_view + more, setup.diameter_mm)
            for more in (0, STATED.u_field_of_view)
        )
        u_share = wider / share - 1
        ratio, sums = ratio / share[:, None], replace(sums, ratio=sums.ratio / share[:, None])
    brdf = np.where(sums.saturated, np.nan, ratio / cosine)
    slopes = along_theta_out(theta_out, incidence, brdf, sums.u_noise / cosine)
    chain = Chain(
        bench=STATED,
        settings=STANDARD,
        theta_in=theta_in,
        incidence=incidence,
        visits=incidence,
        wavelengths=setup.wavelengths,
        brdf=brdf,
        slopes=slopes,
        excess=aperture_excess(theta_in, theta_out, slopes, STATED.aperture),
        panel=PANEL_CERTIFICATE.brdf(theta_in, theta_out, setup.wavelengths),
        panel_errors=PANEL_CERTIFICATE.errors(theta_in, theta_out, setup.wavelengths),
        stray_measured=False,
        drift=None,
        reference_drift=None,
        between=None,
        u_share=u_share,
    )
    flags = noise_flags(brdf, sums.u_noise / cosine)
    flags[sums.saturated.any(axis=1)] |= np.uint16(Flag.SATURATED)
    if setup.diameter_known:
        flags[share < CLIPPED_BELOW] |= np.uint16(Flag.CLIPPED)
    return Dataset(
        sample=name,
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=setup.wavelengths,
        brdf=brdf,
        sources=error_sources(sums, chain),
        flags=flags,
        u_angle=STATED.u_angle,
        u_zero=STATED.u_zero,
        aperture=STATED.aperture,
        lineage={"simulated": name, "seed": seed},
    )


def _received(
    specimen: Specimen | Surface,
    setup: Setup,
    theta_in: FloatArray,
    theta_out: FloatArray,
    incidence: Groups,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """[points, wavelengths] cos(theta_in) f as the bench receives it, 1/sr, and [points, 1] the cosine at the panel.

    The angles, the aperture, the wavelength scale and the field of view are truly other than stated.
    """
    groups = int(incidence.max()) + 1
    zero_of_sample, zero_of_detector = rng.normal(0, STATED.u_zero, 2)
    sample, panel = rng.normal(0, STATED.u_angle, (2, groups))[:, incidence]
    detector = rng.normal(0, STATED.u_angle, theta_in.size)
    # the detector stage sets theta_in + theta_out, so that a turn of the sample moves both
    true_in = theta_in + sample + zero_of_sample
    true_out = theta_out + detector + zero_of_detector - sample - zero_of_sample
    aperture = STATED.aperture + rng.normal(0, STATED.u_aperture)
    wavelengths = setup.wavelengths + rng.normal(0, STATED.u_wavelength)
    field_of_view = STATED.field_of_view + rng.normal(0, STATED.u_field_of_view)
    light = np.cos(np.radians(true_in))[:, None] * specimen_brdf(specimen, true_in, true_out, wavelengths, aperture)
    light *= share_on_sample(true_out, field_of_view, setup.diameter_mm)[:, None]
    return light, np.cos(np.radians(theta_in + panel + zero_of_sample))[:, None]


def _counted(
    light: FloatArray,
    at_reference: FloatArray,
    setup: Setup,
    directions: tuple[FloatArray, FloatArray, Groups],
    rng: np.random.Generator,
) -> tuple[FloatArray, Sums]:
    """[points, wavelengths] cos(theta_in) f as calibrated, 1/sr, and what calibration knows of its errors."""
    theta_in, theta_out, incidence = directions
    wavelengths, shape = setup.wavelengths, light.shape
    pixels = max(1, round(float(np.median(np.diff(wavelengths))) / _SPECTROMETER_STEP))
    rate = throughput(wavelengths)
    certified = PANEL_CERTIFICATE.brdf(theta_in, theta_out, wavelengths)
    cosine = np.cos(np.radians(theta_in))[:, None]
    of_panel = cosine * certified

    def exposed(received: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value as read, its standard uncertainty from the counts, both 1/sr, and counts of a pixel."""
        brightest = (rate * received).max(axis=1, keepdims=True)
        seconds = np.clip(0.5 * FULL_SCALE / np.maximum(brightest, 1e-12), setup.shortest, setup.longest)
        per_value = GAIN * pixels * rate * seconds  # electrons
        dark = GAIN * pixels * dark_rate(DETECTOR_TEMPERATURE) * seconds + pixels * (GAIN * READ_NOISE) ** 2
        electrons = per_value * received
        electrons = electrons + np.sqrt(np.maximum(electrons, 0) + dark) * rng.standard_normal(shape)
        electrons = np.minimum(electrons, GAIN * pixels * FULL_SCALE)
        # what is stated follows from what was read
        u = np.sqrt(np.maximum(electrons, 0) + dark) / per_value
        return electrons / per_value, u, electrons / (GAIN * pixels)

    lamp = 1 + np.sqrt(2) * STATED.u_lamp * rng.normal() * np.maximum(REFERENCE_WAVELENGTH / wavelengths, 1.0)
    stray = STATED.u_stray_light * rng.normal()
    read, u_counts, counts = exposed(light * lamp + stray)
    nonlinear = STATED.u_nonlinearity * counts / FULL_SCALE
    read = read * (1 + nonlinear * rng.normal()) + DARKS * u_counts * rng.standard_normal(shape[1])
    _, of_reference, _ = exposed(of_panel)
    relative = of_reference / of_panel
    own, together = rng.standard_normal((int(incidence.max()) + 1, shape[1]))[incidence], rng.standard_normal(shape[1])
    certificate = sum(
        (rng.normal() * error for error in PANEL_CERTIFICATE.errors(theta_in, theta_out, wavelengths).values()),
        np.zeros(shape),
    )
    panel = at_reference / cosine * (1 + certificate) * (1 + relative * (0.7 * own + 0.7 * together)) + stray / of_panel
    ratio = np.asarray(read / panel)
    return ratio, Sums(
        ratio=ratio,
        u_random=u_counts,
        u_dark=(("of all", DARKS * u_counts),),
        dark_left=np.zeros(shape),
        dark_warming=np.zeros(shape),
        u_stray=np.zeros(shape),
        stray=np.zeros(shape),
        u_reference_counts=0.7 * relative * np.abs(ratio),
        u_reference_dark=0.7 * relative * np.abs(ratio),
        u_reference_stray=np.zeros(shape),
        nonlinearity=ratio * nonlinear,
        weights=np.eye(shape[0]),
        panel=np.ones(shape),
        response=np.ones(shape),
        u_noise=u_counts,
        saturated=(counts >= FULL_SCALE) & setup.saturation_known,
    )
