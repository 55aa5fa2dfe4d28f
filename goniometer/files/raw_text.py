"""Raw text of a spectral goniometer as TH Köln has it, and the ratio to a reference that makes a BRDF of it.

A point is four lines: `incidence detector integration_time`, the counts, as many wavelengths in nm with decimal
commas, and a separator. Both angles are taken from the sample's normal, degrees, with the mirror direction where they
are equal. The unit of the integration time does not matter, as only ratios are taken.

f = f_panel (s / t) / (s_panel / t_panel) with s the counts less the dark counts of the same integration time. Incident
angle and lamp are the same for both, so the irradiance cancels. Between two directions of the reference its response
is interpolated linearly; beyond them there is no value, nor where a pixel is saturated or the reference shows no light.
"""

import math
import re
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import FloatArray
from goniometer.certificates.certificate import PanelCertificate
from goniometer.datasets.angular import SAME_INCIDENCE
from goniometer.errors import DataFileError
from goniometer.files.measured_table import MeasuredTable
from goniometer.uncertainty import ErrorSource, everywhere

LEAST_LIGHT = 3.0
"""Light from the reference, in standard uncertainties of the dark counts, below which a pixel tells nothing."""

OUTERMOST = 0.1
"""Degrees that a point may lie beyond the outermost direction of the reference."""


