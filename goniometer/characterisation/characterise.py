"""How the bench measures itself: what is mounted, where the stages go, what is exposed.

Every procedure works on an open instrument, asks for what it needs on the sample stage through `mount`, and hands its
readings to an evaluation that is a pure function (`characterisation`, `alignment`, `lines`). All raise `DriverError`,
`GeometryError` where a region or a limit is in the way, and `CharacterisationError` where what is looked for does not
show.
"""

from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Literal

import numpy as np

from drivers.arrays import FloatArray
from goniometer.bench.instrument import Instrument
from goniometer.certificates.certificate import PanelCertificate
from goniometer.characterisation.alignment import Alignment, edge_sweep, evaluate_alignment, mirror_sweep
from goniometer.characterisation.evaluation import (
    Noise,
    Repeatability,
    Signature,
    StageRepeatability,
    band_scatter,
    evaluate_noise,
    evaluate_returns,
    evaluate_signature,
)
from goniometer.characterisation.lines import WavelengthScale, evaluate_lines, find_lines
from goniometer.characterisation.meter import Meter, Series, reading, series
from goniometer.characterisation.peaks import PLATEAU, flanks
from goniometer.errors import CharacterisationError, GeometryError
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE, Geometry, from_stages

Piece = Literal["mirror", "spectralon", "mercury-argon", "nothing"]
"""What a procedure wants on the sample stage."""
Mount = Callable[[Piece], Awaitable[None]]

LONGEST = 2.0
"""Longest integration time where the detector sees next to nothing, seconds."""

SEARCH, SEARCH_STEP = 5.0, 0.5
"""Degrees to each side of where a mirror should send its peak in which the peak is looked for."""

FINE, FINE_STEP = 1.5, 0.1
"""Degrees to each side of the peak that are swept finely."""

EDGES = (2.0, 8.0)
"""Degrees from the source axis between which an edge of the blocked sector is looked for."""

EDGE_POINTS = 13
"""Of each sweep that closes in on an edge."""

EDGE_STEP = 0.01
"""Degrees between the points of the last one, or more where stages repeat worse than by half of that."""

CLEAR = 10.0
"""Standard uncertainties by which an edge must stand clear of the noise."""

PANEL_TIME = 0.25
"""Seconds; enough to tell the panel from the dark."""

AWAY = 5.0
"""Degrees that a stage goes away before it comes back."""

RETURNS_STEP = {"sample": 0.005, "detector": 0.01}
"""Degrees between the angles to which a stage returns: all on the straight part of the flank, none of them twice, so
that errors of the encoder's own scale scatter as well."""


async def measure_signature(instrument: Instrument, mount: Mount, theta_in: float = 30.0) -> Signature:
    """Sweep the detector finely over a mirror's peak and coarsely over all directions that it can reach."""
    await mount("mirror")
    meter = Meter(instrument, await instrument.constants(), LONGEST)
    fine = [theta_in + step * FINE_STEP for step in range(-30, 31)]
    coarse = [angle for angle in np.arange(-85.0, 86.0, 5.0).tolist() if abs(angle - theta_in) > 3]
    wanted = [Geometry(theta_in, theta_out) for theta_out in sorted(fine + coarse)]
    readings = [await meter.read(geometry) for geometry in _possible(instrument, wanted)]
    measured = series(readings, meter.constants.wavelengths)
    return evaluate_signature(measured, meter.constants.bench.u_angle)


