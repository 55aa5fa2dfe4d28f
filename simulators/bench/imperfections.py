"""What a bench does wrong, as opposed to its noise: errors that stay the same, or change slowly, while it measures.

The operator of a real bench never knows these numbers; what he knows is how large they may be, which is his
`goniometer.constants.BenchData`. `drawn` makes a bench about which such a statement is true.
"""

import hashlib
from dataclasses import dataclass
from functools import cache

import numpy as np

from drivers.arrays import FloatArray
from goniometer.certificates.certificate import Certificate
from goniometer.certificates.reference import reference_relative_uncertainty
from goniometer.constants import BenchData

STRAY_LIGHT = 1e-5
"""Stray light of a bench that was built with care, as BRDF times cos(theta_in), 1/sr."""

DRAWN_STRAY_LIGHT = (1e-4, 5e-4)
"""Least and most stray light of a bench that is drawn: as much as a grazing or a dark point of a mirror, 1/sr."""

DRIFT_PERIOD = 3600.0
"""Period of the lamp's slow drift, seconds."""

WARM_UP_TIME = 300.0
"""Seconds in which what a cold lamp lacks falls to 1/e."""

PANEL_CORRELATION = 35.0
"""Degrees of either angle over which the panel's departure from its certificate loses its likeness (exp(-1/2))."""

_WAVES = 12
"""Cosines that make up one panel's departure: enough for its distribution over panels to be nearly normal."""


@dataclass(frozen=True)
class Imperfections:
    """The true errors of one bench; as it stands, an ideal bench with a little stray light."""

    lamp_drift: float = 0.0
    """Relative amplitude, at 600 nm, of a slow sine of the lamp's output over time."""
    lamp_phase: float = 0.0
    """Of that sine at the start of the clock, degrees."""
    lamp_warm_up: float = 0.0
    """By how much of its output, at 600 nm, the lamp is dimmer when it is switched on: at the start of the clock."""
    stray_light: float = STRAY_LIGHT
    """As the BRDF times cos(theta_in) that would give the same signal, 1/sr; the same at all angles."""
    nonlinearity: float = 0.0
    """Relative error at full scale of counts from which the device's own polynomial was divided out; less in proportion
    to the counts."""
    wavelength_offset: float = 0.0
    """True wavelength of each pixel minus what the spectrometer's coefficients say, nm."""
    sample_zero: float = 0.0
    """True angle of the sample stage minus its read-back, degrees."""
    detector_zero: float = 0.0
    """True angle of the detector stage minus its read-back, degrees."""
    aperture_error: float = 0.0
    """True full angle of the detector's aperture minus the stated one, degrees."""
    field_of_view_error: float = 0.0
    """True diameter of what the detector sees at normal view minus the stated one, mm."""
    panel_level: float = 0.0
    """Standard uncertainties of the certificate by which the white panel is brighter than it, at all wavelengths."""
    panel_seed: int | None = None
    """Of the panel's departure from the tabulated spread over directions; None for no departure."""
    cooler_ripple: float = 0.0
    """Amplitude of a slow sine of the sensor's temperature, degrees Celsius."""

    def lamp(self, moment: float, wavelengths: FloatArray) -> FloatArray:
        """[wavelengths] output of the warm lamp at `moment`, seconds, relative to its mean; less while it warms up.

        A filament that gets hotter brightens the blue most: the relative change goes with 1 / lambda (Wien's law, for
        a small change of temperature). `wavelengths` in nm.
        """
        sine = np.sin(2 * np.pi * moment / DRIFT_PERIOD + np.radians(self.lamp_phase))
        missing = self.lamp_warm_up * np.exp(-moment / WARM_UP_TIME)
        return np.asarray(1 + (self.lamp_drift * sine - missing) * 600.0 / wavelengths)

    def panel(
        self, certificate: Certificate, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray
    ) -> FloatArray:
        """[points, wavelengths] true BRDF of a white panel over what its `certificate` makes of it.

        `theta_in`, `theta_out` [points] in degrees, signed; `wavelengths` in nm, within the certificate. The departure
        over directions is a smooth random field with the standard deviation that
        `goniometer.certificates.reference.reference_relative_uncertainty` states and a correlation of
        exp(-(distance / `PANEL_CORRELATION`)^2 / 2): a sum of cosines (random Fourier features, Rahimi & Recht 2007).
        """
        u_level = np.interp(wavelengths, certificate.wavelengths, certificate.u_reflectance)
        level = 1 + self.panel_level * u_level / certificate.reflectance(wavelengths)
        if self.panel_seed is None:
            return np.broadcast_to(level, (theta_in.size, wavelengths.size))
        frequencies, phases = _waves(self.panel_seed)
        arguments = np.stack([theta_in, theta_out], axis=-1) @ frequencies + phases
        field = np.sqrt(2 / _WAVES) * np.cos(arguments).sum(axis=-1)
        spread = 1 + reference_relative_uncertainty(theta_in, theta_out) * field
        return np.asarray(spread[:, None] * level)


IDEAL = Imperfections()
"""A bench that does nothing wrong."""


def drawn(seed: int, data: BenchData, lamp_drift: float = 0.0) -> Imperfections:
    """A bench of which `data` is a true statement: each error is normal, with the standard uncertainty stated for it.

    Stray light is uniform within `DRAWN_STRAY_LIGHT`, the lamp's phase uniform. The same `seed` and `data` give the
    same bench. Nothing depends on time but a `lamp_drift`, the relative amplitude at 600 nm.
    """

    def normal(name: str, u: float) -> float:
        return float(generator(seed, "imperfection", name).normal(0, u))

    def uniform(name: str, low: float, high: float) -> float:
        return float(generator(seed, "imperfection", name).uniform(low, high))

    return Imperfections(
        lamp_drift=lamp_drift,
        lamp_phase=uniform("lamp phase", 0, 360),
        stray_light=uniform("stray light", *DRAWN_STRAY_LIGHT),
        nonlinearity=normal("non-linearity", data.u_nonlinearity),
        wavelength_offset=data.wavelength_offset + normal("wavelength", data.u_wavelength),
        sample_zero=normal("sample zero", data.u_zero),
        detector_zero=normal("detector zero", data.u_zero),
        aperture_error=normal("aperture", data.u_aperture),
        field_of_view_error=normal("field of view", data.u_field_of_view),
        panel_level=normal("panel level", 1.0),
        panel_seed=seed,
    )


def generator(*key: object) -> np.random.Generator:
    """Random numbers that depend on `key` and on nothing else, in this process and in any other."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()))


@cache
def _waves(seed: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies [2, waves], radians a degree, and phases [waves], radians, of one panel's departure."""
    random = generator(seed, "panel")
    return random.normal(0, 1 / PANEL_CORRELATION, (2, _WAVES)), random.uniform(0, 2 * np.pi, _WAVES)
