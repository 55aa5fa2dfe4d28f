"""From raw counts to a calibrated BRDF with its uncertainty, as a pure function that can be repeated at any time.

For each point and pixel the linear signal is

    s = (mean counts - mean dark) / polynomial(mean counts - mean dark) / integration time

with the dark of the same integration time. The reference scan gives the response of the instrument,
R = s_ref / (f_ref cos(theta_in)), interpolated linearly in theta_out between the reference points of the same
incident angle, and f = s / (R cos(theta_in)).

Pixels are binned by sums before the ratio is taken: f = sum(s) / (cos(theta_in) sum(R)). That weights each
pixel by the light it received, which is the best weighting under shot noise, and the ratio of two sums is
nearly free of the bias that a ratio of two noisy numbers has: the square of the relative noise of the denominator,
which at the dim ends of the spectrum is too high in a single pixel. What is left of it is taken off. The wavelength
of a bin is weighted by the light, too: where the lamp is steep it is not that of the middle pixel.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import BoolArray, CountArray, FloatArray
from goniometer.campaign import Campaign
from goniometer.dataset import Dataset
from goniometer.errors import CalibrationError
from goniometer.geometry import Geometry
from goniometer.instrument import Constants
from goniometer.reference import NOMINAL_SRS99, Certificate, parse_certificate, read_certificate, reference_brdf
from goniometer.store import Store, software_version

BANDS = ((430.0, 470.0), (530.0, 570.0), (630.0, 670.0), (780.0, 820.0))
"""Wavelength bands, nm, whose averages tell the plan where to measure."""

OUTERMOST = 0.1
"""Degrees that a sample's point may lie beyond the outermost reference point: the stages' error, not extrapolation."""


@dataclass(frozen=True)
class Settings:
    """What a calibration may choose."""

    bin_size: int = 6
    """Adjacent pixels that are binned into one wavelength."""
    lowest: float = 380.0
    """Shortest wavelength, nm; below, a halogen lamp gives too little light."""
    highest: float = 995.0
    """Longest wavelength, nm; the refractive index of aluminium is known up to 999.87 nm."""


@dataclass(frozen=True)
class RawScan:
    """All that was read from the devices in one scan; points that were not measured are absent."""

    scan_id: int
    sample: str
    constants: Constants
    planned: tuple[Geometry, ...]
    """[points] directions as planned; they tell which points share an incident angle."""
    read_back: tuple[Geometry, ...]
    """[points] directions as the stages read them back."""
    integration_times: FloatArray
    """[points] seconds."""
    counts: tuple[CountArray, ...]
    """[points] of [scans, pixels] light exposures."""
    darks: dict[float, CountArray]
    """By integration time: [read-outs, pixels] dark exposures."""
    exposure_ids: tuple[int, ...] = ()
    """Of the light exposures, in the database."""
    dark_ids: tuple[int, ...] = ()
    """Of the dark exposures, in the database."""


@dataclass(frozen=True)
class Signal:
    """Linear, dark-free signal of one scan."""

    rate: FloatArray
    """[points, pixels] counts per second."""
    variance: FloatArray
    """[points, pixels] variance of `rate` by shot and read-out noise of the point's own spectra."""
    dark_variance: FloatArray
    """[points, pixels] variance of `rate` by the noise of the mean dark, which all points of one time share."""
    saturated: BoolArray
    """[points, pixels] whether a scan was saturated there."""


@dataclass(frozen=True)
class Response:
    """Signal of the instrument per unit of cos(theta_in) times BRDF, at the reference points."""

    theta_in: FloatArray
    """[points] planned incident angle, degrees."""
    theta_out: FloatArray
    """[points] reflected angle as read back, degrees."""
    value: FloatArray
    """[points, pixels] counts per second and 1/sr."""
    variance: FloatArray
    """[points, pixels] variance of `value` by the point's own spectra."""
    dark_variance: FloatArray
    """[points, pixels] variance of `value` by the mean dark."""
    saturated: BoolArray
    """[points, pixels]"""


