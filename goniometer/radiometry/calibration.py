"""From raw counts to a calibrated BRDF with its uncertainty, as a pure function that can be repeated at any time.

f = s / (R cos(theta_in)), with s the linear signal of the sample (`goniometer.radiometry.signal`) brought to the same
lamp and to a full footprint, and R the response of the instrument (`goniometer.radiometry.response`).

Pixels are binned by sums before the ratio is taken: f = sum(s) / (cos(theta_in) sum(R)). That weights each
pixel by the light it received, which is the best weighting under shot noise, and the ratio of two sums is
nearly free of the bias that a ratio of two noisy numbers has: the square of the relative noise of the denominator,
which at the dim ends of the spectrum is too high in a single pixel. What is left of it is taken off. The wavelength
of a bin is weighted by the light, too: where the lamp is steep it is not that of the middle pixel.

What makes the result uncertain is put together in `goniometer.radiometry.sources`.
"""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.campaigns.material_file import MaterialFile, material_file
from goniometer.certificates.certificate import NOMINAL_SRS99, Override, PanelCertificate, check_validity
from goniometer.certificates.certificate_file import parse_certificate
from goniometer.datasets.angular import along_theta_out, aperture_excess, incidence_groups
from goniometer.datasets.checks import checks, noise_flags
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.errors import CalibrationError
from goniometer.radiometry.drift import LampBetween, LampDrift, factor, lamp_between, lamp_drift
from goniometer.radiometry.footprint import CLIPPED_BELOW, share_on_sample
from goniometer.radiometry.raw import RawScan, read_raw, sample_visits
from goniometer.radiometry.response import (
    STANDARD,
    Panel,
    Response,
    Settings,
    divided,
    reference_weights,
    response,
    shares,
    wavelengths_of,
)
from goniometer.radiometry.signal import Signal, signal
from goniometer.radiometry.sources import Chain, Sums, error_sources
from goniometer.storage.derived import software_version
from goniometer.storage.store import Store

BANDS = ((430.0, 470.0), (530.0, 570.0), (630.0, 670.0), (780.0, 820.0))
"""Wavelength bands, nm, whose averages tell the plan where to measure."""

Total = Callable[[FloatArray], FloatArray]
"""Sums [..., pixels] into [..., wavelengths]."""


