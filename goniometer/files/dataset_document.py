"""A dataset in a file: what it says of itself beside its arrays, and how both become the same dataset again.

HDF5, CSV and Parquet hold the same: arrays, and a document that names the sample, says how the sources of error are
shared, what the flags mean, what the checks found and what the dataset was derived from. It states the hashes of
all numbers, and of checks and lineage, so that a file that was changed since is told from one that is as it was.
"""

import hashlib
import json
import re
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import MEANING, Check, Dataset
from goniometer.errors import DataFileError
from goniometer.storage.derived import software_version
from goniometer.uncertainty import PARTS, ErrorSource, Groups, everywhere
from goniometer.wording import check_name, inert

FORMAT = "goniometer dataset"
VERSION = 1

LARGEST_ARRAYS = 1_000_000_000
"""Bytes above which the arrays of a file are refused, for a small file may unpack to anything."""

MOST_SOURCES = 1000
"""Sources of error that a file may have; no budget has nearly as many."""

MEANINGS = {
    "theta_in": "incident angle, as read back from the stages",
    "theta_out": "reflected angle, signed: the mirror direction is theta_out = theta_in",
    "wavelength": "wavelength",
    "brdf": "BRDF; no number where no valid value exists",
    "standard_uncertainty": "combined standard uncertainty of brdf (coverage factor 1)",
    "flags": "what is doubtful about the point, a sum of flags",
}
"""Column -> what it holds."""

UNITS = {
    "theta_in": "deg",
    "theta_out": "deg",
    "wavelength": "nm",
    "brdf": "1/sr",
    "standard_uncertainty": "1/sr",
    "flags": "1",
}
"""Column -> unit."""

SHARING = (
    "A source of error is an unknown number of mean 0 and variance 1, and its values say what that does to brdf. "
    "Points of one group have the same error, all for 'all', and each has its own for null; wavelengths have the same "
    "where shared_by_wavelengths is true, else each has its own. Sources are independent of each other."
)
"""How to read the sources of error."""

FiniteFloat = Annotated[float, Field(allow_inf_nan=False, ge=0)]


def _plain_name(name: str) -> str:
    """A name that can stand above a column of a table and in a line that is printed."""
    if inert(name) != name or re.search(r"[\n\t]|[,;]\s*[=+@-]", name):
        raise ValueError("a source of error has a name of letters, digits and spaces")
    return name


class SourceText(BaseModel):
    """One source of error without its values; see `goniometer.uncertainty.ErrorSource`."""

    model_config = ConfigDict(strict=True, frozen=True)

    name: Annotated[str, Field(max_length=200), AfterValidator(_plain_name)]
    part: str
    shared_by_wavelengths: bool
    groups: Literal["all"] | list[int] | None


class CheckText(BaseModel):
    """One check; see `goniometer.datasets.dataset.Check`."""

    model_config = ConfigDict(strict=True, frozen=True)

    name: str
    passed: bool | None
    message: str


class Document(BaseModel):
    """What a file says of its dataset."""

    model_config = ConfigDict(strict=True, frozen=True)

    format: Literal["goniometer dataset"]
    format_version: Literal[1]
    sample: Annotated[str, AfterValidator(check_name)]
    content_hash: str
    history_hash: str
    aperture_deg: FiniteFloat
    u_angle_deg: FiniteFloat
    u_zero_deg: FiniteFloat
    sources: Annotated[list[SourceText], Field(max_length=MOST_SOURCES)]
    checks: list[CheckText]
    lineage: dict[str, Any]


@dataclass(frozen=True)
class Arrays:
    """The large part of a dataset; see `Dataset`."""

    theta_in: FloatArray
    """[points]"""
    theta_out: FloatArray
    """[points]"""
    wavelengths: FloatArray
    """[wavelengths]"""
    brdf: FloatArray
    """[points, wavelengths]"""
    flags: FloatArray
    """[points]"""
    sources: tuple[FloatArray, ...]
    """[points, wavelengths] of each source of error."""


