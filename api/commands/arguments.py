"""What the commands of the command line have in common: their arguments, and how they answer."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.terminal import stderr
from goniometer.errors import InputError

if TYPE_CHECKING:
    from api.settings import InstrumentSettings
    from api.written import Export
    from goniometer.storage.store import Store

DatasetName = Annotated[str, typer.Argument(help="Number of a dataset, or name of a sample.", show_default=False)]
DatabaseFile = Annotated[
    str,
    typer.Option(
        "--database", "-d", metavar="FILE|URL", help="SQLite file of the measurements, or postgresql://user@host/name."
    ),
]
BenchName = Annotated[
    str | None, typer.Option("--bench", help="Name of the bench, where several use one database.", show_default=False)
]
Page = Annotated[Path | None, typer.Option("--page", help="HTML page with the figures to write.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
DATABASE = "goniometer.db"


def chosen_dataset(store: Store, name: str) -> int:
    """Id of the dataset `name`; of several of one sample the newest, which is said on stderr. Raises `NotInStore`."""
    from api.datasets import dataset_names, find_datasets

    *others, newest = find_datasets(store, name)
    if others:
        known = f"{', '.join(map(str, others))} and {newest}"
        sample, own = dataset_names(store, newest)
        meant = own if name.lower() == own.lower() else sample
        told = f"{meant} has datasets {known}; taking {newest}, name a number"
        stderr().print(f"{told} for another.", markup=False, highlight=False, soft_wrap=True)
    return newest


def emit(content: dict[str, Any]) -> None:
    """Print one JSON object on stdout, strict as the files are."""
    from analysis.strict_json import strict_json

    text = strict_json(content)
    try:
        text.encode(sys.stdout.encoding)
    except UnicodeEncodeError:
        text = json.dumps(json.loads(text), indent=1) + "\n"  # in which what is no ASCII is escaped
    sys.stdout.write(text)


def write_page(path: Path, title: str, body: list[str]) -> Export:
    """Write a self-contained page of chapters of HTML, in the style of reports, under its title."""
    from analysis.figures.page import titled_page
    from api.written import make_folder, write_text

    make_folder(path.resolve().parent)
    return write_text("page", path, titled_page(title, body))


def bench_of(named: str | None, settings: InstrumentSettings | None) -> str:
    """The bench that is meant: the one that is `named`, else that of the instrument file."""
    from goniometer.storage.tables import BENCH

    return named or (BENCH if settings is None else settings.bench)


def existing(database: str, bench: str | None = None) -> Store:
    """The database, which must be there: a command that only reads makes no empty one.

    Where it matters which bench is to be run, that is `bench`.
    """
    from goniometer.storage.store import Store
    from goniometer.storage.tables import BENCH

    if _is_missing(database):
        raise InputError(f"There is no database {database}; name one with --database, or start with: goniometer run.")
    return Store.open(database, bench or BENCH)


def opened(database: str) -> Store:
    """The database, which is made where it is not there; that is said on stderr, for its name may be misspelt."""
    from goniometer.storage.store import Store

    new = _is_missing(database)
    store = Store.open(database)
    if new:
        stderr().print(f"{store.where} was not there and has been made.", markup=False, highlight=False, soft_wrap=True)
    return store


def _is_missing(database: str) -> bool:
    """Whether it is a file, and not there."""
    return "://" not in database and not Path(database).exists()