def calibrate(
    sample: RawScan,
    reference: RawScan,
    panel: Panel,
    settings: Settings = STANDARD,
    scans_between: Sequence[RawScan] = (),
) -> Dataset:
    """The BRDF of a sample from its raw scan and that of the reference panel.

    `scans_between` were made after the reference scan and before that of the sample; their monitors tell how the lamp
    changed meanwhile. Raises `CalibrationError` where the raw data do not suffice or do not belong together,
    `CertificateError` where the certificate does not cover the wavelengths.
    """
    if not np.array_equal(sample.constants.wavelengths, reference.constants.wavelengths):
        raise CalibrationError(
            f"Scans {sample.scan_id} and {reference.scan_id} were taken with different spectrometers; "
            f"calibrate with the reference scan of the same one"
        )
    known = response(reference, panel, settings)
    wavelengths = wavelengths_of(sample, settings)
    total, used = _binning(wavelengths, settings)
    drift = lamp_drift(sample) if "drift" in settings.corrections else None
    between = lamp_between([reference, *scans_between, sample]) if drift is not None else None
    share, u_share = shares(sample, settings)
    weights, reached = reference_weights(sample, known)
    measured = divided(
        signal(sample, settings.corrections), share[:, None] * _lamp(drift, between, len(share), wavelengths)
    )
    sums = _sums(measured, known, weights, total, sample.scan_id)
    light = np.where(used, known.signal.rate.mean(axis=0), 0.0)
    centres = total(light * wavelengths) / total(light)
    theta_in = np.array([g.theta_in for g in sample.read_back])
    theta_out = np.array([g.theta_out for g in sample.read_back])
    valid = ~sums.saturated & reached[:, None]
    brdf = np.where(valid, sums.ratio / np.cos(np.radians(theta_in))[:, None], np.nan)

    planned_in = np.array([g.theta_in for g in sample.planned])
    incidence = incidence_groups(planned_in, 1e-6)
    noise = np.where(valid, sums.u_noise / np.cos(np.radians(theta_in))[:, None], 0.0)
    slopes = along_theta_out(np.array([g.theta_out for g in sample.planned]), incidence, brdf, noise)
    bench = sample.constants.bench
    excess = aperture_excess(theta_in, theta_out, slopes, bench.aperture)
    if "aperture" in settings.corrections:
        brdf = brdf - excess
    chain = Chain(
        bench=bench,
        settings=settings,
        theta_in=theta_in,
        incidence=incidence,
        wavelengths=centres,
        brdf=brdf,
        slopes=slopes,
        excess=excess,
        panel_errors=panel.errors(np.abs(known.read_theta_in), known.theta_out, centres),
        stray_measured=bool(sample.stray) and bool(reference.stray),
        drift=drift,
        reference_drift=known.drift,
        between=between,
        panel=weights @ panel.brdf(np.abs(known.read_theta_in), known.theta_out, centres),
        visits=sample_visits(sample),
        # the same field of view looks at sample and panel
        u_share=u_share - weights @ shares(reference, settings)[1],
    )
    flags = noise_flags(brdf, noise)
    flags[sums.saturated.any(axis=1)] |= np.uint16(Flag.SATURATED)
    flags[~reached] |= np.uint16(Flag.BEYOND_REFERENCE)
    flags[share_on_sample(theta_out, bench.field_of_view, sample.diameter) < CLIPPED_BELOW] |= np.uint16(Flag.CLIPPED)
    return Dataset(
        sample=sample.sample,
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=centres,
        brdf=brdf,
        sources=error_sources(sums, chain),
        flags=flags,
        u_angle=bench.u_angle,
        u_zero=bench.u_zero,
        aperture=0.0 if "aperture" in settings.corrections else bench.aperture,
        lineage=_lineage(sample, reference, panel, settings, scans_between, watched=between is not None),
    )


def _lineage(
    sample: RawScan,
    reference: RawScan,
    panel: Panel,
    settings: Settings,
    scans_between: Sequence[RawScan],
    *,
    watched: bool,
) -> dict[str, object]:
    """What a dataset was made from; `watched` says whether monitors tell of the lamp all the way."""

    def exposures(raw: RawScan) -> dict[str, list[int]]:
        return {
            "exposures": [i for shot in raw.shots for i in shot.ids],
            "darks": [i for dark in raw.darks for i in dark.ids],
            "stray": [i for shot in raw.stray for i in shot.ids],
            "monitors": [i for shot in raw.monitors for i in shot.ids],
        }

    made = {
        "dark": True,
        "non-linearity": True,
        "stray light": bool(sample.stray) and bool(reference.stray),
        "drift": watched,
        "wavelength": True,
        "footprint": True,
        "aperture": True,
    }
    corrections = {
        name: "not made" if name not in settings.corrections else "made" if possible else "not measured"
        for name, possible in made.items()
    }
    return {
        "scan": sample.scan_id,
        **exposures(sample),
        "reference_scan": reference.scan_id,
        **{f"reference_{name}": ids for name, ids in exposures(reference).items()},
        "scans_between": [raw.scan_id for raw in scans_between],
        "certificate": panel.serial_number,
        "certificate_calibrated": None if panel.calibrated is None else panel.calibrated.isoformat(),
        "certificate_valid_until": None if panel.valid_until is None else panel.valid_until.isoformat(),
        "devices": {"spectrometer": sample.constants.spectrometer, **sample.constants.stages},
        "corrections": corrections,
        "parameters": {
            "bin_size": settings.bin_size,
            "lowest": settings.lowest,
            "highest": settings.highest,
            **vars(sample.constants.bench),
        },
        "software_version": software_version(),
    }


