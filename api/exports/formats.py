"""The formats in which a dataset leaves the house: one table of functions.

A format is one row of `FORMATS`: what it holds, the ending of its file, who writes it, and which options it knows.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

from analysis.bsdf.search import Budget
from api.exports.bluesky import bluesky_lines
from api.exports.package import write_package
from api.exports.texts import check_terms
from api.results.products import check_place, usual_path, write_fits, write_mitsuba
from api.results.render import write_plugin_scene
from api.written import Export, write_bytes, write_text
from goniometer.datasets.dataset import Dataset
from goniometer.errors import InputError, OptionError
from goniometer.files.bird_json import bird_json
from goniometer.files.bird_metadata import bird_metadata, read_about
from goniometer.files.dataset_hdf5 import dataset_to_hdf5, raw_of
from goniometer.files.dataset_table import dataset_to_csv, dataset_to_parquet
from goniometer.files.published_json import published_json
from goniometer.storage.store import Store


@dataclass(frozen=True)
class Options:
    """What a person may say of an export; each format knows some of it."""

    raw: bool = False
    """Whether all raw exposures are written as well."""
    license: str | None = None
    """SPDX identifier, one of `api.exports.texts.LICENSES`."""
    creators: tuple[str, ...] = ()
    """Who made the data, "Family, Given" or an organisation."""
    attached: tuple[Path, ...] = ()
    """Files that belong to the sample: photographs, a topography."""
    about: Path | None = None
    """YAML or JSON file that says what no database knows, see `goniometer.files.bird_metadata`."""
    model: str | None = None
    """Name of the fitted model."""
    budget: float = Budget.error
    """Relative error of a table that 99 of 100 directions keep."""
    colour_budget: float = Budget.colour
    """The same of its CIEDE2000."""


Write = Callable[[Store, int, Path, Options], Export]


@dataclass(frozen=True)
class Format:
    """How a dataset is written in one format."""

    ending: str
    """Of the file, without a dot."""
    write: Write
    """Writes the dataset of an id to a path."""
    uses: tuple[str, ...] = ()
    """Names of the `Options` that it knows; another one is refused."""


def _text(name: str, make: Callable[[Dataset], str]) -> Write:
    """Writes the text that `make` gives of the dataset alone."""
    return lambda store, dataset_id, path, _: write_text(name, path, make(store.dataset(dataset_id)))


def _content(name: str, make: Callable[[Dataset], bytes]) -> Write:
    """Writes the content that `make` gives of the dataset alone."""
    return lambda store, dataset_id, path, _: write_bytes(name, path, make(store.dataset(dataset_id)))


def _write_hdf5(store: Store, dataset_id: int, path: Path, options: Options) -> Export:
    raw = raw_of(store, dataset_id) if options.raw else None
    return write_bytes("hdf5", path, dataset_to_hdf5(store.dataset(dataset_id), raw))


def _write_paper(store: Store, dataset_id: int, path: Path, _: Options) -> Export:
    text, notes = published_json(store.dataset(dataset_id))
    return replace(write_text("paper", path, text), notes=tuple(notes))


def _write_bird(store: Store, dataset_id: int, path: Path, options: Options) -> Export:
    said = {} if options.about is None else read_about(options.about)
    metadata, unsaid = bird_metadata(store, dataset_id, said)
    text, notes = bird_json(store.dataset(dataset_id), metadata)
    return replace(write_text("bird", path, text), notes=(*notes, *unsaid))


def _write_package(store: Store, dataset_id: int, path: Path, options: Options) -> Export:
    terms = package_terms(options.license, options.creators)
    said = {} if options.about is None else read_about(options.about)
    return write_package(store, dataset_id, path, terms, said, options.attached)


def package_terms(license_: str | None, creators: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """The terms of a package; raises `InputError` where one is missing or cannot be."""
    if license_ is None or not creators:
        told = 'A package needs terms; state {license}, e.g. CC-BY-4.0, and {creators} "Family, Given" for everybody.'
        raise OptionError(told, "license", **_CALLED)
    check_terms(license_, creators)
    return license_, creators


def _write_mitsuba(store: Store, dataset_id: int, path: Path, options: Options) -> Export:
    return write_mitsuba(store, dataset_id, path, options.model, Budget(options.budget, options.colour_budget))


FORMATS: dict[str, Format] = {
    "json": Format("json", lambda store, dataset_id, path, _: write_fits(store, dataset_id, path)),
    "hdf5": Format("h5", _write_hdf5, ("raw",)),
    "csv": Format("csv", _text("csv", dataset_to_csv)),
    "parquet": Format("parquet", _content("parquet", dataset_to_parquet)),
    "paper": Format("json", _write_paper),
    "bird": Format("brdf", _write_bird, ("about",)),
    "bluesky": Format(
        "jsonl",
        lambda store, dataset_id, path, _: write_text("bluesky", path, bluesky_lines(store, dataset_id)),
    ),
    "package": Format(
        "zip",
        _write_package,
        ("license", "creators", "attached", "about"),
    ),
    "mitsuba": Format(
        "bsdf",
        _write_mitsuba,
        ("model", "budget", "colour_budget"),
    ),
    "mitsuba-plugin": Format(
        "xml",
        lambda store, dataset_id, path, options: write_plugin_scene(store, dataset_id, path, options.model),
        ("model",),
    ),
}
"""By the name that `goniometer export --to` takes."""


_CALLED = {"creators": "--creator", "attached": "--attach"}
"""Option of the command where it is not called as the field."""


def export_dataset(
    store: Store, dataset_id: int, to: str, path: Path | None = None, options: Options = Options()
) -> Export:
    """Write a dataset in the format `to` to `path` or the present folder, and note that in the database.

    Raises `InputError` for an unknown format, for options that it has no use for, and rather than replace another file.
    """
    wanted = FORMATS.get(to)
    if wanted is None:
        raise InputError(f'There is no format "{to}"; there are {", ".join(FORMATS)}.')
    said = [each.name for each in fields(options) if getattr(options, each.name) != each.default]
    if needless := [name for name in said if name not in wanted.uses]:
        names = ", ".join(f"{{{name}}}" for name in needless)
        raise OptionError(f"An export to {to} has no use for {names}; leave it out.", *needless, **_CALLED)
    path = path or usual_path(store.dataset(dataset_id), wanted.ending)
    check_place(store, dataset_id, to, path)
    export = wanted.write(store, dataset_id, path, options)
    store.add_export(dataset_id, export.path, export.file_format, export.sha256)
    return export
