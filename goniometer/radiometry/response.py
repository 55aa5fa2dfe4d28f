"""The response of the instrument, from a scan of the reference panel, and how a sample's points find it.

At a reference point R = s / (f_panel cos(theta_in)): counts per second for each unit of cos(theta_in) times BRDF, with
the lamp as it was at the first monitor of the reference scan and a footprint that lies on the panel as a whole.
"""

import datetime
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.errors import CalibrationError
from goniometer.radiometry.drift import LampDrift, factor, lamp_drift
from goniometer.radiometry.footprint import share_on_sample
from goniometer.radiometry.raw import RawScan
from goniometer.radiometry.signal import Signal, signal

CORRECTIONS = ("dark", "non-linearity", "stray light", "drift", "wavelength", "footprint", "aperture")
"""Everything that can be corrected for."""

DEFAULT_CORRECTIONS = frozenset(CORRECTIONS) - {"aperture"}
"""Not that for the aperture: fits look through it, and the narrow lobe of a mirror cannot be corrected."""

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
    corrections: frozenset[str] = DEFAULT_CORRECTIONS
    """Which of `CORRECTIONS` are made."""


STANDARD = Settings()
"""What is done unless somebody asks for something else."""


class Panel(Protocol):
    """What calibration asks of a certificate; see `goniometer.certificates.certificate`."""

    @property
    def serial_number(self) -> str:
        """Names the certificate in everything derived from it."""

    @property
    def calibrated(self) -> datetime.date | None:
        """Day of calibration; None for nominal values."""

    @property
    def valid_until(self) -> datetime.date | None:
        """Last day of validity; None for nominal values."""

    def brdf(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
        """[points, wavelengths] 1/sr."""

    def errors(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> dict[str, FloatArray]:
        """Relative changes [points, wavelengths] for one standard uncertainty of each source, by its name."""


@dataclass(frozen=True)
class Response:
    """Signal of the instrument per unit of cos(theta_in) times BRDF, at the reference points."""

    theta_in: FloatArray
    """[points] planned incident angle, degrees."""
    theta_out: FloatArray
    """[points] reflected angle as read back, degrees."""
    read_theta_in: FloatArray
    """[points] incident angle as read back, degrees."""
    signal: Signal
    """The signal of the panel divided by what the panel sends: counts per second and 1/sr, zero where not usable."""
    drift: LampDrift | None
    """Of the lamp during the reference scan."""


def wavelengths_of(raw: RawScan, settings: Settings) -> FloatArray:
    """[pixels] wavelengths, nm, with the offset of the bench where that is corrected."""
    offset = raw.constants.bench.wavelength_offset if "wavelength" in settings.corrections else 0.0
    return raw.constants.wavelengths + offset


def divided(measured: Signal, by: FloatArray) -> Signal:
    """A signal with everything in it divided by `by` [points, pixels]."""
    return Signal(
        rate=measured.rate / by,
        variance=measured.variance / by**2,
        dark=tuple((name, u / by) for name, u in measured.dark),
        dark_left=measured.dark_left / by,
        dark_warming=measured.dark_warming / by,
        stray=measured.stray / by,
        u_stray=measured.u_stray / by,
        nonlinearity=measured.nonlinearity / by,
        saturated=measured.saturated,
    )


def shares(raw: RawScan, settings: Settings) -> tuple[FloatArray, FloatArray]:
    """[points] share of the footprint on the sample, and its relative change for one standard uncertainty.

    1 where it is not corrected for; what that neglects then is the change.
    """
    bench = raw.constants.bench
    theta_out = np.array([g.theta_out for g in raw.read_back])
    share = share_on_sample(theta_out, bench.field_of_view, raw.diameter)
    if "footprint" not in settings.corrections:
        return np.ones_like(share), share - 1
    wider = share_on_sample(theta_out, bench.field_of_view + bench.u_field_of_view, raw.diameter)
    return share, wider / share - 1


def response(reference: RawScan, panel: Panel, settings: Settings = STANDARD) -> Response:
    """Response of the instrument from a scan of the reference panel; zero outside the usable wavelengths.

    Raises `CertificateError` where the certificate does not cover these, `CalibrationError` for missing darks.
    """
    wavelengths = wavelengths_of(reference, settings)
    used = (wavelengths >= settings.lowest) & (wavelengths <= settings.highest)
    theta_in = np.array([g.theta_in for g in reference.read_back])
    theta_out = np.array([g.theta_out for g in reference.read_back])
    sent = np.full((theta_in.size, wavelengths.size), np.inf)
    # A stage that stands at -0.004 degrees must not exchange forward and back, where the panel's formula jumps.
    sent[:, used] = panel.brdf(np.abs(theta_in), theta_out, wavelengths[used])
    sent *= (np.cos(np.radians(theta_in)) * shares(reference, settings)[0])[:, None]
    drift = lamp_drift(reference) if "drift" in settings.corrections else None
    if drift is not None:
        sent *= factor(drift.level, drift.tilt, wavelengths)
    measured = signal(reference, settings.corrections)
    planned = np.array([g.theta_in for g in reference.planned])
    return Response(planned, theta_out, theta_in, divided(measured, sent), drift)


def reference_weights(sample: RawScan, known: Response) -> tuple[FloatArray, BoolArray]:
    """[points, reference points] weights of the linear interpolation in theta_out within one incident angle.

    Also [points] whether a point lies within `OUTERMOST` of the reference points; elsewhere the response is not known
    and the weights are those of the nearest one. Raises `CalibrationError` for an incident angle that the reference
    scan lacks.
    """
    weights = np.zeros((len(sample.planned), len(known.theta_in)))
    reached = np.ones(len(sample.planned), dtype=bool)
    for i, (planned, read_back) in enumerate(zip(sample.planned, sample.read_back, strict=True)):
        same = np.flatnonzero(np.abs(known.theta_in - planned.theta_in) < 1e-6)
        if len(same) == 0:
            raise CalibrationError(
                f"The reference scan has no point at theta_in = {planned.theta_in:g} deg, where sample "
                f'"{sample.sample}" was measured; scan the reference at this angle too'
            )
        same = same[np.argsort(known.theta_out[same])]
        angles = known.theta_out[same]
        reached[i] = angles[0] - OUTERMOST <= read_back.theta_out <= angles[-1] + OUTERMOST
        # The ends of both scans are the same planned angles; their read-backs differ by the stages' error only.
        position = np.interp(read_back.theta_out, angles, np.arange(len(same)))
        left = min(int(position), max(len(same) - 2, 0))
        weights[i, same[left]] = 1 - (position - left)
        if left + 1 < len(same):
            weights[i, same[left + 1]] = position - left
    return weights, reached
