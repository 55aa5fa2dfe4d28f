"""Every source of error of a calibrated BRDF, by what it does to each value and by who shares it.

| part | what | shared by |
|---|---|---|
| random | shot and read-out noise of the point's own spectra | nobody |
| dark | noise of the mean dark spectra of one integration time | points, not wavelengths |
| | detector warmer than for its dark spectra | all |
| reference | counts and darks of the reference scan | points of one incident angle; all points; not wavelengths |
| | certificate, spread over directions of the panel | all |
| non-linearity | what the detector's polynomial leaves, in proportion to the counts | all |
| angle | zero of each stage | all |
| | position of the sample stage, now and at the reference | points of one visit or incident angle, wavelengths |
| | position of the detector stage | wavelengths |
| wavelength | shift of the wavelength scale | all |
| drift | lamp between monitors; between the scans | points between two monitors; all |
| aperture | its size; if corrected for, also what a parabola misses | all |
| stray light | its noise; whether it is the same in all directions | points of one incident angle; all |
| footprint | what the detector sees beyond the sample | all |

A correction that was left out leaves its own size as uncertainty, or the stated bound where nothing was measured.
Formulas: law of propagation of uncertainty (JCGM 100:2008, 5.1 and 5.2), first order in each error.
"""

from dataclasses import dataclass

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.constants import BenchData
from goniometer.datasets.angular import Derivatives
from goniometer.radiometry.drift import REFERENCE_WAVELENGTH, LampBetween, LampDrift
from goniometer.radiometry.response import Settings
from goniometer.uncertainty import ErrorSource, Groups, everywhere

STRAY_UNIFORMITY = 0.1
"""Relative standard uncertainty of measured stray light: in front of the source it may differ from elsewhere."""

PARABOLA = 0.25
"""Relative standard uncertainty of a correction for the aperture: a lobe is no parabola."""


@dataclass(frozen=True)
class Sums:
    """The ratio cos(theta_in) f and what errors of counts do to it; [points, wavelengths] in 1/sr but for the last."""

    ratio: FloatArray
    u_random: FloatArray
    u_dark: tuple[tuple[str, FloatArray], ...]
    """By set of dark spectra."""
    dark_left: FloatArray
    """Change by dark signals that were not subtracted."""
    dark_warming: FloatArray
    """Change by dark signals that were subtracted for another temperature."""
    u_stray: FloatArray
    stray: FloatArray
    """Change by the measured stray light of sample and reference."""
    u_reference_counts: FloatArray
    u_reference_dark: FloatArray
    u_reference_stray: FloatArray
    nonlinearity: FloatArray
    """Change for one standard uncertainty of what the polynomial leaves, or by leaving it out."""
    weights: FloatArray
    """[points, reference points] of the interpolation between reference points."""
    panel: FloatArray
    """[reference points, wavelengths] response at each of them, counts per second and 1/sr."""
    response: FloatArray
    """[points, wavelengths] interpolated response."""
    u_noise: FloatArray
    """Of the point's own counts and darks."""
    saturated: BoolArray


@dataclass(frozen=True)
class Chain:
    """What else is known of a measurement when its errors are put together."""

    bench: BenchData
    settings: Settings
    theta_in: FloatArray
    """[points] degrees."""
    incidence: Groups
    """[points] number of the incident angle."""
    visits: Groups
    """[points] number of the visit of the sample stage."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr, NaN without a value."""
    slopes: Derivatives
    """Of `brdf` over theta_out."""
    excess: FloatArray
    """[points, wavelengths] of the average over the aperture above the value at its centre, 1/sr."""
    panel: FloatArray
    """[points, wavelengths] BRDF of the panel in the same directions, 1/sr."""
    panel_errors: dict[str, FloatArray]
    """Relative, [reference points, wavelengths], by name."""
    stray_measured: bool
    drift: LampDrift | None
    reference_drift: LampDrift | None
    between: LampBetween | None
    u_share: FloatArray
    """[points] relative change of the share of the footprint on the sample, and on the panel, for one standard
    uncertainty."""


