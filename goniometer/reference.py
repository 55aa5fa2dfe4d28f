"""The white reference: a Spectralon panel, its certificate, and why it is not Lambertian.

A certificate gives one number per wavelength, the reflectance rho for light from 8 degrees into the whole
hemisphere. How this light is spread over directions is a five-term model of sintered PTFE panels (IEEE
TGRS 2024, DOI 10.1109/TGRS.2024.3361392): a fall-off towards grazing view, diffuse forward scattering,
subsurface scattering, a specular and a back-scattered lobe. We divide the model by its own cosine-weighted
integral over the hemisphere, so that for every incident angle the panel returns exactly the certified share
of the light; the published normalisation table does not.

Zenith angles enter in radians; phi is the azimuth between incident and reflected direction, 0 = back to the
source, pi = forward, so in plane `theta_out` > 0 means phi = pi.
"""

import datetime
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.errors import CertificateError, GeometryError

# The published coefficients c0 ... c26, in the paper's order and grouped as the terms below use them.
_SUBSURFACE = (0.5696875917173422, 0.27903122059147045, -1.7476750611608318, 2.5855843488200034)
_SUBSURFACE_POWERS = (8.263416395698357, 1.6450590437852088)
_FALL_OFF = (1.851701611373643, 0.09100373143807905)
_FORWARD = (0.5718024986324589, 0.009912786942804066, 0.04026383165673021, 1.1856631736844976)
_FORWARD_POWERS = (1.4094448692363608, 3.753748299350997)
_BACK = (0.26592501709914296, 0.25982186894746806, 4.719404248241861)
_BACK_WIDTHS = (0.8025276470171108, 0.29606885318487797)
_SPECULAR = (0.4965306551513434, 0.0, 5.866204408080527)
_SPECULAR_WIDTHS = (1.212578167338859, 0.4107185337489295)
_REDDENING = (0.02091690159556928, 0.9782260653794538, 2.944780616597054)

_BACK_CUT = (math.radians(10) / _BACK_WIDTHS[0]) ** 2 + (math.radians(5) / _BACK_WIDTHS[1]) ** 2
"""Exponent inside which the back-scattered lobe was never measured (10 degrees across, 5 along) and is cut flat."""

_SUBSURFACE_ENDS = -_SUBSURFACE[3] / _SUBSURFACE[2]
"""Zenith angle, radians, at which the azimuthal width d(t) reaches zero: H is continuous there, but not smooth."""

_QUADRATURE_NODES = 64
"""Gauss nodes in azimuth and in each part of the zenith angles; twice as many change no BRF by 1e-6."""

U_DIRECTIONAL = 0.009
"""Relative standard uncertainty of the spread over directions up to 70 degrees from the normal."""

U_DIRECTIONAL_GRAZING = 0.05
"""The same at 85 degrees."""


def _pos(x: FloatArray) -> FloatArray:
    """The paper's pos(): a floor under bases of powers that could become negative near grazing."""
    return np.asarray(np.maximum(x, 1e-8))


def _subsurface(t: FloatArray, forward2: FloatArray) -> FloatArray:
    """H(t): one direction's share of the subsurface term; `forward2` is (phi - pi)^2."""
    amplitude = _pos(_SUBSURFACE[0] * t + _SUBSURFACE[1]) ** _SUBSURFACE_POWERS[0]
    d = _pos(_SUBSURFACE[2] * t + _SUBSURFACE[3]) ** _SUBSURFACE_POWERS[1]
    return np.asarray(amplitude * (1 + forward2 / d) ** (-(d + 1) / 2))


def _diffuse_forward(t: FloatArray, forward2: FloatArray) -> FloatArray:
    """G(t): one direction's share of the diffuse forward term; `forward2` is (phi - pi)^2."""
    amplitude = _pos(_FORWARD[0] * t + _FORWARD[1]) ** _FORWARD_POWERS[0]
    width = _pos(_FORWARD[2] * t + _FORWARD[3]) ** _FORWARD_POWERS[1]
    return np.asarray(amplitude * np.exp(-forward2 / width**2))


