"""The certificates of white panels that a database knows: handed in, or used by a campaign or a dataset."""

import hashlib
from dataclasses import dataclass
from datetime import date

from sqlalchemy import insert, select

from goniometer.certificates.certificate import BrdfTable, PanelCertificate
from goniometer.certificates.certificate_file import parse_certificate
from goniometer.errors import NotInStore
from goniometer.storage import tables
from goniometer.storage.database import Database
from goniometer.storage.records import now
from goniometer.storage.service_tables import certificates as table


@dataclass(frozen=True)
class Known:
    """A certificate."""

    sha256: str
    """Of its text in UTF-8."""
    name: str
    """Of its file, or who used it first."""
    text: str
    who: str | None
    """Who handed it in; None where it came with a campaign or a dataset."""
    created: str
    """ISO 8601, UTC."""

    @property
    def panel(self) -> PanelCertificate:
        """What it says; raises `CertificateError` where it cannot be read."""
        return parse_certificate(self.text, self.name)


def sha256_of(text: str) -> str:
    """By what a certificate is known."""
    return hashlib.sha256(text.encode()).hexdigest()


def add_certificate(database: Database, name: str, text: str, who: str) -> Known:
    """Hand in a certificate, the text of a CSV file; one that is known stays as it is. Raises `CertificateError`."""
    parse_certificate(text, name)
    sha = sha256_of(text)
    with database.alone() as connection:
        if connection.execute(select(table.c.sha256).where(table.c.sha256 == sha)).first() is None:
            connection.execute(insert(table).values(sha256=sha, name=name, text=text, who=who, created=now()))
    return known_certificate(database, sha)


def known_certificates(database: Database) -> list[Known]:
    """All of them, newest first."""
    found: dict[str, Known] = {}
    for row in database.rows(select(table)):
        found[row.sha256] = Known(row.sha256, row.name, row.text, row.who, row.created)
    campaigns = select(
        tables.campaigns.c.certificate, tables.campaigns.c.created, tables.campaigns.c.name.label("user")
    ).where(tables.campaigns.c.certificate.is_not(None))
    datasets = select(
        tables.datasets.c.certificate, tables.datasets.c.created, tables.datasets.c.sample.label("user")
    ).where(tables.datasets.c.certificate.is_not(None))
    for what, query in (("campaign", campaigns), ("dataset of", datasets)):
        # a thousand campaigns share one text, which is hashed once
        first = {row.certificate: row for row in reversed(database.rows(query))}
        for text, row in first.items():
            sha = sha256_of(text)
            found.setdefault(sha, Known(sha, f"{what} {row.user}", text, None, row.created))
    return sorted(found.values(), key=lambda known: known.created, reverse=True)


def known_certificate(database: Database, sha256: str) -> Known:
    """One of them; raises `NotInStore`."""
    for known in known_certificates(database):
        if known.sha256 == sha256:
            return known
    raise NotInStore(f"There is no certificate with the SHA-256 {sha256}; list what there is, or hand it in")


def wavelengths_of(panel: PanelCertificate) -> tuple[float, float]:
    """Shortest and longest certified wavelength, nm."""
    return float(panel.wavelengths[0]), float(panel.wavelengths[-1])


def is_valid(panel: PanelCertificate, day: date) -> bool:
    """Whether the laboratory stands by it on a day; nominal values nobody ever stood by."""
    return panel.valid_until is not None and panel.valid_until >= day


def curve_of(panel: PanelCertificate) -> tuple[list[float], list[float], list[float]] | None:
    """Wavelengths in nm, reflectances 8 deg/hemispherical, and their standard uncertainties; None of a table."""
    if isinstance(panel, BrdfTable):
        return None
    return panel.wavelengths.tolist(), panel.reflectance_8h.tolist(), panel.u_reflectance.tolist()
