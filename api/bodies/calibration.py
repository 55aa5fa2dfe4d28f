"""What calibrates, and how the bench has changed."""

from typing import Any

from pydantic import Field

from api.bodies.base import Body, Number
from goniometer.states import Kind, Outcome, Phase


class CertificateRow(Body):
    """A certificate of a white panel."""

    sha256: str = Field(description="Of its text; by this it is known.")
    name: str = Field(description="Of its file, or what used it first.")
    serial_number: str = Field(description="Of the panel.")
    calibrated: str | None = Field(description="Day of calibration; null of nominal values.")
    valid_until: str | None = Field(description="Last day on which the laboratory stands by it.")
    valid_today: bool
    wavelengths_nm: tuple[float, float] = Field(description="Shortest and longest certified wavelength, nm.")
    kind: str = Field(description='"reflectance" (8 degrees into the hemisphere) or "brdf" (a table of directions).')
    who: str | None = Field(description="Who handed it in; null where it came with a campaign or a dataset.")
    created: str = Field(description="ISO 8601, UTC.")


class CertificateView(CertificateRow):
    """A certificate with what it certifies."""

    text: str = Field(description="The CSV file.")
    wavelength_nm: list[float] = Field(description="Empty of a table of directions.")
    reflectance: list[float] = Field(description="8 degrees into the hemisphere, 0 to 1.")
    u_reflectance: list[float] = Field(description="Standard uncertainty (k = 1).")


class CharacterisationView(Body):
    """A measurement of the bench itself."""

    id: int
    kind: str = Field(examples=["signature"])
    created: str = Field(description="ISO 8601, UTC.")
    bench: str = Field(description="Name of the bench.")
    content: dict[str, Any] = Field(description="As `goniometer characterise --json` prints it.")


class Drift(Body):
    """What the looks at the lamp of one scan tell; the lists run over them."""

    seconds: list[float] = Field(description="Since the first one, on the clock of its session.")
    session: list[int] = Field(description="Number of the session of the bench; times of two cannot be compared.")
    level: list[float] = Field(description="Relative change of the lamp at 600 nm.")
    tilt: list[float] = Field(description="Relative change towards the blue; of a hotter lamp as large as the level.")


class Reference(Body):
    """A scan of the reference panel."""

    scan: int
    campaign_id: int
    campaign: str
    phase: Phase
    outcome: Outcome | None
    started: str | None = Field(description="ISO 8601, UTC.")
    finished: str | None
    points: int = Field(description="Directions that were measured.")
    certificate: str | None = Field(description="SHA-256 of the campaign's certificate; null: nominal values.")
    drift: Drift | None = Field(description="Null where the lamp was looked at less than twice.")
    drift_words: str = Field(description="Why there is no drift although the lamp was looked at; empty else.")


class Band(Body):
    """The response in a band of wavelengths."""

    wavelength_nm: float
    ratio: Number = Field(description="To that of the first scan of the panel; null where it is 0.")
    u: Number = Field(description="Standard uncertainty (k = 1): noise, and the scatter over directions.")


class ScanHistory(Body):
    """What a scan tells of the bench."""

    scan: int
    campaign: str
    name: str
    kind: Kind
    started: str = Field(description="ISO 8601, UTC.")
    temperature: Number = Field(description="Mean of the detector over all exposures, degrees Celsius.")
    temperature_low: Number
    temperature_high: Number
    lamp_change: Number = Field(description="Relative change at 600 nm from the first look at the lamp to the last.")
    lamp_largest: Number = Field(description="Largest relative change since the first look.")
    u_lamp: Number = Field(description="Relative standard uncertainty (k = 1) of the lamp at a point of the scan.")
    response: list[Band] = Field(
        description="Of a scan of the reference panel: its signal against that of the first such scan, over the "
        "directions that both have; empty of other scans, and where they have none in common."
    )


class WavelengthHistory(Body):
    """A measurement of the wavelength scale."""

    created: str = Field(description="ISO 8601, UTC.")
    offset: Number = Field(description="To be added to the spectrometer's own wavelengths, nm.")
    u_offset: Number = Field(description="Standard uncertainty (k = 1), nm.")


class History(Body):
    """How the bench has changed."""

    bench: str = Field(description="The one that this service runs; others on the same database are not told of.")
    scans: list[ScanHistory] = Field(description="Oldest first.")
    wavelength: list[WavelengthHistory] = Field(description="Oldest first.")
    stated_wavelength_offset: Number = Field(description="That of the newest scan's instrument file, nm.")
    u_stated_wavelength: Number = Field(description="Its standard uncertainty (k = 1), nm.")
    more: bool = Field(description="Whether there are older scans.")
