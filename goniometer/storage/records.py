"""What the rows of the database are in Python, and how the one becomes the other."""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from typing import Any

import numpy as np
from sqlalchemy import Row

from drivers.arrays import CountArray
from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import numbered
from goniometer.constants import BenchData, Constants
from goniometer.datasets.dataset import Check, Dataset
from goniometer.errors import RawDamaged, StoreError
from goniometer.geometry import Geometry
from goniometer.states import Command, ExposureKind, Kind, Outcome, Phase, Status
from goniometer.uncertainty import ErrorSource


@dataclass(frozen=True)
class Expected:
    """A time in seconds and between which limits it lies."""

    seconds: float
    low: float
    high: float

    def __add__(self, other: "Expected") -> "Expected":
        """Of two parts that are long or short for the same reason, such as a dark sample."""
        return Expected(self.seconds + other.seconds, self.low + other.low, self.high + other.high)


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
    """Why it ended so, as a sentence; of a completed sample, what accuracy its sampling reached."""
    command: Command | None
    """What somebody asked for and the scheduler has not taken up yet."""
    started: str | None
    finished: str | None
    repeat: int | None = None
    """Which measurement of its sample in the campaign this is, counted from 1; None where there is only one."""
    expected_points: int | None = None
    """Points that there will be in the end, as was foreseen when its last point began; None before, and once it is
    complete."""
    remaining: Expected | None = None
    """Time at the bench that it needed then; None before, and once it is complete."""

    @property
    def name(self) -> str:
        """How people call it: its sample, with the number of the repeat where there are several."""
        return numbered(self.sample, self.repeat)


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
    """Why it failed or was skipped, or what is less than was wanted; empty otherwise."""
    seconds: float
    """Bench time that it took, seconds."""
    signal_to_noise: float | None
    """Ratio that its shortest exposures reached in the median bin; None until it is done."""


@dataclass(frozen=True)
class Exposure:
    """One raw spectrum."""

    id: int
    kind: ExposureKind
    point_id: int | None
    """The point it belongs to; None for all but light."""
    geometry: Geometry | None
    """Where the stages stood, as read back, or were when a sweep's reading began; None for a dark."""
    theta_out_end: float | None
    """Where the arm was when a sweep's reading ended, degrees; None for all others."""
    session: str
    """Of the bench that took it; moments of two sessions cannot be compared."""
    moment: float
    """When it was taken, seconds on the clock of the session."""
    taken: str
    """When it was written, ISO 8601 in UTC."""
    integration_time: float
    """Seconds."""
    counts: CountArray
    """[pixels] as read from the device."""
    detector_temperature: float
    """Degrees Celsius."""


@dataclass(frozen=True)
class ExposureTime:
    """When and where a spectrum was integrated, and for how long; see `Exposure`."""

    id: int
    kind: ExposureKind
    point_id: int | None
    geometry: Geometry | None
    session: str
    integration_time: float


@dataclass(frozen=True)
class StoredText:
    """A fit or an export of a dataset."""

    id: int
    dataset_id: int
    kind: str
    """Model of a fit, format of an export."""
    text: str
    """JSON of a fit, path of an export."""


@dataclass(frozen=True)
class Characterisation:
    """A measurement of the bench itself."""

    id: int
    kind: str
    """"signature", "noise", "alignment", "repeatability" or "wavelength"."""
    json: str
    created: str
    """ISO 8601 in UTC."""
    bench: str
    """Name of the bench."""