def signal(raw: RawScan) -> Signal:
    """Subtract darks, make linear, divide by time, average scans, and propagate the noise of the counts.

    Shot noise comes from the signal and the gain. The noise of a dark read-out (electronics and dark current)
    comes from the scatter of the repeated darks of that integration time, pooled over the pixels. Raises
    `CalibrationError` where fewer than two darks of an integration time exist.
    """
    constants = raw.constants
    dark_of: dict[float, tuple[FloatArray, float, int]] = {}
    for time, darks in raw.darks.items():
        if len(darks) < 2:
            raise CalibrationError(
                f"Scan {raw.scan_id} has only {len(darks)} dark spectrum of {time:g} s; two are needed for the noise"
            )
        dark_of[time] = darks.mean(axis=0), float(darks.var(axis=0, ddof=1).mean()), len(darks)
    rates, variances, dark_variances = [], [], []
    for counts, time in zip(raw.counts, raw.integration_times, strict=True):
        if float(time) not in dark_of:
            raise CalibrationError(
                f"Scan {raw.scan_id} has no dark spectrum of {time:g} s, so its points of that time have no zero"
            )
        dark, dark_variance, darks_taken = dark_of[float(time)]
        above = counts.mean(axis=0) - dark
        factor = np.polynomial.polynomial.polyval(above, constants.nonlinearity)
        linear = above / factor
        read_out = dark_variance / factor**2
        rates.append(linear / time)
        variances.append((np.maximum(linear, 0) / constants.gain + read_out) / len(counts) / time**2)
        dark_variances.append(read_out / darks_taken / time**2)
    saturated = [np.any(counts >= constants.saturation, axis=0) for counts in raw.counts]
    return Signal(np.array(rates), np.array(variances), np.array(dark_variances), np.array(saturated))


def response(reference: RawScan, certificate: Certificate, settings: Settings = Settings()) -> Response:
    """Response of the instrument from a scan of the reference panel; zero outside the usable wavelengths.

    Raises `CertificateError` where the certificate does not cover these, `CalibrationError` for missing darks.
    """
    measured = signal(reference)
    wavelengths = reference.constants.wavelengths
    used = (wavelengths >= settings.lowest) & (wavelengths <= settings.highest)
    theta_in = np.array([g.theta_in for g in reference.read_back])
    theta_out = np.array([g.theta_out for g in reference.read_back])
    panel = np.full(measured.rate.shape, np.inf)
    panel[:, used] = reference_brdf(theta_in, theta_out, wavelengths[used], certificate)
    panel *= np.cos(np.radians(theta_in))[:, None]
    return Response(
        np.array([g.theta_in for g in reference.planned]),
        theta_out,
        measured.rate / panel,
        measured.variance / panel**2,
        measured.dark_variance / panel**2,
        measured.saturated,
    )


