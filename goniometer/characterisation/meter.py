"""How much light the detector gets in one direction, for measurements of the bench itself.

The signal of a pixel is

    s = x / polynomial(x) / integration time,   x = mean counts - mean dark,

as in calibration, with dark spectra that the meter takes for each integration time when it is first needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.arrays import BoolArray, CountArray, FloatArray
from drivers.interfaces import Spectrum
from goniometer.bench.instrument import Instrument
from goniometer.constants import Constants
from goniometer.errors import CharacterisationError
from goniometer.geometry import Geometry

DARKS = 4
"""Dark spectra of each integration time."""

FILL = 0.5
"""Part of the largest count that the brightest pixel shall reach."""

STEP_DOWN = 16
"""After a saturated spectrum the integration time becomes shorter by this factor."""

BIN = 6
"""Adjacent pixels in a band, as in calibration."""

USED = (380.0, 995.0)
"""Wavelengths between which pixels are binned, nm; outside a halogen lamp gives too little light."""


@dataclass(frozen=True)
class Reading:
    """What the detector saw in one direction; all arrays [pixels]."""

    geometry: Geometry
    """As the stages read it back."""
    integration_time: float
    """Seconds."""
    rate: FloatArray
    """Linear signal without dark, counts per second."""
    u: FloatArray
    """Standard uncertainty of `rate` by the noise of its own spectra, counts per second."""
    u_dark: FloatArray
    """Standard uncertainty of `rate` by the noise of the darks, which all readings of one integration time share."""
    saturated: BoolArray
    """Pixels whose signal is not known."""


@dataclass(frozen=True)
class Series:
    """Readings in several directions, in bands of `BIN` pixels none of which was ever saturated."""

    wavelengths: FloatArray
    """[bands] mean of the pixels' wavelengths, nm."""
    sample: FloatArray
    """[points] angle of the sample stage as read back, degrees."""
    detector: FloatArray
    """[points] angle of the detector stage as read back, degrees."""
    rate: FloatArray
    """[points, bands] mean signal of a band's pixels, counts per second."""
    u: FloatArray
    """[points, bands] standard uncertainty of `rate` by the noise of a point's own spectra, counts per second."""
    u_dark: FloatArray
    """[points, bands] standard uncertainty of `rate` by the noise of the darks that points share, counts per second."""

    @property
    def total(self) -> FloatArray:
        """[points] sum of all bands, counts per second."""
        return np.asarray(self.rate.sum(axis=1))

    @property
    def u_total(self) -> FloatArray:
        """[points] standard uncertainty of `total` by the noise of a point's own spectra, counts per second."""
        return np.asarray(np.sqrt((self.u**2).sum(axis=1)))


class Meter:
    """Reads the signal of an open bench. Methods raise what `Instrument` raises."""

    def __init__(self, instrument: Instrument, constants: Constants, longest: float) -> None:
        """`longest` integration time that is chosen where none is given, seconds."""
        self.instrument = instrument
        self.constants = constants
        shortest = instrument.integration_limits[0]
        # powers of two, so that few dark spectra serve all
        self.times = [shortest]
        while self.times[-1] * 2 <= longest:
            self.times.append(self.times[-1] * 2)
        self._time = shortest
        self._darks: dict[float, CountArray] = {}

    async def read(self, geometry: Geometry, *, time: float | None = None, face_source: bool = False) -> Reading:
        """Go to `geometry` and take one spectrum of `time` seconds, or of the longest time that is not too bright.

        `face_source` allows directions in which the detector stands in front of the source.
        """
        if face_source:
            reached = await self.instrument.arm.face_source(geometry.sample_angle, geometry.detector_angle)
        else:
            reached = await self.instrument.arm.goto(geometry)
        spectrum = await (self._well_exposed() if time is None else self.instrument.expose(time))
        return reading(reached, [spectrum], await self.darks(spectrum.integration_time), self.constants)

    async def darks(self, time: float) -> CountArray:
        """[`DARKS`, pixels] dark spectra of `time` seconds."""
        if time not in self._darks:
            self._darks[time] = np.stack([(await self.instrument.dark(time)).counts for _ in range(DARKS)])
        return self._darks[time]

    async def _well_exposed(self) -> Spectrum:
        """A spectrum that fills `FILL`; one that is saturated at the shortest time is taken as it is."""
        ceiling = float("inf")
        while True:
            time = self._time
            spectrum = await self.instrument.expose(time)
            if spectrum.counts.max() >= self.constants.saturation:
                ceiling = time
                better = max((t for t in self.times if t <= time / STEP_DOWN), default=self.times[0])
            else:
                dark = (await self.darks(time)).mean(axis=0)
                rate = max(float((spectrum.counts - dark).max()) / time, 1e-9)
                fitting = (t for t in self.times if t * rate <= FILL * self.constants.saturation and t < ceiling)
                better = max(fitting, default=self.times[0])
                better = better if better > 2 * time else time
            if better == time:
                return spectrum
            self._time = better


def reading(geometry: Geometry, spectra: Sequence[Spectrum], darks: CountArray, constants: Constants) -> Reading:
    """The linear signal of `spectra` of one integration time, with `darks` [read-outs, pixels] of the same time."""
    counts = np.stack([spectrum.counts for spectrum in spectra])
    time = spectra[0].integration_time
    above = counts.mean(axis=0) - darks.mean(axis=0)
    factor = np.polynomial.polynomial.polyval(above, constants.nonlinearity)
    read_out = float(darks.var(axis=0, ddof=1).mean())
    true = above / factor
    variance = (np.maximum(true, 0) / constants.bench.gain + read_out / factor**2) / len(counts)
    u_dark = np.sqrt(read_out / len(darks)) / factor
    saturated = np.any(counts >= constants.saturation, axis=0)
    return Reading(geometry, time, true / time, np.sqrt(variance) / time, u_dark / time, saturated)


def binned(values: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[..., bands] means over `BIN` adjacent pixels of `values` [..., pixels] within `USED`."""
    inside = np.flatnonzero((wavelengths >= USED[0]) & (wavelengths <= USED[1]))
    whole = inside[: len(inside) // BIN * BIN]
    return np.asarray(values[..., whole].reshape(*values.shape[:-1], -1, BIN).mean(axis=-1))


def series(readings: Sequence[Reading], wavelengths: FloatArray) -> Series:
    """`readings` as arrays; raises `CharacterisationError` where every band is saturated in some of them."""
    saturated = np.any([r.saturated for r in readings], axis=0)
    kept = binned(saturated.astype(float), wavelengths) == 0
    if not kept.any():
        raise CharacterisationError(
            "The detector is saturated at every wavelength at its shortest integration time; dim the light"
        )
    rate = binned(np.array([r.rate for r in readings]), wavelengths)[:, kept]
    u, u_dark = (
        np.sqrt(binned(np.array(values) ** 2, wavelengths)[:, kept] / BIN)
        for values in ([r.u for r in readings], [r.u_dark for r in readings])
    )
    return Series(
        binned(wavelengths, wavelengths)[kept],
        np.array([r.geometry.sample_angle for r in readings]),
        np.array([r.geometry.detector_angle for r in readings]),
        rate,
        u,
        u_dark,
    )