def document(dataset: Dataset) -> dict[str, Any]:
    """What a file says of a dataset, as JSON; whoever reads it may leave out what `Document` does not have."""
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "sample": dataset.sample,
        "kind": dataset.kind,
        "content_hash": dataset.content_hash,
        "history_hash": _history_hash(dataset),
        "units": UNITS,
        "columns": MEANINGS,
        "aperture_deg": dataset.aperture,
        "u_angle_deg": dataset.u_angle,
        "u_zero_deg": dataset.u_zero,
        "flags": {str(int(flag)): words for flag, words in MEANING.items()},
        "sharing": SHARING,
        "sources": [
            {
                "name": source.name,
                "part": source.part,
                "shared_by_wavelengths": source.shared_by_wavelengths,
                "groups": _groups_text(source.groups),
            }
            for source in dataset.sources
        ],
        "checks": [asdict(check) for check in dataset.checks],
        "lineage": dataset.lineage,
        "software": {"name": "goniometer", "version": software_version()},
    }


def without_nan(content: object) -> Any:
    """JSON content with null in place of NaN and infinities, which strict JSON does not know."""
    return json.loads(json.dumps(content), parse_constant=lambda _: None)


def parsed(where: str, content: object) -> Document:
    """The document of a file; `where` names it in messages. Raises `DataFileError` for another or an incomplete one."""
    if isinstance(content, dict) and content.get("format_version", VERSION) != VERSION:
        raise DataFileError(
            f"{where}: has version {content['format_version']} of the format, but this program reads version "
            f"{VERSION}; use the program that wrote it."
        )
    try:
        return Document.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise DataFileError(
            f"{where}: does not say what a dataset needs ({place}: {first['msg'].lower()}); export it again."
        ) from error


def parsed_json(where: str, text: str | bytes) -> Document:
    """The same from its text; raises `DataFileError` also for one that is no JSON."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataFileError(f"{where}: what it says of itself is no valid JSON; export it again.") from error
    return parsed(where, content)


def assembled(where: str, said: Document, arrays: Arrays) -> Dataset:
    """The dataset of a file, equal in every bit to the one that was written.

    Raises `DataFileError` where the parts do not belong together, or do not have the hash that the file states.
    """
    points, wavelengths = arrays.theta_in.size, arrays.wavelengths.size
    shapes = [each.shape for each in (arrays.theta_out, arrays.flags)] + [each.shape for each in arrays.sources]
    wanted = [(points,)] * 2 + [(points, wavelengths)] * len(said.sources)
    if shapes != wanted or arrays.brdf.shape != (points, wavelengths) or not points or not wavelengths:
        raise DataFileError(f"{where}: its arrays do not have the same points and wavelengths; export it again.")
    flags = arrays.flags
    if not ((flags >= 0) & (flags < 2**16) & (flags == np.floor(flags))).all():
        raise DataFileError(f"{where}: has a flag that is no sum of flags; export it again.")
    dataset = Dataset(
        sample=said.sample,
        theta_in=arrays.theta_in,
        theta_out=arrays.theta_out,
        wavelengths=arrays.wavelengths,
        brdf=arrays.brdf,
        sources=tuple(
            ErrorSource(text.name, _part(where, text), values, _groups(where, text, points), text.shared_by_wavelengths)
            for text, values in zip(said.sources, arrays.sources, strict=True)
        ),
        flags=flags.astype(np.uint16),
        u_angle=said.u_angle_deg,
        u_zero=said.u_zero_deg,
        aperture=said.aperture_deg,
        checks=tuple(Check(each.name, each.passed, each.message) for each in said.checks),
        lineage=said.lineage,
    )
    if (dataset.content_hash, _history_hash(dataset)) != (said.content_hash, said.history_hash):
        raise DataFileError(
            f"{where}: does not have the hashes that it states, so it was changed after it was written; export it "
            f"again, or import the changed numbers as a table of somebody else's."
        )
    return dataset


def _history_hash(dataset: Dataset) -> str:
    """SHA-256 of what the checks found and of the lineage, which the hash of the content leaves out."""
    told = [[asdict(check) for check in dataset.checks], dataset.lineage]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _groups_text(groups: Groups | None) -> Literal["all"] | list[int] | None:
    if groups is None:
        return None
    return list(map(int, groups)) if groups.any() else "all"


def _groups(where: str, text: SourceText, points: int) -> Groups | None:
    if text.groups is None:
        return None
    if text.groups == "all":
        return everywhere(points)
    if len(text.groups) != points or not all(0 <= group < points for group in text.groups):
        raise DataFileError(f'{where}: the groups of "{text.name}" are not one of each point; export it again.')
    return np.array(text.groups, dtype=np.intp)


def _part(where: str, text: SourceText) -> str:
    if text.part not in PARTS:
        raise DataFileError(f'{where}: "{text.part}" is no part of a budget; it must be one of {", ".join(PARTS)}.')
    return text.part