def calibrate(
    sample: RawScan, reference: RawScan, certificate: Certificate, settings: Settings = Settings()
) -> Dataset:
    """The BRDF of a sample from its raw scan and that of the reference panel.

    Raises `CalibrationError` where the raw data do not suffice or do not belong together, `CertificateError`
    where the certificate does not cover the wavelengths.
    """
    if not np.array_equal(sample.constants.wavelengths, reference.constants.wavelengths):
        raise CalibrationError(
            f"Scans {sample.scan_id} and {reference.scan_id} were taken with different spectrometers; "
            f"calibrate with the reference scan of the same one"
        )
    wavelengths = sample.constants.wavelengths
    groups = _bins(wavelengths, settings)
    measured = signal(sample)
    known = response(reference, certificate, settings)
    ratio = _ratio(sample, measured, known, groups)
    cosine = np.cos(np.radians([g.theta_in for g in sample.read_back]))[:, None]
    light = known.value.mean(axis=0)[:, None] * groups
    centres = wavelengths @ light / light.sum(axis=0)
    return Dataset(
        sample=sample.sample,
        theta_in=np.array([g.theta_in for g in sample.read_back]),
        theta_out=np.array([g.theta_out for g in sample.read_back]),
        wavelengths=centres,
        brdf=np.where(ratio.saturated, np.nan, ratio.value / cosine),
        u_random=np.where(ratio.saturated, np.nan, ratio.u_random / cosine),
        u_dark=np.where(ratio.saturated, np.nan, ratio.u_dark / cosine),
        u_reference=np.where(ratio.saturated, np.nan, ratio.u_reference / cosine),
        u_reference_dark=np.where(ratio.saturated, np.nan, ratio.u_reference_dark / cosine),
        integration_time=sample.integration_times,
        u_angle=sample.constants.u_angle,
        aperture=sample.constants.aperture,
        saturated=np.asarray(measured.saturated.any(axis=1)),
        lineage={
            "scan": sample.scan_id,
            "exposures": list(sample.exposure_ids),
            "darks": list(sample.dark_ids),
            "reference_scan": reference.scan_id,
            "reference_exposures": list(reference.exposure_ids),
            "reference_darks": list(reference.dark_ids),
            "certificate": certificate.serial_number,
            "devices": {"spectrometer": sample.constants.spectrometer, **sample.constants.stages},
            "parameters": asdict(settings) | {"gain": sample.constants.gain},
            "software_version": software_version(),
        },
    )


def band_values(sample: RawScan, known: Response) -> tuple[FloatArray, FloatArray]:
    """cos(theta_in) f in `BANDS` and its random standard uncertainty, each [points, bands]: what the plan looks at.

    A saturated value stands as it was read: for the plan it is bright, and that is enough. NaN where the
    reference scan does not reach.
    """
    wavelengths = sample.constants.wavelengths
    groups = np.array([(wavelengths >= low) & (wavelengths <= high) for low, high in BANDS], dtype=float).T
    ratio = _ratio(sample, signal(sample), known, groups)
    return ratio.value, np.hypot(ratio.u_random, ratio.u_dark)


def _bins(wavelengths: FloatArray, settings: Settings) -> FloatArray:
    """[pixels, bins] membership of pixels in bins; pixels that do not fill the last bin are left out."""
    used = np.flatnonzero((wavelengths >= settings.lowest) & (wavelengths <= settings.highest))
    count = len(used) // settings.bin_size
    if count == 0:
        raise CalibrationError(
            f"The spectrometer has no {settings.bin_size} pixels between {settings.lowest:g} and "
            f"{settings.highest:g} nm; choose a range within {wavelengths.min():g} to {wavelengths.max():g} nm"
        )
    groups = np.zeros((len(wavelengths), count))
    groups[used[: count * settings.bin_size], np.repeat(np.arange(count), settings.bin_size)] = 1
    return groups


class _Ratio(NamedTuple):
    """cos(theta_in) f and its standard uncertainties by source, as in `Dataset`; all [points, groups], 1/sr."""

    value: FloatArray
    u_random: FloatArray
    u_dark: FloatArray
    u_reference: FloatArray
    u_reference_dark: FloatArray
    saturated: BoolArray


def _ratio(sample: RawScan, measured: Signal, known: Response, groups: FloatArray) -> _Ratio:
    """Sum of signals over sum of responses for groups of pixels [pixels, groups]."""
    weights = _weights(sample, known)
    divisor = weights @ (known.value @ groups)
    saturated = (measured.saturated @ groups > 0) | ((weights > 0) @ known.saturated @ groups > 0)
    if np.any(divisor <= 0):
        raise CalibrationError(
            f"The reference scan of scan {sample.scan_id} shows no light at some wavelengths; "
            f"check lamp and fibre and repeat it, or calibrate a narrower range"
        )
    noise = weights**2 @ (known.variance @ groups)
    # Reference points share their dark, so its error does not average out between them.
    dark_noise = (weights @ np.sqrt(known.dark_variance @ groups)) ** 2
    value = measured.rate @ groups / divisor * (1 - (noise + dark_noise) / divisor**2)
    relative = np.abs(value) / divisor
    return _Ratio(
        value,
        np.sqrt(measured.variance @ groups) / divisor,
        np.sqrt(measured.dark_variance @ groups) / divisor,
        relative * np.sqrt(noise),
        relative * np.sqrt(dark_noise),
        saturated,
    )


