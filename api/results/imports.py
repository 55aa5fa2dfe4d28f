"""Import of data that somebody else measured: which reader a file needs, and what must be said with it."""

import hashlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

from goniometer.certificates.certificate_file import parse_certificate, read_certificate
from goniometer.choices import Quantity
from goniometer.datasets.dataset import Dataset
from goniometer.errors import DataFileError, OptionError
from goniometer.files.bird_json import parsed_json, read_bird_json
from goniometer.files.dataset_file import reloaded
from goniometer.files.delimited import Meaning, read_delimited
from goniometer.files.imported import Stated, imported_dataset
from goniometer.files.measured_table import MeasuredTable, as_text, read_content, read_text, tidied
from goniometer.files.published_json import read_published_json
from goniometer.files.raw_text import RawText, looks_like_raw_text, ratio_to_reference, read_raw_text, within
from goniometer.wording import check_name

FileFormat = Literal["published JSON", "BiRD JSON", "raw text", "table"]


@dataclass(frozen=True)
class Request:
    """What a person says of a file; None is what was not said."""

    path: Path
    sample: str | None = None
    """None for the name that the file states, or else that of the file."""
    relative_uncertainty: float | None = None
    relative_noise: float | None = None
    aperture: float | None = None
    angle_uncertainty: float | None = None
    lowest: float = 0.0
    highest: float = float("inf")
    quantity: Quantity | None = None
    angles: Literal["deg", "rad"] | None = None
    wavelengths: Literal["nm", "um"] | None = None
    reference: Path | None = None
    certificate: Path | None = None
    darks: Path | None = None
    dark_subtracted: bool = False
    saturation: float | None = None


_ZIP = b"PK\x03\x04"
_OF_TABLE = ("quantity", "angles", "wavelengths")
_OF_RAW = ("reference", "certificate", "darks", "dark_subtracted", "saturation")


def imported_file(asked: Request) -> Dataset:
    """The dataset that a file becomes; it belongs into a database as one of no scan.

    A file that this program wrote becomes the dataset that it was written from.
    Raises `InputError`, of which `DataFileError` and `CertificateError` are two, with one sentence: what cannot be
    meant, or which options are missing.
    """
    content = read_content(asked.path)
    if content.startswith(_ZIP):
        raise DataFileError(f"{asked.path}: is a zip file; unpack it and import the file that it is about.")
    own = reloaded(asked.path, content)
    if own is not None:
        _check_nothing_said(asked)
        return own
    text = as_text(str(asked.path), content)
    kind = file_format(text)
    _check_options(asked, kind)
    lineage: dict[str, object] = {
        "imported": asked.path.name,
        "imported_sha256": hashlib.sha256(content).hexdigest(),
        "imported_format": kind,
    }
    table, notes, more = _read(asked, kind, text)
    table, tidying = tidied(str(asked.path), table, asked.lowest, asked.highest)
    if (table.u is None) == (asked.relative_uncertainty is None):
        told = (
            "states no uncertainty; say with {relative_uncertainty} what part of a value is uncertain."
            if table.u is None
            else "states the uncertainty of every value itself; leave out {relative_uncertainty}."
        )
        raise OptionError(f"{asked.path}: {told}", "relative_uncertainty")
    assert asked.aperture is not None  # as is what follows, checked with the options
    assert asked.angle_uncertainty is not None
    stated = Stated(asked.relative_uncertainty, asked.relative_noise, asked.aperture, asked.angle_uncertainty)
    lineage |= more | {"notes": [*notes, *tidying]}
    try:
        sample = check_name(asked.sample or _name_in_file(more) or asked.path.stem)
    except ValueError as error:
        raise DataFileError(f"{asked.path}: {error}; say with --sample what the sample is called.") from None
    return imported_dataset(sample, table, stated, lineage)


def file_format(text: str) -> FileFormat:
    """Which reader a text is for, by how it begins."""
    begin = text.lstrip()[:1]
    if begin in {"[", "{"}:
        return "published JSON" if begin == "[" else "BiRD JSON"
    return "raw text" if looks_like_raw_text(text) else "table"


def _name_in_file(lineage: dict[str, object]) -> str:
    """What a universal BRDF file calls its sample; empty where it says nothing."""
    told = lineage.get("bird")
    sample = told.get("sample") if isinstance(told, dict) else None
    name = sample.get("name") if isinstance(sample, dict) else None
    return name.strip() if isinstance(name, str) else ""


