"""Files that somebody has sent to the service, until a job reads them."""

import re
import secrets
from pathlib import Path

from api.written import make_folder
from goniometer.errors import InputError, NotInStore

LARGEST = 128 << 20
"""Bytes of a file that is taken."""
MOST = 50
"""Uploads that are kept; the oldest go."""

_TOKEN = re.compile(r"[0-9a-f]{32}")
_NAME = re.compile(r"[\w][\w .()+-]{0,119}")

_LONGEST = 240
"""Bytes of a name; file systems take 255."""


def new_upload(output: Path, name: str) -> tuple[str, Path]:
    """A token, and the file to write what is sent as `name` into; raises `InputError` for a name that is none.

    `output` is the folder of the results of the service.
    """
    if not _NAME.fullmatch(name) or len(name.encode()) > _LONGEST:
        raise InputError(
            f'name: "{name[:60]}" is no plain file name; give one of letters, digits, spaces and . _ - + ( ), '
            f"at most 120 and {_LONGEST} bytes, that begins with a letter or a digit"
        )
    folder = _folder(output)
    make_folder(folder)
    known = sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime)
    for old in known[: max(len(known) - MOST + 1, 0)]:
        for file in old.iterdir():
            file.unlink(missing_ok=True)
        old.rmdir()
    token = secrets.token_hex(16)
    make_folder(folder / token)
    return token, folder / token / name


def uploaded(output: Path, token: str) -> Path:
    """The file of an upload; raises `NotInStore`."""
    folder = _folder(output) / token
    if not _TOKEN.fullmatch(token) or not folder.is_dir():
        raise NotInStore(f'There is no upload "{token[:40]}"; send the file to POST /api/uploads first')
    return next(folder.iterdir())


def called_as_sent(output: Path, told: str) -> str:
    """What is told of uploads, each by the name under which it was sent and not by where it lies."""
    return re.sub(re.escape(f"{_folder(output)}/") + f"{_TOKEN.pattern}/", "", told)


def _folder(output: Path) -> Path:
    return output / "uploads"
