"""What the rows of the database are in Python, and how the one becomes the other."""

import io
import json
import zipfile
import zlib
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
from sqlalchemy import Row

from drivers.arrays import CountArray
from drivers.interfaces import Spectrum
from goniometer.dataset import Dataset
from goniometer.errors import StoreError
from goniometer.geometry import Geometry
from goniometer.instrument import Constants

Kind = Literal["reference", "sample"]
Phase = Literal["idle", "running", "pausing", "paused", "aborting", "finished"]
Outcome = Literal["completed", "aborted", "failed"]
Command = Literal["pause", "resume", "abort"]
Status = Literal["pending", "running", "done", "failed", "skipped"]


@dataclass(frozen=True)
class Scan:
    """One thing measured from end to end."""

    id: int
    campaign_id: int
    number: int
    """Place in the campaign; the reference scan is 0."""
    kind: Kind
    sample: str
    material: str
    phase: Phase
    outcome: Outcome | None
    """How it ended; None while it has not."""
    reason: str
    """Why it ended so, as a sentence; empty when completed."""
    command: Command | None
    """What somebody asked for and the scheduler has not taken up yet."""
    started: str | None
    finished: str | None


@dataclass(frozen=True)
class Point:
    """One direction of a scan."""

    id: int
    scan_id: int
    number: int
    """Order in which the plan asked for it."""
    geometry: Geometry
    """As planned."""
    read_back: Geometry | None
    """As the stages read it back; None until it is done."""
    status: Status
    attempts: int
    reason: str
    """Why it failed or was skipped; empty otherwise."""
    seconds: float
    """Bench time that it took, seconds."""


@dataclass(frozen=True)
class Exposure:
    """One raw spectrum, light or dark."""

    id: int
    point_id: int | None
    """The point it belongs to; None for a dark."""
    integration_time: float
    """Seconds."""
    counts: CountArray
    """[pixels] as read from the device."""
    detector_temperature: float
    """Degrees Celsius."""


@dataclass(frozen=True)
class StoredText:
    """A fit or an export of a dataset."""

    id: int
    dataset_id: int
    kind: str
    """Model of a fit, format of an export."""
    text: str
    """JSON of a fit, path of an export."""


def now() -> str:
    """The present as it is written in the database."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def to_scan(row: Row[Any]) -> Scan:
    """A row of `tables.scans`."""
    return Scan(**{field.name: getattr(row, field.name) for field in fields(Scan)})


def to_point(row: Row[Any]) -> Point:
    """A row of `tables.points`."""
    read_back = None if row.read_theta_in is None else Geometry(row.read_theta_in, row.read_theta_out)
    geometry = Geometry(row.theta_in, row.theta_out)
    return Point(
        row.id, row.scan_id, row.number, geometry, read_back, row.status, row.attempts, row.reason, row.seconds
    )


def to_exposure(row: Row[Any]) -> Exposure:
    """A row of `tables.exposures`."""
    counts = np.frombuffer(row.counts, dtype="<u4").astype(np.uint32)
    return Exposure(row.id, row.point_id, row.integration_time, counts, row.detector_temperature)


def exposure_row(scan_id: int, point_id: int | None, kind: str, spectrum: Spectrum) -> dict[str, object]:
    """Values of a new row of `tables.exposures`; counts are kept as little-endian u32."""
    return {
        "scan_id": scan_id,
        "point_id": point_id,
        "kind": kind,
        "integration_time": spectrum.integration_time,
        "counts": spectrum.counts.astype("<u4").tobytes(),
        "device_count": spectrum.count,
        "detector_temperature": spectrum.detector_temperature,
        "taken": now(),
    }


_DATASET_ARRAYS = (
    "theta_in",
    "theta_out",
    "wavelengths",
    "brdf",
    "u_random",
    "u_dark",
    "u_reference",
    "u_reference_dark",
    "integration_time",
    "saturated",
)


def pack_dataset(dataset: Dataset) -> bytes:
    """All numbers of a dataset as a compressed NumPy archive."""
    buffer = io.BytesIO()
    arrays = {name: getattr(dataset, name) for name in _DATASET_ARRAYS}
    np.savez_compressed(buffer, u_angle=dataset.u_angle, aperture=dataset.aperture, **arrays)
    return buffer.getvalue()


def to_dataset(row: Row[Any]) -> Dataset:
    """A row of `tables.datasets`, bit for bit as it was packed; raises `StoreError` where it is damaged."""
    try:
        with np.load(io.BytesIO(row.arrays)) as arrays:
            return Dataset(
                sample=row.sample,
                u_angle=float(arrays["u_angle"]),
                aperture=float(arrays["aperture"]),
                lineage=json.loads(row.lineage),
                **{name: arrays[name] for name in _DATASET_ARRAYS},
            )
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError) as error:
        raise StoreError(
            f"Dataset {row.id} is damaged in the database ({error}); restore the database from a copy"
        ) from error


def constants_json(constants: Constants) -> str:
    """Instrument constants as JSON, which keeps every bit of a number."""
    arrays = {"wavelengths": constants.wavelengths.tolist(), "nonlinearity": constants.nonlinearity.tolist()}
    return json.dumps(asdict(constants) | arrays, sort_keys=True)


def to_constants(text: str) -> Constants:
    """The reverse of `constants_json`."""
    content = json.loads(text)
    arrays = {name: np.array(content[name], dtype=float) for name in ("wavelengths", "nonlinearity")}
    return Constants(**(content | arrays))