@dataclass(frozen=True)
class RawText:
    """Raw spectra of one file."""

    path: str
    theta_in: FloatArray
    """[points] signed, degrees."""
    theta_out: FloatArray
    """[points] signed, degrees."""
    integration_time: FloatArray
    """[points] in whatever unit the instrument writes."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    counts: FloatArray
    """[points, wavelengths]"""
    lines: tuple[int, ...]
    """[points] number of the line in which a point begins."""


def looks_like_raw_text(text: str) -> bool:
    """Whether a text begins as a point does: three numbers, then more than that."""
    lines = [line for line in text[:100_000].split("\n", 40) if re.search(r"\d", line)]
    return (
        len(lines) > 1 and not re.search(r"[A-Za-z]", lines[0]) and len(lines[0].split()) == 3 < len(lines[1].split())
    )


def read_raw_text(path: str, text: str) -> RawText:
    """The points of a file in its order; raises `DataFileError` with the number of the offending line."""
    filled = [(i, line) for i, line in enumerate(text.split("\n"), start=1) if re.search(r"\d", line)]
    if not filled or len(filled) % 3:
        raise DataFileError(
            f"{path}: has {len(filled)} lines of numbers, which is no multiple of three; every point has a line of "
            f"angles and integration time, one of counts and one of wavelengths."
        )
    heads, counts = np.empty((len(filled) // 3, 3)), []
    wavelengths = np.empty(0)
    for point in range(len(filled) // 3):
        head, light, scale = (_numbers(path, *filled[3 * point + i]) for i in range(3))
        line = filled[3 * point][0]
        if head.size != 3:
            raise DataFileError(f"{path}, line {line}: must be incidence, detector angle and integration time.")
        if not head[2] > 0:
            raise DataFileError(f"{path}, line {line}: the integration time {head[2]:g} must be above 0.")
        if scale.size != light.size:
            raise DataFileError(
                f"{path}, line {line}: has {light.size} counts and {scale.size} wavelengths; there must be as many."
            )
        if point == 0:
            wavelengths = scale
        elif not np.array_equal(scale, wavelengths):
            raise DataFileError(f"{path}, line {line}: has other wavelengths than the first point; they must agree.")
        heads[point] = head
        counts.append(light)
    lines = tuple(i for i, _ in filled[::3])
    return RawText(path, heads[:, 0], heads[:, 1], heads[:, 2], wavelengths, np.array(counts), lines)


def within(raw: RawText, lowest: float, highest: float) -> RawText:
    """The pixels from `lowest` to `highest` nm; raises `DataFileError` where there are none."""
    inside = (raw.wavelengths >= lowest) & (raw.wavelengths <= highest)
    if not inside.any():
        raise DataFileError(f"{raw.path}: has no wavelength from {lowest:g} to {highest:g} nm; widen the range.")
    return replace(raw, wavelengths=raw.wavelengths[inside], counts=raw.counts[:, inside])


def _numbers(path: str, number: int, line: str) -> FloatArray:
    try:
        values = np.array(line.replace(",", ".").split(), dtype=float)
    except ValueError as error:
        raise DataFileError(f"{path}, line {number}: holds something that is no number; it must not.") from error
    if not np.isfinite(values).all():
        raise DataFileError(f"{path}, line {number}: holds a number that is not finite; it must not.")
    return values


def ratio_to_reference(
    sample: RawText, reference: RawText, panel: PanelCertificate, darks: RawText | None, saturation: float
) -> tuple[MeasuredTable, list[str]]:
    """BRDF of `sample` from the same instrument's `reference` scan of the panel that `panel` certifies.

    With it come the errors of darks and panel, and sentences that say what has no value.

    `darks` are spectra without light, two at least of every integration time that occurs; None where the instrument
    has subtracted them. Pixels of `saturation` counts or more have no value. Raises `DataFileError` where the files do
    not belong together, `CertificateError` where the certificate does not cover the wavelengths.
    """
    for other in (reference, *([] if darks is None else [darks])):
        if not np.array_equal(other.wavelengths, sample.wavelengths):
            raise DataFileError(f"{other.path}: has other wavelengths than {sample.path}; they must agree.")
    mine, u_mine = _rates(sample, darks, saturation)
    known, u_known = _rates(reference, darks, saturation)
    with np.errstate(invalid="ignore"):
        known[~(known > LEAST_LIGHT * u_known)] = np.nan
    weights = _weights(sample, reference)
    # the panel's formula holds for incidence from one side; a plane turned by half a turn is the same plane
    side = np.where(reference.theta_in < 0, -1.0, 1.0)
    at_in, at_out = side * reference.theta_in, side * reference.theta_out
    certified = panel.brdf(at_in, at_out, sample.wavelengths)
    some = weights.any(axis=1)
    response, sent = weights @ np.nan_to_num(known / certified), weights @ certified
    response[(weights > 0) @ np.isnan(known) > 0] = np.nan
    response[~some] = np.nan
    brdf = mine / response
    all_points = everywhere(some.size)
    errors = [
        ErrorSource(
            f"reference: {name}",
            "reference",
            np.nan_to_num(brdf * (weights @ (certified * relative)) / np.where(sent > 0, sent, 1.0)),
            all_points,
            shared_by_wavelengths=True,
        )
        for name, relative in panel.errors(at_in, at_out, sample.wavelengths).items()
    ]
    if darks is not None:
        change = np.nan_to_num((u_mine - brdf * (weights @ (u_known / certified))) / response)
        errors.append(ErrorSource("dark", "dark", change, all_points, shared_by_wavelengths=False))
    places = tuple(f"line {line}" for line in sample.lines)
    notes = []
    if beyond := int(np.sum(~some)):
        notes.append(f"{beyond} of {some.size} points lie where the reference was not measured and have no value.")
    if bright := int(np.sum(sample.counts >= saturation)):
        notes.append(f"{bright} saturated pixels of the sample have no value.")
    theta_in, theta_out = sample.theta_in, sample.theta_out
    return MeasuredTable(theta_in, theta_out, sample.wavelengths, brdf, None, places, tuple(errors)), notes


def _rates(raw: RawText, darks: RawText | None, saturation: float) -> tuple[FloatArray, FloatArray]:
    """[points, wavelengths] counts less dark ones, per unit of time, NaN where saturated; and the noise of these."""
    dark, u = np.zeros_like(raw.counts), np.zeros_like(raw.counts)
    for time in np.unique(raw.integration_time) if darks is not None else ():
        assert darks is not None  # for the type checker
        alike = darks.counts[darks.integration_time == time]
        if len(alike) < 2:
            raise DataFileError(
                f"{darks.path}: has {len(alike)} dark spectra of the integration time {time:g} that occurs in "
                f"{raw.path}; two are needed for their noise."
            )
        mine = raw.integration_time == time
        dark[mine] = alike.mean(axis=0)
        # pooled over the pixels: two spectra alone tell little of one of them
        u[mine] = math.sqrt(float(alike.var(axis=0, ddof=1).mean()) / len(alike))
    counts = np.where(raw.counts >= saturation, np.nan, raw.counts)
    return (counts - dark) / raw.integration_time[:, None], u / raw.integration_time[:, None]


def _weights(sample: RawText, reference: RawText) -> FloatArray:
    """[points, reference points] weights of the interpolation in theta_out; all zero where it does not reach."""
    weights = np.zeros((sample.theta_in.size, reference.theta_in.size))
    for i, (theta_in, theta_out) in enumerate(zip(sample.theta_in, sample.theta_out, strict=True)):
        same = np.flatnonzero(np.abs(reference.theta_in - theta_in) <= SAME_INCIDENCE)
        same = same[np.argsort(reference.theta_out[same], kind="stable")]
        angles = reference.theta_out[same]
        if same.size == 0 or not angles[0] - OUTERMOST <= theta_out <= angles[-1] + OUTERMOST:
            continue
        position = np.interp(theta_out, angles, np.arange(same.size))
        left = min(int(position), max(same.size - 2, 0))
        weights[i, same[left]] = 1 - (position - left)
        if left + 1 < same.size:
            weights[i, same[left + 1]] += position - left
    return weights
