"""The formats in which a dataset leaves the house: one table of functions.

A format is one row of `FORMATS`: what it holds, the ending of its file, who writes it, and which options it knows.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

from api.derive import Export
from api.products import usual_path, write_fits, write_mitsuba
from goniometer.errors import InputError
from goniometer.store import Store


@dataclass(frozen=True)
class Options:
    """What a person may say of an export; each format knows some of it."""


@dataclass(frozen=True)
class Format:
    """How a dataset is written in one format."""

    about: str
    """What the file holds, for the help of the command."""
    ending: str
    """Of the file, without a dot."""
    write: Callable[[Store, int, Path, Options], Export]
    """Writes the dataset of an id to a path."""
    uses: tuple[str, ...] = ()
    """Names of the `Options` that it knows; another one is refused."""


FORMATS: dict[str, Format] = {
    "json": Format("all fits", "json", lambda store, dataset_id, path, _: write_fits(store, dataset_id, path)),
    "mitsuba": Format(
        "a .bsdf file for Mitsuba 3",
        "bsdf",
        lambda store, dataset_id, path, _: write_mitsuba(store, dataset_id, path),
    ),
}
"""By the name that `goniometer export --to` takes."""


def export_dataset(
    store: Store, dataset_id: int, to: str, path: Path | None = None, options: Options = Options()
) -> Export:
    """Write a dataset in the format `to` to `path` or the present folder, and note that in the database.

    Raises `InputError` for an unknown format, and for options that it has no use for.
    """
    wanted = FORMATS.get(to)
    if wanted is None:
        raise InputError(f'There is no format "{to}"; there are {", ".join(FORMATS)}.')
    said = [each.name for each in fields(options) if getattr(options, each.name) != each.default]
    if needless := [name for name in said if name not in wanted.uses]:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in needless)
        raise InputError(f"An export to {to} has no use for {names}; leave it out.")
    export = wanted.write(store, dataset_id, path or usual_path(store.dataset(dataset_id), wanted.ending), options)
    store.add_export(dataset_id, export.path, export.file_format, export.sha256)
    return export