def _weights(sample: RawScan, known: Response) -> FloatArray:
    """[points, reference points] of the linear interpolation in theta_out within one incident angle.

    NaN for a point that lies more than `OUTERMOST` beyond the reference points: there the response is not known.
    """
    weights = np.zeros((len(sample.planned), len(known.theta_in)))
    for i, (planned, read_back) in enumerate(zip(sample.planned, sample.read_back, strict=True)):
        same = np.flatnonzero(np.abs(known.theta_in - planned.theta_in) < 1e-6)
        if len(same) == 0:
            raise CalibrationError(
                f"The reference scan has no point at theta_in = {planned.theta_in:g} deg, where sample "
                f'"{sample.sample}" was measured; scan the reference at this angle too'
            )
        same = same[np.argsort(known.theta_out[same])]
        angles = known.theta_out[same]
        if not angles[0] - OUTERMOST <= read_back.theta_out <= angles[-1] + OUTERMOST:
            weights[i] = np.nan
            continue
        # The ends of both scans are the same planned angles; their read-backs differ by the stages' error only.
        position = np.interp(read_back.theta_out, angles, np.arange(len(same)))
        left = min(int(position), max(len(same) - 2, 0))
        weights[i, same[left]] = 1 - (position - left)
        if left + 1 < len(same):
            weights[i, same[left + 1]] = position - left
    return weights


def read_raw(store: Store, scan_id: int) -> RawScan:
    """All measured points of a scan with their exposures and darks; raises `NotInStore` before it has begun."""
    points = [p for p in store.points(scan_id) if p.status == "done"]
    exposures = store.exposures(scan_id)
    light: dict[int, list[CountArray]] = {p.id: [] for p in points}
    times: dict[int, float] = {}
    darks: dict[float, list[CountArray]] = {}
    for exposure in exposures:
        if exposure.point_id is None:
            darks.setdefault(exposure.integration_time, []).append(exposure.counts)
        else:
            light[exposure.point_id].append(exposure.counts)
            times[exposure.point_id] = exposure.integration_time
    return RawScan(
        scan_id=scan_id,
        sample=store.scan(scan_id).sample,
        constants=store.constants(scan_id),
        planned=tuple(p.geometry for p in points),
        read_back=tuple(p.read_back for p in points if p.read_back is not None),
        integration_times=np.array([times[p.id] for p in points]),
        counts=tuple(np.stack(light[p.id]) for p in points),
        darks={time: np.stack(counts) for time, counts in darks.items()},
        exposure_ids=tuple(e.id for e in exposures if e.point_id is not None),
        dark_ids=tuple(e.id for e in exposures if e.point_id is None),
    )


def calibrate_scan(store: Store, scan_id: int, settings: Settings = Settings()) -> Dataset:
    """`calibrate` on a scan in the database, with the reference scan and the certificate of its campaign."""
    reference = store.reference_scan(scan_id)
    certificate = certificate_of(store, reference.campaign_id)
    return calibrate(read_raw(store, scan_id), read_raw(store, reference.id), certificate, settings)


def certificate_of(store: Store, campaign_id: int) -> Certificate:
    """The certificate that a campaign began with, or nominal values; raises `NotInStore`, `CertificateError`."""
    text = store.certificate(campaign_id)
    return NOMINAL_SRS99 if text is None else parse_certificate(text, f"certificate of campaign {campaign_id}")


def check_certificate(campaign: Campaign, settings: Settings = Settings()) -> None:
    """Raise `CertificateError` where the file that a campaign names is not one, or does not cover the wavelengths."""
    path = campaign.reference.certificate
    certificate = NOMINAL_SRS99 if path is None else parse_certificate(read_certificate(Path(path)), path)
    certificate.reflectance(np.array([settings.lowest, settings.highest]))