async def measure_noise(
    instrument: Instrument, mount: Mount, certificate: PanelCertificate, integration_time: float = 1.0, scans: int = 20
) -> Noise:
    """Expose the white panel at theta_in = 0 and theta_out = 45 degrees, then nothing at all, again and again.

    `scans` exposures of `integration_time` seconds and as many darks tell the noise-equivalent BRDF of ASTM E2387.
    Raises `CharacterisationError` where the panel saturates the detector at its shortest time.
    """
    geometry = Geometry(0.0, 45.0)
    await mount("spectralon")
    meter = Meter(instrument, await instrument.constants(), LONGEST)
    panel = await meter.read(geometry)
    wavelengths = meter.constants.wavelengths
    if panel.saturated.any():
        raise CharacterisationError("The white panel saturates the detector at its shortest time; dim the light")
    await mount("nothing")
    await instrument.arm.goto(geometry)
    light = np.stack([spectrum.counts for spectrum in await instrument.sequence(integration_time, scans)])
    darks = np.stack([(await instrument.dark(integration_time)).counts for _ in range(scans)])
    inside = (wavelengths >= certificate.wavelengths[0]) & (wavelengths <= certificate.wavelengths[-1])
    brdf = np.full(wavelengths.shape, np.nan)
    brdf[inside] = certificate.brdf(np.array([0.0]), np.array([45.0]), wavelengths[inside])[0]
    return evaluate_noise(light, darks, integration_time, panel, brdf, meter.constants)


async def measure_alignment(
    instrument: Instrument,
    mount: Mount,
    mirror_angles: Sequence[float] = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0),
    panel_angles: Sequence[float] = (0.0, 20.0, 40.0),
) -> Alignment:
    """Sweep over a mirror's peak at some incident angles, and with the panel over both edges of the blocked sector."""
    constants = await instrument.constants()
    u_angle = constants.bench.u_angle
    await mount("mirror")
    meter = Meter(instrument, constants, LONGEST)
    sweeps = []
    for angle in mirror_angles:
        sweeps.append(mirror_sweep(await _over_peak(meter, angle), u_angle))
    await mount("spectralon")
    meter = Meter(instrument, constants, LONGEST)
    for angle in panel_angles:
        for side in (-1, 1):
            sweeps.append(edge_sweep(await _over_edge(meter, angle, side, u_angle), u_angle))
    return evaluate_alignment(sweeps, u_angle)


async def measure_repeatability(
    instrument: Instrument, mount: Mount, theta_in: float = 30.0, returns: int = 10
) -> Repeatability:
    """Let each stage alone go away and come back to a mirror's flank, from both sides in random order."""
    await mount("mirror")
    meter = Meter(instrument, await instrument.constants(), LONGEST)
    peak = await _over_peak(meter, theta_in)
    # on a hundredth of a degree, where any stage can stand
    flank = round(flanks(peak.detector, peak.total, 0.5)[1], 2)
    sample, _ = await _returns(meter, "sample", theta_in, flank, returns)
    detector, bands = await _returns(meter, "detector", theta_in, flank, returns)
    return Repeatability(sample, detector, bands.wavelengths, band_scatter(detector.from_above, bands))


async def measure_wavelengths(instrument: Instrument, mount: Mount) -> WavelengthScale:
    """Take a spectrum of a mercury-argon lamp in place of the sample; the halogen lamp's shutter is open as ever."""
    await mount("mercury-argon")
    meter = Meter(instrument, await instrument.constants(), LONGEST)
    first = await meter.read(Geometry(0.0, 45.0))
    time = first.integration_time
    spectra = await instrument.sequence(time, 10)
    whole = reading(first.geometry, spectra, await meter.darks(time), meter.constants)
    rate = np.where(whole.saturated, np.nan, whole.rate)
    return evaluate_lines(find_lines(meter.constants.wavelengths, rate, np.hypot(whole.u, whole.u_dark)))


def _possible(instrument: Instrument, wanted: Iterable[Geometry]) -> list[Geometry]:
    """Those of `wanted` where the arm can stand."""
    possible = []
    for geometry in wanted:
        try:
            instrument.arm.check(geometry)
        except GeometryError:
            continue
        possible.append(geometry)
    return possible