def _lamp(drift: LampDrift | None, between: LampBetween | None, points: int, wavelengths: FloatArray) -> FloatArray:
    """[points, pixels] output of the lamp relative to that at the first monitor of the reference scan."""
    if drift is None or between is None:
        return np.ones((points, wavelengths.size))
    here = factor(drift.level, drift.tilt, wavelengths)
    return np.asarray(here * factor(np.array([between.level]), np.array([between.tilt]), wavelengths))


def band_values(sample: RawScan, known: Response) -> tuple[FloatArray, FloatArray]:
    """cos(theta_in) f in `BANDS` and its random standard uncertainty, each [points, bands]: what the plan looks at.

    A saturated value stands as it was read: for the plan it is bright, and that is enough. NaN where the
    reference scan does not reach. Raises `CalibrationError` as `signal` and `reference_weights` do, and where the
    reference scan shows no light.
    """
    wavelengths = sample.constants.wavelengths
    members = np.array([(wavelengths >= low) & (wavelengths <= high) for low, high in BANDS], dtype=float).T
    weights, reached = reference_weights(sample, known)
    measured = signal(sample, STANDARD.corrections)
    sums = _sums(measured, known, weights, lambda values: np.asarray(values @ members), sample.scan_id)
    return np.where(reached[:, None], sums.ratio, np.nan), np.where(reached[:, None], sums.u_noise, np.nan)


def _binning(wavelengths: FloatArray, settings: Settings) -> tuple[Total, BoolArray]:
    """What sums pixels into bins, and [pixels] which pixels are binned; those that do not fill the last are not."""
    inside = np.flatnonzero((wavelengths >= settings.lowest) & (wavelengths <= settings.highest))
    size = settings.bin_size
    count = len(inside) // size
    if count == 0:
        raise CalibrationError(
            f"The spectrometer has no {size} pixels between {settings.lowest:g} and "
            f"{settings.highest:g} nm; choose a range within {wavelengths.min():g} to {wavelengths.max():g} nm"
        )
    part = slice(inside[0], inside[0] + count * size)
    used = np.zeros(len(wavelengths), dtype=bool)
    used[part] = True

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(values[..., part].reshape(*values.shape[:-1], count, size).sum(axis=-1))

    return total, used


def _sums(measured: Signal, known: Response, weights: FloatArray, total: Total, scan_id: int) -> Sums:
    """Sum of signals over sum of responses, with what their errors do to the ratio."""
    of_panel = known.signal
    panel = total(of_panel.rate)
    divisor = weights @ panel
    if np.any(divisor <= 0):
        raise CalibrationError(
            f"The reference scan of scan {scan_id} shows no light at some wavelengths; "
            f"check lamp, fibre and panel, and measure again as a campaign of another name, with a longer "
            f"integration.maximum or more reference.scans where the panel is only dim"
        )
    counts = weights**2 @ total(of_panel.variance)
    # Reference points share their darks, so the error of a dark does not average out between them.
    darks = sum(((weights @ np.sqrt(total(u**2))) ** 2 for _, u in of_panel.dark), np.zeros_like(divisor))
    stray = (weights @ total(of_panel.u_stray)) ** 2
    ratio = total(measured.rate) / divisor * (1 - (counts + darks) / divisor**2)
    own = total(measured.variance)
    own_darks = tuple((name, np.sqrt(total(u**2)) / divisor) for name, u in measured.dark)
    noise = own / divisor**2 + sum((u**2 for _, u in own_darks), np.zeros_like(divisor))

    def change(of_sample: FloatArray, of_reference: FloatArray) -> FloatArray:
        """What one error that sample and reference have does to the ratio."""
        return np.asarray((total(of_sample) - ratio * (weights @ total(of_reference))) / divisor)

    return Sums(
        ratio=ratio,
        u_random=np.sqrt(own) / divisor,
        u_dark=own_darks,
        dark_left=change(measured.dark_left, of_panel.dark_left),
        dark_warming=change(measured.dark_warming, of_panel.dark_warming),
        u_stray=total(measured.u_stray) / divisor,
        stray=change(measured.stray, of_panel.stray),
        u_reference_counts=np.abs(ratio) * np.sqrt(counts) / divisor,
        u_reference_dark=np.abs(ratio) * np.sqrt(darks) / divisor,
        u_reference_stray=np.abs(ratio) * np.sqrt(stray) / divisor,
        nonlinearity=change(measured.nonlinearity, of_panel.nonlinearity),
        u_noise=np.sqrt(noise),
        saturated=(total(measured.saturated.astype(float)) > 0)
        | ((weights > 0) @ total(of_panel.saturated.astype(float)) > 0),
        weights=weights,
        panel=panel,
        response=divisor,
    )