def _check_nothing_said(asked: Request) -> None:
    """Raise `OptionError` for anything that was said of a file that says everything itself."""
    said = [each.name for each in fields(asked) if each.name != "path" and getattr(asked, each.name) != each.default]
    if said:
        raise OptionError(
            f"{asked.path}: was written by this program and says everything itself; leave out {_options(said)}.", *said
        )


def _check_options(asked: Request, kind: FileFormat) -> None:
    """Raise `OptionError` for options that this kind of file lacks, and for those that it has no use for."""
    missing = [name for name in ("aperture", "angle_uncertainty") if getattr(asked, name) is None]
    if kind == "table":
        missing += [name for name in _OF_TABLE if getattr(asked, name) is None]
    if kind == "raw text":
        missing += [name for name in ("reference", "certificate", "saturation") if getattr(asked, name) is None]
        if (asked.darks is None) != asked.dark_subtracted:
            raise OptionError(
                f"{asked.path}: holds raw counts; name either dark spectra with {{darks}}, or say with "
                f"{{dark_subtracted}} that the instrument took them off.",
                "darks",
                "dark_subtracted",
            )
    if missing:
        raise OptionError(
            f"{asked.path}: is read as {_AS[kind]}, which does not say everything; state {_options(missing)} as well.",
            *missing,
        )
    needless = [name for name in (*_OF_TABLE, *_OF_RAW) if getattr(asked, name) not in {None, False}]
    needless = [name for name in needless if name not in _USED[kind]]
    if needless:
        raise OptionError(
            f"{asked.path}: is read as {_AS[kind]}, which has no use for {_options(needless)}; leave it out.", *needless
        )


_AS = {
    "published JSON": "JSON of points",
    "BiRD JSON": "universal BRDF JSON",
    "raw text": "raw text of a goniometer",
    "table": "a table",
}
_USED: dict[FileFormat, tuple[str, ...]] = {
    "published JSON": (),
    "BiRD JSON": (),
    "raw text": _OF_RAW,
    "table": _OF_TABLE,
}


def _options(names: list[str]) -> str:
    return ", ".join(f"{{{name}}}" for name in names)


def _read(asked: Request, kind: FileFormat, text: str) -> tuple[MeasuredTable, list[str], dict[str, object]]:
    """The table of a file, sentences about it, and what belongs into the lineage."""
    path = str(asked.path)
    if kind == "published JSON":
        table, notes = read_published_json(path, text)
        return table, notes, {}
    if kind == "BiRD JSON":
        return read_bird_json(path, parsed_json(path, text))
    if kind == "table":
        assert asked.quantity is not None  # as is what follows, checked with the options
        assert asked.angles is not None
        assert asked.wavelengths is not None
        table = read_delimited(path, text, Meaning(asked.quantity, asked.angles, asked.wavelengths))
        return table, [], {"stated_meaning": {name: getattr(asked, name) for name in _OF_TABLE}}
    assert asked.reference is not None
    assert asked.certificate is not None
    assert asked.saturation is not None
    written = read_certificate(asked.certificate)
    panel = parse_certificate(written, str(asked.certificate))
    raw = within(read_raw_text(path, text), asked.lowest, asked.highest)
    reference, of_reference = _raw(asked.reference, asked)
    darks, of_darks = (None, {}) if asked.darks is None else _raw(asked.darks, asked)
    table, notes = ratio_to_reference(raw, reference, panel, darks, asked.saturation)
    notes.append("The raw text has no date, so nobody knows whether the certificate was valid on the day.")
    return (
        table,
        notes,
        {
            "reference": of_reference,
            "darks": of_darks or "subtracted by the instrument, as stated",
            "certificate": panel.serial_number,
            "certificate_sha256": hashlib.sha256(written.encode()).hexdigest(),
            "certificate_valid_until": None if panel.valid_until is None else panel.valid_until.isoformat(),
            "saturation_counts": asked.saturation,
        },
    )


def _raw(path: Path, asked: Request) -> tuple[RawText, dict[str, str]]:
    text, content = read_text(path)
    found = {"file": path.name, "sha256": hashlib.sha256(content).hexdigest()}
    return within(read_raw_text(str(path), text), asked.lowest, asked.highest), found
