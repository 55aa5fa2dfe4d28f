"""Files of results: each is written whole or not at all, and says what it is."""

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from analysis.errors import ExportError
from goniometer.errors import InputError, StoreFull

_SQLITE = b"SQLite format 3\0"
"""How a database begins."""


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
    """A file name for a sample or a campaign: its letters and digits in lower case, joined by hyphens.

    Cut to 80 bytes, for a file system counts bytes and an ending comes on top; a number at the end stays, by which
    repeats differ. Names that become the same by it are refused as others that do (`api.preflight`).
    """
    longest = 80
    whole = re.sub(r"[\W_]+", "-", sample.lower()).strip("-") or "sample"
    if len(whole.encode()) <= longest:
        return whole
    number = re.search("-[0-9]{1,9}$", whole)
    end = "" if number is None else number[0]
    return whole.encode()[: longest - len(end)].decode(errors="ignore").rstrip("-") + end


def make_folder(folder: Path) -> None:
    """Make a folder for results; raises `StoreFull` where the disk refuses."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreFull(f"{folder} cannot be made: {error.strerror}; make room or name another folder.") from error


def write_file(file_format: str, path: Path, write: Callable[[Path], object]) -> Export:
    """Let `write` fill a file beside `path` and put it in place in one step, so that no half file is ever seen.

    Raises `InputError` rather than replace a database or what is no file, and `StoreFull` where the disk refuses.
    """
    path = path.resolve()
    _refuse_to_replace(path)
    part = path.with_name(path.name + ".part")
    try:
        write(part)
        os.replace(part, path)
        content = path.read_bytes()
    except (OSError, ExportError) as error:
        part.unlink(missing_ok=True)
        cause = error.__cause__ if isinstance(error, ExportError) and isinstance(error.__cause__, OSError) else error
        reason = cause.strerror if isinstance(cause, OSError) else str(cause).rstrip(".")
        raise StoreFull(f"{path} cannot be written ({reason}); make room there or name another place.") from error
    return Export(file_format, path, hashlib.sha256(content).hexdigest())


def _refuse_to_replace(path: Path) -> None:
    """Raises `InputError` for a database, in which measurements are, and for a device or a pipe."""
    if not path.exists() or path.is_dir():  # the latter is refused by the system
        return
    if not path.is_file():
        raise InputError(f"{path} is no file; name one")
    with path.open("rb") as there:
        if there.read(len(_SQLITE)) == _SQLITE:
            raise InputError(f"{path} is a database, which nothing replaces; name another file")
