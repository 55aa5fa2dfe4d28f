"""Certificates of the white reference: what a laboratory measured on one panel, and until when it stands by it.

There are two kinds: the reflectance for light from 8 degrees into the hemisphere (`Certificate`), which the panel
model of `goniometer.certificates.reference` spreads over directions, and a table of the BRDF itself (`BrdfTable`),
which needs no model. `goniometer.certificates.certificate_file` reads and writes both.
"""

import datetime
import math
from dataclasses import dataclass

import numpy as np
import scipy

from drivers.arrays import FloatArray
from goniometer.certificates.reference import reference_relative_uncertainty, spectralon_brf_ratio
from goniometer.errors import CertificateError

EDGE = 0.1
"""Degrees that a read-back angle may lie beyond a table, whose edge is taken there: the stages' error."""


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

    def check_covers(self, lowest: float, highest: float) -> None:
        """Raise `CertificateError` unless all wavelengths from `lowest` to `highest`, nm, are certified."""
        _check_wavelengths(self, lowest, highest)

    def reflectance(self, wavelengths: FloatArray) -> FloatArray:
        """Linear interpolation, of the shape of `wavelengths` (nm); raises `CertificateError` beyond the rows."""
        self.check_covers(wavelengths.min(), wavelengths.max())
        return np.interp(wavelengths, self.wavelengths, self.reflectance_8h)

    def brdf(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
        """BRDF of the panel in plane, 1/sr, [points, wavelengths]: reflectance x `spectralon_brf_ratio` / pi.

        `theta_in`, `theta_out` [points] in degrees, signed as in `goniometer.geometry`; `wavelengths` in nm. Raises
        `CertificateError` for wavelengths beyond the certificate and `GeometryError` below the horizon.
        """
        ratio = spectralon_brf_ratio(theta_in, theta_out, wavelengths)
        return np.asarray(self.reflectance(wavelengths) * ratio / np.pi)

    def errors(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> dict[str, FloatArray]:
        """Relative changes of `brdf` for one standard uncertainty of each source, [points, wavelengths], read-only.

        The sources are independent of each other, and each is the same error for all points and wavelengths. Of
        the laboratory's we know no more than that its wavelengths share most. How the directions share the error u
        of the panel model (`reference_relative_uncertainty`) nobody has published; our judgement is a correlation
        of cos^2(d / 2) between two reflected directions d apart: neighbours err together, opposite grazing directions
        each on its own. This is what the three changes u / sqrt(2) x (1, cos(theta_out), sin(theta_out)) make;
        their squares sum to u^2. Raises what `brdf` raises for wavelengths.
        """
        shape = theta_out.size, wavelengths.size
        certified = np.interp(wavelengths, self.wavelengths, self.u_reflectance) / self.reflectance(wavelengths)
        u = reference_relative_uncertainty(theta_in, theta_out)[:, None] / math.sqrt(2)
        direction = np.radians(theta_out)[:, None]
        return {
            "certificate": np.broadcast_to(certified, shape),
            "panel model, all directions": np.broadcast_to(u, shape),
            "panel model, normal against grazing": np.broadcast_to(u * np.cos(direction), shape),
            "panel model, forward against back": np.broadcast_to(u * np.sin(direction), shape),
        }


@dataclass(frozen=True)
class BrdfTable:
    """What a laboratory certifies about one panel: its BRDF in plane on a grid."""

    serial_number: str
    """Engraved on the panel; names the certificate in everything derived from it."""
    calibrated: datetime.date | None
    """Day of calibration; None for nominal values, which nobody measured on this panel."""
    valid_until: datetime.date | None
    """Last day on which the laboratory stands by it; None for nominal values."""
    theta_in: FloatArray
    """[incident angles] degrees, ascending, at least two."""
    theta_out: FloatArray
    """[reflected angles] degrees, signed as in `goniometer.geometry`, ascending, at least two."""
    wavelengths: FloatArray
    """[rows] nanometres, ascending, at least two."""
    values: FloatArray
    """[incident angles, reflected angles, rows] BRDF, 1/sr."""
    u_values: FloatArray
    """[incident angles, reflected angles, rows] standard uncertainty (coverage factor 1) of `values`, 1/sr."""

    def check_covers(self, lowest: float, highest: float) -> None:
        """Raise `CertificateError` unless all wavelengths from `lowest` to `highest`, nm, are certified."""
        _check_wavelengths(self, lowest, highest)

    def brdf(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
        """BRDF of the panel in plane, 1/sr, [points, wavelengths], interpolated linearly in all three.

        `theta_in`, `theta_out` [points] in degrees, signed as in `goniometer.geometry`; a negative `theta_in` is the
        same panel turned round. `wavelengths` in nm. Raises `CertificateError` beyond the table; angles may
        exceed it by `EDGE`.
        """
        return self._interpolated(self.values, theta_in, theta_out, wavelengths)

    def errors(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> dict[str, FloatArray]:
        """Relative change of `brdf` for one standard uncertainty of the certificate, [points, wavelengths].

        The same error for all points and wavelengths. Raises what `brdf` raises.
        """
        u = self._interpolated(self.u_values, theta_in, theta_out, wavelengths)
        return {"certificate": u / self.brdf(theta_in, theta_out, wavelengths)}

    def _interpolated(
        self, values: FloatArray, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray
    ) -> FloatArray:
        self.check_covers(wavelengths.min(), wavelengths.max())
        turned = np.where(theta_in < 0, -theta_out, theta_out)
        incident = self._within("theta_in", self.theta_in, np.abs(theta_in))
        reflected = self._within("theta_out", self.theta_out, turned)
        rows = scipy.interpolate.RegularGridInterpolator((self.wavelengths,), np.moveaxis(values, 2, 0))(
            wavelengths[:, None]
        )
        table = scipy.interpolate.RegularGridInterpolator((self.theta_in, self.theta_out), np.moveaxis(rows, 0, 2))
        return np.asarray(table(np.stack([incident, reflected], axis=1)))

    def _within(self, name: str, grid: FloatArray, angles: FloatArray) -> FloatArray:
        """`angles` with those in the margin moved onto the edge of `grid`; refuses those beyond it."""
        if angles.min() < grid[0] - EDGE or angles.max() > grid[-1] + EDGE:
            raise CertificateError(
                f"Certificate {self.serial_number} covers {name} from {grid[0]:g} to {grid[-1]:g} deg, but "
                f"{angles.min():g} to {angles.max():g} deg is needed; give one that covers these"
            )
        return np.clip(angles, grid[0], grid[-1])


PanelCertificate = Certificate | BrdfTable
"""All that a reference panel can come with."""


def _check_wavelengths(certificate: PanelCertificate, lowest: float, highest: float) -> None:
    first, last = certificate.wavelengths[0], certificate.wavelengths[-1]
    if lowest < first or highest > last:
        raise CertificateError(
            f"Certificate {certificate.serial_number} covers {first:g} to {last:g} nm, but "
            f"{lowest:g} to {highest:g} nm is needed; give one that covers these"
        )


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


@dataclass(frozen=True)
class Override:
    """Somebody's decision to calibrate with a certificate that is not valid."""

    name: str
    """Who decided."""
    reason: str
    """Why."""

    def __post_init__(self) -> None:
        if not (self.name.strip() and self.reason.strip()):
            raise CertificateError("An override of the certificate needs both the name of who decides and a reason")


def check_validity(certificate: PanelCertificate, day: datetime.date, override: Override | None) -> str | None:
    """None where `certificate` was valid on `day`, the day of the reference scan; else what its `override` says.

    The sentence names who took it all the same, why, and what was wrong; it belongs to everything derived. Raises
    `CertificateError` where the certificate was not valid and nobody overrides.
    """
    if certificate.calibrated is None:
        fault = f"Certificate {certificate.serial_number} is nominal: nobody has measured this panel"
    elif day < certificate.calibrated:
        fault = (
            f"Certificate {certificate.serial_number} dates from {certificate.calibrated}, after the reference scan "
            f"of {day}"
        )
    elif certificate.valid_until is not None and day > certificate.valid_until:
        fault = (
            f"Certificate {certificate.serial_number} expired on {certificate.valid_until}, before the reference scan "
            f"of {day}"
        )
    else:
        return None
    if override is None:
        raise CertificateError(
            f"{fault}; name a certificate that was valid on {day}, or override this with a name and a reason"
        )
    return f"{fault}; {override.name} used it all the same, for this reason: {override.reason}"