_BESIDE = 5.0
"""Nanometres beyond a table that lies on the simulated bench: a bin's width, so that its bins cover the whole table."""


def calibrate_scan(
    store: Store,
    scan_id: int,
    settings: Settings = STANDARD,
    certificate: PanelCertificate | None = None,
    override: Override | None = None,
) -> Dataset:
    """`calibrate` on a scan in the database, with the reference scan that serves it, and the sanity checks.

    `certificate` and `override` replace those of the campaign. Raises `CertificateError` where the certificate is
    missing or was not valid on the day of the reference scan and nobody overrides that, `NotInStore`, and what
    `calibrate` raises. What lies on a simulated bench as a table is calibrated at the wavelengths of the table only.
    """
    scans = store.scans(store.scan(scan_id).campaign_id)
    reference_scan = store.reference_scan(scan_id)
    reference = read_raw(store, reference_scan.id)
    sample = read_raw(store, scan_id)
    campaign_id = store.scan(scan_id).campaign_id
    if certificate is None:
        certificate = certificate_of(store, campaign_id)
        stated = store.campaign(campaign_id).reference.override
        override = override or (None if stated is None else Override(stated.name, stated.reason))
    overridden = check_validity(certificate, reference.day, override)
    number = next(scan.number for scan in scans if scan.id == scan_id)
    watched = len(sample.monitors) > 1
    since = scans[reference_scan.number + 1 : number]
    between = [read_raw(store, s.id) for s in since if watched and s.outcome == "completed"]
    material = material_file(store.scan(scan_id).material)
    settings = within_table(material, settings)
    dataset = calibrate(sample, reference, certificate, settings, between)
    spot = None
    after = scans[number + 1] if number + 1 < len(scans) else None
    if after is not None and after.kind == "spot" and after.outcome == "completed":
        spot = calibrate(read_raw(store, after.id), reference, certificate, settings, [*between, sample])
    drift = lamp_drift(sample)
    corrections = dataset.lineage["corrections"]
    assert isinstance(corrections, dict)  # by name, see above
    made = corrections["drift"] == "made"
    found = checks(dataset, spot=spot, drift=None if drift is None else drift.largest, drift_corrected=made)
    lineage = dataset.lineage | {
        "certificate_override": overridden,
        "spot_scan": None if spot is None or after is None else after.id,
    }
    if material is not None and material.content is not None:
        lineage |= {"material": material.path.name, "material_sha256": material.content.sha256}
    return replace(dataset, checks=found, lineage=lineage)


def within_table(material: MaterialFile | None, settings: Settings) -> Settings:
    """Settings for what lies on a simulated bench: beyond the wavelengths of a table it is invented."""
    if material is None or material.content is None:
        return settings
    return replace(
        settings,
        lowest=max(settings.lowest, material.content.lowest - _BESIDE),
        highest=min(settings.highest, material.content.highest + _BESIDE),
    )


def certificate_of(store: Store, campaign_id: int) -> PanelCertificate:
    """The certificate that a campaign began with, or nominal values; raises `NotInStore`, `CertificateError`."""
    text = store.certificate(campaign_id)
    return NOMINAL_SRS99 if text is None else parse_certificate(text, f"certificate of campaign {campaign_id}")


def check_certificate(text: str | None, path: str, override: Override | None, day: datetime.date) -> None:
    """Raise `CertificateError` where a certificate cannot serve a reference scan that is made on `day`.

    `text` is that of the file `path`, None where there is none.
    """
    certificate = NOMINAL_SRS99 if text is None else parse_certificate(text, path)
    certificate.check_covers(STANDARD.lowest, STANDARD.highest)
    check_validity(certificate, day, override)
