"""A dataset that this program wrote to a file, read back as what it was."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from goniometer.datasets.dataset import Dataset
from goniometer.files.dataset_hdf5 import MAGIC, dataset_from_hdf5
from goniometer.files.dataset_table import FIRST_LINE, PARQUET_MAGIC, dataset_from_csv, dataset_from_parquet
from goniometer.files.measured_table import as_text

Reader = Callable[[str, bytes], Dataset]

_READERS: tuple[tuple[bytes, str, Reader], ...] = (
    (MAGIC, "HDF5", dataset_from_hdf5),
    (PARQUET_MAGIC, "Parquet", dataset_from_parquet),
    (FIRST_LINE.encode(), "CSV", lambda where, content: dataset_from_csv(where, as_text(where, content))),
)


def reloaded(path: Path, content: bytes) -> Dataset | None:
    """The dataset of a file of this program; None where the content is not of one.

    It is equal to the one that was written, in every number, flag, check and line of its lineage, which says in
    addition, under "reloaded", from which files it was read, oldest first. Raises `DataFileError` for a file that is
    damaged or was changed, and `InputError` where a library is missing.
    """
    for magic, name, read in _READERS:
        if content.startswith(magic):
            dataset = read(str(path), content)
            here = {"file": path.name, "sha256": hashlib.sha256(content).hexdigest(), "format": name}
            return replace(dataset, lineage=dataset.lineage | {"reloaded": [*_files(dataset.lineage), here]})
    return None


def last_file(lineage: dict[str, object]) -> str:
    """Name of the file from which a dataset was last reloaded; empty where it never was."""
    return next((str(each["file"]) for each in reversed(_files(lineage))), "")


def _files(lineage: dict[str, object]) -> list[dict[str, str]]:
    found = lineage.get("reloaded", [])
    return found if isinstance(found, list) else []