def error_sources(sums: Sums, chain: Chain) -> tuple[ErrorSource, ...]:
    """All sources, in the order of `goniometer.uncertainty.PARTS`; zero where the BRDF has no value."""
    valid = np.isfinite(chain.brdf)
    cosine = np.cos(np.radians(chain.theta_in))[:, None]
    all_points = everywhere(chain.theta_in.size)
    found: list[ErrorSource] = []

    def add(name: str, part: str, values: FloatArray, groups: Groups | None, *, shared: bool) -> None:
        values = np.where(valid, values, 0.0)
        if values.any():
            found.append(ErrorSource(name, part, values, groups, shared))

    add("random", "random", sums.u_random / cosine, None, shared=False)
    for name, u in sums.u_dark:
        add(f"dark: {name}", "dark", u / cosine, all_points, shared=False)
    add("dark: temperature", "dark", sums.dark_warming / cosine, all_points, shared=True)
    add("dark: not subtracted", "dark", sums.dark_left / cosine, all_points, shared=True)
    add("reference: counts", "reference", sums.u_reference_counts / cosine, chain.incidence, shared=False)
    add("reference: dark", "reference", sums.u_reference_dark / cosine, all_points, shared=False)
    f = np.where(valid, chain.brdf, 0.0)
    for name, relative in chain.panel_errors.items():
        of_point = sums.weights @ (sums.panel * relative) / sums.response
        add(f"reference: {name}", "reference", f * of_point, all_points, shared=True)
    add("non-linearity", "non-linearity", sums.nonlinearity / cosine, all_points, shared=True)
    for name, values, sharing in _angles(chain, f):
        add(f"angle: {name}", "angle", values, sharing, shared=True)
    add("wavelength", "wavelength", _wavelength(chain, f), all_points, shared=True)
    # a lamp whose temperature drifts does so more in the blue (Wien's law); any other drift is grey
    colour = np.maximum(REFERENCE_WAVELENGTH / chain.wavelengths, 1.0)
    for name, u_lamp, members in _lamp(chain):
        add(f"drift: {name}", "drift", f * u_lamp * colour, members, shared=True)
    add("aperture", "aperture", _aperture(chain, f), all_points, shared=True)
    for name, values, members, shared in _stray_light(sums, chain, cosine):
        add(f"stray light: {name}", "stray light", values, members, shared=shared)
    add("footprint", "footprint", f * chain.u_share[:, None], all_points, shared=True)
    return tuple(found)


def _angles(chain: Chain, f: FloatArray) -> list[tuple[str, FloatArray, Groups | None]]:
    """What errors of the stages do.

    The detector stage sets theta_in + theta_out, so its error moves theta_out alone. An error e of the sample stage
    moves theta_in by e and theta_out by -e, which turns the half vector by -e: on a lobe that depends on the half
    vector f changes as for -2 e of theta_out. It changes the irradiance by -tan(theta_in) e, too; that of a zero
    cancels, because the panel had the same.
    """
    zero, position = chain.bench.u_zero, chain.bench.u_angle
    all_points = everywhere(chain.theta_in.size)
    irradiance = -np.tan(np.radians(chain.theta_in))[:, None] * np.radians(position) * f
    slope = chain.slopes.first
    return [
        ("sample zero", -2 * slope * zero, all_points),
        ("detector zero", slope * zero, all_points),
        ("sample stage", irradiance - 2 * slope * position, chain.visits),
        ("sample stage at the reference", -irradiance, chain.incidence),
        ("detector stage", slope * position, None),
    ]


def _wavelength(chain: Chain, f: FloatArray) -> FloatArray:
    """[points, wavelengths] what a shift of the wavelength scale does: the ratio of two spectra moves as a whole."""
    u = chain.bench.u_wavelength
    if "wavelength" not in chain.settings.corrections:
        u = float(np.hypot(u, chain.bench.wavelength_offset))
    return np.asarray(np.gradient(f, chain.wavelengths, axis=1) * u) if f.shape[1] > 1 else np.zeros_like(f)


def _lamp(chain: Chain) -> list[tuple[str, float, Groups]]:
    """Relative uncertainties of the lamp at 600 nm, and who shares them."""
    all_points = everywhere(chain.theta_in.size)
    if chain.drift is None or chain.between is None:
        # stated once for a scan and once for the time between the scans
        return [("not monitored", float(np.sqrt(2)) * chain.bench.u_lamp, all_points)]
    during_reference = 0.0 if chain.reference_drift is None else chain.reference_drift.u_interval
    return [
        ("between monitors", chain.drift.u_interval, chain.drift.interval),
        ("between scans", float(np.hypot(chain.between.u, during_reference)), all_points),
    ]


def _aperture(chain: Chain, f: FloatArray) -> FloatArray:
    """[points, wavelengths] from the size of the aperture, by the square of which the excess grows."""
    size = 2 * chain.bench.u_aperture / chain.bench.aperture
    if "aperture" not in chain.settings.corrections:
        return chain.excess * size
    # a correction that is no longer small is no correction
    large = np.divide(np.abs(chain.excess), np.abs(f), out=np.ones_like(f), where=f != 0)
    return np.asarray(chain.excess * np.hypot(size, np.maximum(PARABOLA, large)))


def _stray_light(sums: Sums, chain: Chain, cosine: FloatArray) -> list[tuple[str, FloatArray, Groups, bool]]:
    """Noise of the measured stray light, and what is left of it; the stated bound where none was measured."""
    all_points = everywhere(chain.theta_in.size)
    if not chain.stray_measured:
        # the same light s falls into the measurement of sample and panel: it adds s (1 - f / f_panel)
        change = chain.bench.u_stray_light * (1 - sums.ratio / (cosine * chain.panel))
        return [("not measured", change / cosine, all_points, True)]
    if "stray light" not in chain.settings.corrections:
        return [("not subtracted", sums.stray / cosine, all_points, True)]
    return [
        ("counts", sums.u_stray / cosine, chain.incidence, False),
        ("counts of the reference", sums.u_reference_stray / cosine, chain.incidence, False),
        ("the same in all directions", STRAY_UNIFORMITY * sums.stray / cosine, all_points, True),
    ]
