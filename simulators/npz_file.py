"""NumPy's .npz files that somebody else may have made: nothing in them runs, and no small one becomes a large one."""

import io
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 8 * 16384 * 16384
"""Bytes that a file may hold, packed or unpacked; more than any map of heights or table of a material."""

_HEADERS = 65536
"""Bytes of what stands beside the numbers."""


def read_bytes(path: Path) -> bytes:
    """Content of a file; raises `OSError`, and `ValueError` where it is larger than `LARGEST`."""
    with path.open("rb") as file:
        content = file.read(LARGEST + _HEADERS + 1)
    if len(content) > LARGEST + _HEADERS:
        raise ValueError(f"it is larger than {LARGEST / 1e9:.1f} GB")
    return content


def read_npz(content: bytes, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """The named arrays of a file's content.

    Raises `ValueError` where it holds more than `LARGEST`, and whatever NumPy and zipfile raise for what is none.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if sum(part.file_size for part in archive.infolist()) > LARGEST + _HEADERS:
            raise ValueError(f"it unpacks to more than {LARGEST / 1e9:.1f} GB")
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in names}
    if odd := [name for name, part in found.items() if not isinstance(part, np.ndarray)]:
        raise ValueError(f"{odd[0]} is no array")
    return found