async def _over_peak(meter: Meter, theta_in: float) -> Series:
    """The mirror's peak at one incident angle, swept finely with the shortest time that its maximum needs."""
    span = np.arange(-SEARCH, SEARCH + SEARCH_STEP / 2, SEARCH_STEP)
    looked = [Geometry(theta_in, theta_in + step) for step in span.tolist() if theta_in + step <= LARGEST_ANGLE]
    found = [await meter.read(geometry) for geometry in _possible(meter.instrument, looked)]
    wavelengths = meter.constants.wavelengths
    brightest = max(found, key=lambda r: float(r.rate.sum()))
    middle = round(brightest.geometry.theta_out, 1)
    time = min(r.integration_time for r in found)
    span = np.arange(-FINE, FINE + FINE_STEP / 2, FINE_STEP)
    fine = [Geometry(theta_in, round(middle + step, 6)) for step in span.tolist()]
    readings = [await meter.read(geometry, time=time) for geometry in _possible(meter.instrument, fine)]
    return series(readings, wavelengths)


async def _over_edge(meter: Meter, theta_in: float, side: int, u_angle: float) -> Series:
    """The edge of the blocked sector on one side (+1 or -1) with what belongs to it on both sides, swept finely."""
    low, high = EDGES
    for _ in range(2):
        places = np.linspace(low, high, EDGE_POINTS)
        low, high = _bracket(places, await _step(meter, theta_in, side, places))
    margin = 4 * u_angle + (high - low) / PLATEAU
    low, high = low - margin, high + margin
    # on hundredths of a degree, where any stage can stand
    step = round(max(EDGE_STEP, 2 * u_angle, (high - low) / 40), 2)
    return await _step(meter, theta_in, side, np.arange(round(low, 2), high + step, step))


async def _step(meter: Meter, theta_in: float, side: int, places: FloatArray) -> Series:
    """The panel's signal with the detector stage at `places`, degrees from the source axis on one side of it."""
    readings = [
        await meter.read(from_stages(theta_in, side * place), time=PANEL_TIME, face_source=place < BLOCKED_HALF_WIDTH)
        for place in places.tolist()
    ]
    return series(readings, meter.constants.wavelengths)


def _bracket(places: FloatArray, swept: Series) -> tuple[float, float]:
    """Between which of ascending `places` the signal goes from dark to light."""
    dark, light = swept.total[:PLATEAU].mean(), swept.total[-PLATEAU:].mean()
    if light - dark < CLEAR * swept.u_total.max():
        raise CharacterisationError(
            f"The panel is no brighter {places[-1]:.2f}° from the source axis than at {places[0]:.2f}°, so the edge of "
            f"the blocked sector is not seen; look whether the panel is mounted and the lamp is on"
        )
    level = (swept.total - dark) / (light - dark)
    return float(places[level < 0.1].max()), float(places[level > 0.9].min())


async def _returns(
    meter: Meter, stage: Literal["sample", "detector"], sample: float, detector: float, returns: int
) -> tuple[StageRepeatability, Series]:
    """One stage comes back `returns` times to about where it belongs, the other rests."""
    random = np.random.default_rng(1)
    offsets = RETURNS_STEP[stage] * (random.permutation(returns) - returns // 2)
    from_above = random.permutation(np.arange(returns) % 2 == 0)
    time: float | None = None
    readings, wanted = [], []
    for offset, above in zip(offsets.tolist(), from_above.tolist(), strict=True):
        aside = AWAY if above else -AWAY
        at = (sample + offset, detector) if stage == "sample" else (sample, detector + offset)
        away = (at[0] + aside, at[1]) if stage == "sample" else (at[0], at[1] + aside)
        await meter.instrument.arm.goto(from_stages(*away))
        readings.append(await meter.read(from_stages(*at), time=time))
        time = readings[0].integration_time
        wanted.append(at[0] if stage == "sample" else at[1])
    measured = series(readings, meter.constants.wavelengths)
    return evaluate_returns(stage, np.array(wanted), from_above, measured), measured