def _terms(azimuth: FloatArray, theta_v: FloatArray, theta_i: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The part of K that reddens and the part that does not; all angles in radians, azimuth in [0, 2 pi)."""
    forward2 = (azimuth - np.pi) ** 2
    back2 = np.minimum(azimuth, 2 * np.pi - azimuth) ** 2
    apart2 = (theta_v - theta_i) ** 2
    specular = _pos(_SPECULAR[0] * theta_i + _SPECULAR[1]) ** _SPECULAR[2] * np.exp(
        -forward2 / _SPECULAR_WIDTHS[0] ** 2 - apart2 / _SPECULAR_WIDTHS[1] ** 2
    )
    reddening = (
        _diffuse_forward(theta_v, forward2) * _diffuse_forward(theta_i, forward2)
        + _subsurface(theta_v, forward2) * _subsurface(theta_i, forward2)
        + specular
    )
    back = (_BACK[0] * theta_i + _BACK[1]) ** _BACK[2] * np.exp(
        -np.maximum(back2 / _BACK_WIDTHS[0] ** 2 + apart2 / _BACK_WIDTHS[1] ** 2, _BACK_CUT)
    )
    neutral = 1 - _FALL_OFF[1] * theta_v ** _FALL_OFF[0] + back
    return np.asarray(reddening), np.asarray(neutral)


@lru_cache(maxsize=4096)
def _hemisphere(theta_i: float) -> tuple[float, float]:
    """(1/pi) integral of both parts of K times cos(theta_v) over the hemisphere; `theta_i` in radians.

    The wavelength is no part of it, because it enters K only as a factor of the first part. K is even in
    phi - pi, so half the azimuths will do.
    """
    x, weight = np.polynomial.legendre.leggauss(_QUADRATURE_NODES)
    azimuth = np.pi / 2 * (x + 1)
    totals = np.zeros(2)
    for low, high in ((0.0, _SUBSURFACE_ENDS), (_SUBSURFACE_ENDS, np.pi / 2)):
        theta_v = low + (high - low) / 2 * (x + 1)
        projected = (high - low) / 2 * weight * np.cos(theta_v) * np.sin(theta_v)
        for part, value in enumerate(_terms(azimuth, theta_v[:, None], np.asarray(theta_i))):
            totals[part] += projected @ value @ (np.pi * weight)
    return float(totals[0] / np.pi), float(totals[1] / np.pi)


def brf_ratio(azimuth: FloatArray, theta_v: FloatArray, theta_i: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """Radiance factor of the panel over its 8-degree/hemispherical reflectance, [points, wavelengths].

    `azimuth` [points] in [0, 360) with 180 = forward, `theta_v` and `theta_i` [points] unsigned angles of view
    and of incidence, all in degrees; `wavelengths` in nm. Raises `GeometryError` below the horizon.
    """
    theta_v, theta_i = np.radians(theta_v), np.radians(theta_i)
    for angle in (theta_v, theta_i):
        if not np.all((angle >= 0) & (angle <= np.pi / 2)):
            raise GeometryError(
                f"The reference panel reflects nothing at {np.degrees(angle).max():g} deg: "
                "the angles of incidence and view must lie within 90 deg of its normal"
            )
    reddening, neutral = _terms(np.radians(azimuth), theta_v, theta_i)
    distinct, position = np.unique(theta_i, return_inverse=True)
    integrals = np.array([_hemisphere(float(t)) for t in distinct]).reshape(-1, 2)[position]
    red = (_REDDENING[0] * wavelengths * 1e-3 + _REDDENING[1]) ** _REDDENING[2]
    return np.asarray((red * reddening[:, None] + neutral[:, None]) / (red * integrals[:, :1] + integrals[:, 1:]))


def spectralon_brf_ratio(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """`brf_ratio` for the signed in-plane angles of `goniometer.geometry`, [points, wavelengths].

    `theta_in` and `theta_out` [points] in degrees, `wavelengths` in nm; 1 everywhere would be Lambertian.
    A negative `theta_in` is the same panel turned round. Raises `GeometryError` below the horizon.
    """
    forward = theta_in * theta_out >= 0
    return brf_ratio(np.where(forward, 180.0, 0.0), np.abs(theta_out), np.abs(theta_in), wavelengths)


@dataclass(frozen=True)
class Certificate:
    """What a laboratory certifies about one panel: reflectance for 8 degrees into the hemisphere."""

    serial_number: str
    """Engraved on the panel; names the certificate in everything derived from it."""
    calibrated: datetime.date | None
    """Day of calibration; None for a nominal curve, which nobody measured on this panel."""
    valid_until: datetime.date | None
    """Last day on which the laboratory stands by it; None for a nominal curve."""
    wavelengths: FloatArray
    """[rows] nanometres, ascending."""
    reflectance_8h: FloatArray
    """[rows] 8-degree/hemispherical reflectance, 0 to 1."""
    u_reflectance: FloatArray
    """[rows] standard uncertainty (coverage factor 1) of `reflectance_8h`."""

    def reflectance(self, wavelengths: FloatArray) -> FloatArray:
        """Linear interpolation, of the shape of `wavelengths` (nm); raises `CertificateError` beyond the rows."""
        lowest, highest = float(self.wavelengths[0]), float(self.wavelengths[-1])
        if wavelengths.min() < lowest or wavelengths.max() > highest:
            raise CertificateError(
                f"Certificate {self.serial_number} covers {lowest:g} to {highest:g} nm, but "
                f"{wavelengths.min():g} to {wavelengths.max():g} nm is needed; give one that covers these"
            )
        return np.interp(wavelengths, self.wavelengths, self.reflectance_8h)


NOMINAL_SRS99 = Certificate(
    serial_number="nominal SRS-99",
    calibrated=None,
    valid_until=None,
    wavelengths=np.array([250.0, 270, 290, 310, 330, 360, 400, 500, 850, 900, 1050]),
    reflectance_8h=np.array([0.953, 0.957, 0.970, 0.978, 0.984, 0.986, 0.987, 0.988, 0.988, 0.990, 0.990]),
    u_reflectance=np.array([0.005, 0.005, 0.005, 0.004, 0.003, 0.003, 0.003, 0.003, 0.003, 0.003, 0.003]),
)
"""A clean white panel of nominally 99 % when its own certificate is not at hand.

Rounded by us from what certificates of several such panels have in common; the uncertainty covers the spread
from panel to panel besides that of one calibration.
"""


def reference_brdf(
    theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, certificate: Certificate
) -> FloatArray:
    """BRDF of the panel in plane, 1/sr, [points, wavelengths]: certified reflectance x `spectralon_brf_ratio` / pi.

    `theta_in`, `theta_out` [points] in degrees, signed as in `goniometer.geometry`; `wavelengths` in nm. Raises
    `CertificateError` for wavelengths beyond the certificate and `GeometryError` below the horizon.
    """
    ratio = spectralon_brf_ratio(theta_in, theta_out, wavelengths)
    return np.asarray(certificate.reflectance(wavelengths) * ratio / np.pi)


def reference_relative_uncertainty(theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """Relative standard uncertainty of the panel's spread over directions, [points]; angles in degrees.

    0.9 % while both angles stay within 70 degrees: the rms difference of the normalised model from NIST's
    in-plane measurements of sintered PTFE at 532 and 633 nm. Beyond, the model extrapolates; our judgement is
    a rise in proportion to the excess of the larger angle, up to 5 % at 85 degrees. The uncertainty of the
    certified reflectance comes on top and is the certificate's.
    """
    grazing = np.maximum(np.abs(theta_in), np.abs(theta_out))
    return np.asarray(U_DIRECTIONAL + (U_DIRECTIONAL_GRAZING - U_DIRECTIONAL) * np.maximum(grazing - 70.0, 0.0) / 15.0)


_COLUMNS = ["wavelength_nm", "reflectance", "standard_uncertainty"]
_HEADERS = ("serial_number", "calibrated", "valid_until")


def read_certificate(path: Path) -> str:
    """The text of a certificate file, unchecked; raises `CertificateError` where it is no readable text."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise CertificateError(f"{path}: the certificate cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise CertificateError(f"{path}: this is not a text file; a certificate is a CSV file in UTF-8") from error


def parse_certificate(text: str, path: str) -> Certificate:
    """A certificate from the text of a CSV file; `path` names the file in messages.

    Its first lines are `# serial_number: ...`, `# calibrated: YYYY-MM-DD` and `# valid_until: YYYY-MM-DD`, in any
    order; then the column names `wavelength_nm,reflectance,standard_uncertainty` and one row per wavelength.
    Raises `CertificateError` with the number of the offending line.
    """
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    headers = dict(_read_headers(path, lines))
    missing = [name for name in _HEADERS if name not in headers]
    if missing:
        raise CertificateError(f"{path}: a line '# {missing[0]}: ...' is missing before the columns")
    calibrated, valid_until = (_date(path, *headers[name]) for name in ("calibrated", "valid_until"))
    if valid_until < calibrated:
        raise CertificateError(
            f"{path}, line {headers['valid_until'][0]}: valid until {valid_until}, which is before the calibration "
            f"on {calibrated}"
        )
    rows = np.array(list(_read_rows(path, [(number, line) for number, line in lines if not line.startswith("#")])))
    return Certificate(headers["serial_number"][1], calibrated, valid_until, rows[:, 0], rows[:, 1], rows[:, 2])


def _read_headers(path: str, lines: list[tuple[int, str]]) -> Iterator[tuple[str, tuple[int, str]]]:
    """Name, line number and value of every known `# name: value` line; other comments are passed over."""
    for number, line in lines:
        if not line.startswith("#"):
            continue
        name, _, value = line[1:].partition(":")
        if name.strip() not in _HEADERS:
            continue
        if not value.strip():
            raise CertificateError(f"{path}, line {number}: {name.strip()} has no value")
        yield name.strip(), (number, value.strip())


def _date(path: str, number: int, text: str) -> datetime.date:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError as error:
        raise CertificateError(f"{path}, line {number}: '{text}' is not a day; write it as YYYY-MM-DD") from error


def _read_rows(path: str, lines: list[tuple[int, str]]) -> Iterator[tuple[float, float, float]]:
    """The rows of numbers below the line of column names, each checked."""
    if not lines or [column.strip() for column in lines[0][1].split(",")] != _COLUMNS:
        number = lines[0][0] if lines else 1
        raise CertificateError(f"{path}, line {number}: the columns must be '{','.join(_COLUMNS)}'")
    if len(lines) < 3:
        raise CertificateError(f"{path}, line {lines[-1][0]}: at least two rows of wavelengths are needed after it")
    previous = 0.0
    for number, line in lines[1:]:
        try:
            wavelength, reflectance, uncertainty = (float(cell) for cell in line.split(","))
        except ValueError as error:
            raise CertificateError(
                f"{path}, line {number}: '{line}' must be three numbers with commas between"
            ) from error
        if not previous < wavelength < math.inf:
            raise CertificateError(
                f"{path}, line {number}: {wavelength:g} nm is out of order; wavelengths must increase from row to row"
            )
        if not 0 < reflectance <= 1.05:
            raise CertificateError(
                f"{path}, line {number}: reflectance {reflectance:g} is impossible; it is a fraction between 0 and 1"
            )
        if not 0 <= uncertainty < 1:
            raise CertificateError(
                f"{path}, line {number}: standard uncertainty {uncertainty:g} is impossible; it is absolute, in the "
                "unit of the reflectance"
            )
        previous = wavelength
        yield wavelength, reflectance, uncertainty
