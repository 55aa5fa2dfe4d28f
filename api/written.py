"""Files of results: each is written whole or not at all, and says what it is."""

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from analysis.errors import ExportError
from goniometer.errors import StoreFull


@dataclass(frozen=True)
class Export:
    """A file that was written."""

    file_format: str
    """"json", "mitsuba", "report", "material", ..."""
    path: Path
    sha256: str
    notes: tuple[str, ...] = ()
    """What a person should know of it, whole sentences."""
    facts: dict[str, object] = field(default_factory=dict)
    """The same for a program, by name."""


def write_text(file_format: str, path: Path, text: str) -> Export:
    """Write a text."""
    return write_file(file_format, path, lambda part: part.write_text(text, encoding="utf-8"))


def write_bytes(file_format: str, path: Path, content: bytes) -> Export:
    """Write a content."""
    return write_file(file_format, path, lambda part: part.write_bytes(content))


def slug(sample: str) -> str:
    """A file name for a sample or a campaign: its letters and digits in lower case, joined by hyphens."""
    return re.sub(r"[\W_]+", "-", sample.lower()).strip("-") or "sample"


def make_folder(folder: Path) -> None:
    """Make a folder for results; raises `StoreFull` where the disk refuses."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreFull(f"{folder} cannot be made: {error.strerror}; make room or name another folder.") from error


def write_file(file_format: str, path: Path, write: Callable[[Path], object]) -> Export:
    """Let `write` fill a file beside `path` and put it in place in one step, so that no half file is ever seen."""
    path = path.resolve()
    part = path.with_name(path.name + ".part")
    try:
        write(part)
        os.replace(part, path)
        content = path.read_bytes()
    except (OSError, ExportError) as error:
        part.unlink(missing_ok=True)
        reason = error.strerror if isinstance(error, OSError) else str(error).rstrip(".")
        raise StoreFull(f"{path} cannot be written ({reason}); make room there or name another place.") from error
    return Export(file_format, path, hashlib.sha256(content).hexdigest())