def now() -> str:
    """The present as it is written in the database."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


_OF_SCAN = tuple(field.name for field in fields(Scan))


def to_scan(row: Row[Any]) -> Scan:
    """A row of `tables.scans` with its `repeat`."""
    values = {name: getattr(row, name) for name in _OF_SCAN}
    if row.remaining is not None:
        values["remaining"] = Expected(row.remaining, row.remaining_low, row.remaining_high)
    return Scan(**values)


def to_point(row: Row[Any]) -> Point:
    """A row of `tables.points`."""
    read_back = None if row.read_theta_in is None else Geometry(row.read_theta_in, row.read_theta_out)
    geometry = Geometry(row.theta_in, row.theta_out)
    return Point(
        row.id,
        row.scan_id,
        row.number,
        geometry,
        read_back,
        row.status,
        row.attempts,
        row.reason,
        row.seconds,
        row.signal_to_noise,
    )


def to_exposure(row: Row[Any], archived: bytes | None = None) -> Exposure:
    """A row of `tables.exposures`, with its counts from an archive where they are `archived`.

    Raises `RawDamaged` where it is not as it was written.
    """
    kept = row.counts if archived is None else archived
    if exposure_hash({**row._mapping, "counts": kept}) != row.sha256:
        raise RawDamaged(row.id)
    counts = np.frombuffer(kept, dtype="<u4").astype(np.uint32)
    return Exposure(
        row.id,
        row.kind,
        row.point_id,
        None if row.theta_in is None else Geometry(row.theta_in, row.theta_out),
        row.theta_out_end,
        row.session,
        row.moment,
        row.taken,
        row.integration_time,
        counts,
        row.detector_temperature,
    )


def exposure_row(
    scan_id: int,
    point_id: int | None,
    kind: ExposureKind,
    geometry: Geometry | None,
    session: str,
    moment: float,
    spectrum: Spectrum,
    theta_out_end: float | None = None,
) -> dict[str, object]:
    """Values of a new row of `tables.exposures`; counts are kept as little-endian u32."""
    row: dict[str, object] = {
        "scan_id": scan_id,
        "point_id": point_id,
        "kind": kind,
        "theta_in": None if geometry is None else _as_kept(geometry.theta_in),
        "theta_out": None if geometry is None else _as_kept(geometry.theta_out),
        "theta_out_end": None if theta_out_end is None else _as_kept(theta_out_end),
        "session": session,
        "moment": _as_kept(moment),
        "integration_time": _as_kept(spectrum.integration_time),
        "counts": spectrum.counts.astype("<u4").tobytes(),
        "device_count": int(spectrum.count),
        "detector_temperature": _as_kept(spectrum.detector_temperature),
        "taken": now(),
    }
    return row | {"sha256": exposure_hash(row)}


HASHED = (
    "kind",
    "integration_time",
    "device_count",
    "detector_temperature",
    "theta_in",
    "theta_out",
    "theta_out_end",
    "session",
    "moment",
    "taken",
)
"""Columns whose content is in the hash of an exposure, beside the counts."""


def _as_kept(number: float) -> float:
    return float(number) + 0.0  # SQLite makes 0.0 of -0.0, and the hash is of what is read again


def exposure_hash(row: Mapping[Any, Any]) -> str:
    """SHA-256 of a row of `tables.exposures`: of the canonical JSON of what was read beside the counts, and the counts.

    Numbers of rows are not in it, for what was read does not depend on them.
    """
    told = json.dumps([row[name] for name in HASHED], separators=(",", ":"))
    return hashlib.sha256(told.encode() + b"\n" + row["counts"]).hexdigest()


_DATASET_ARRAYS = ("theta_in", "theta_out", "wavelengths", "brdf", "flags")


def pack_dataset(dataset: Dataset) -> bytes:
    """All numbers of a dataset as a compressed NumPy archive."""
    arrays = {name: getattr(dataset, name) for name in _DATASET_ARRAYS}
    for i, source in enumerate(dataset.sources):
        arrays[f"source_{i}"] = source.values
        if source.groups is not None:
            arrays[f"groups_{i}"] = source.groups
    about = [
        {"name": s.name, "part": s.part, "shared_by_wavelengths": s.shared_by_wavelengths} for s in dataset.sources
    ]
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        u_angle=dataset.u_angle,
        u_zero=dataset.u_zero,
        aperture=dataset.aperture,
        sources=json.dumps(about),
        **arrays,
    )
    return buffer.getvalue()


def to_dataset(row: Row[Any]) -> Dataset:
    """A row of `tables.datasets`, bit for bit as it was packed; raises `StoreError` where it is damaged."""
    try:
        with np.load(io.BytesIO(row.arrays), allow_pickle=False) as arrays:
            sources = tuple(
                ErrorSource(values=arrays[f"source_{i}"], groups=arrays.get(f"groups_{i}"), **about)
                for i, about in enumerate(json.loads(str(arrays["sources"])))
            )
            return Dataset(
                sample=row.sample,
                sources=sources,
                u_angle=float(arrays["u_angle"]),
                u_zero=float(arrays["u_zero"]),
                aperture=float(arrays["aperture"]),
                checks=tuple(Check(**check) for check in json.loads(row.checks)),
                lineage=json.loads(row.lineage),
                **{name: arrays[name] for name in _DATASET_ARRAYS},
            )
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError, TypeError) as error:
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
    return Constants(**(content | arrays | {"bench": BenchData(**content["bench"])}))
