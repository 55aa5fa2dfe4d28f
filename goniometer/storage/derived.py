"""What is made from raw data, in the database: datasets, fits, exports, and characterisations of the bench.

These rows are only ever added, each as one committed transaction that is on the disk when the method returns.
"""

import json
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sqlalchemy import Row, func, select

from goniometer.datasets.dataset import Dataset
from goniometer.storage import tables
from goniometer.storage.catalogue import Catalogue, facts_of
from goniometer.storage.database import insert_row
from goniometer.storage.records import Characterisation, StoredText, now, pack_dataset, to_dataset


@cache  # the metadata of a package is a long text, and every answer about a dataset names the version
def software_version() -> str:
    """Version of this program, as written beside everything derived."""
    return version("goniometer")


@dataclass(frozen=True)
class ExportRow:
    """A file that was written from a dataset."""

    id: int
    dataset_id: int
    path: str
    format: str
    sha256: str
    """Of what was written."""
    created: str
    """ISO 8601 in UTC."""


def _export(row: Row[Any]) -> ExportRow:
    return ExportRow(**row._mapping)


class Derived(Catalogue):
    """The part of an open database that holds what was derived; `goniometer.storage.store.Store` is the whole."""

    def add_dataset(self, scan_id: int | None, dataset: Dataset, certificate: str | None = None) -> int:
        """Write a dataset and return its id; one that was imported or simulated has no scan.

        `certificate` is the text of that it was calibrated with, None for that of its campaign.
        """
        with self.writing() as connection:
            return insert_row(
                connection,
                tables.datasets,
                scan_id=scan_id,
                **facts_of(dataset),
                checks=json.dumps([asdict(check) for check in dataset.checks]),
                certificate=certificate,
                lineage=json.dumps(dataset.lineage, sort_keys=True),
                arrays=pack_dataset(dataset),
                software_version=software_version(),
                created=now(),
            )

    def dataset(self, dataset_id: int) -> Dataset:
        """A dataset, bit for bit as it was written; raises `NotInStore`, and `StoreError` where it is damaged."""
        row = self.row(select(tables.datasets).where(tables.datasets.c.id == dataset_id), f"dataset {dataset_id}")
        return to_dataset(row)

    def lineage(self, dataset_id: int) -> dict[str, object]:
        """What a dataset was derived from, without its numbers; raises `NotInStore`."""
        query = select(tables.datasets.c.lineage).where(tables.datasets.c.id == dataset_id)
        lineage: dict[str, object] = json.loads(self.row(query, f"dataset {dataset_id}").lineage)
        return lineage

    def without_scan(self, limit: int) -> tuple[dict[int, str], int]:
        """The newest `limit` datasets that no scan of this database made, samples by id, and how many there are."""
        here = tables.datasets.c
        alone = here.scan_id.is_(None)
        rows = self.rows(select(here.id, here.sample).where(alone).order_by(here.id.desc()).limit(limit))
        count = self.rows(select(func.count().label("datasets")).select_from(tables.datasets).where(alone))[0].datasets
        return {row.id: row.sample for row in reversed(rows)}, int(count)

    def dataset_created(self, dataset_id: int) -> str:
        """When a dataset was written, ISO 8601 in UTC; raises `NotInStore`."""
        query = select(tables.datasets.c.created).where(tables.datasets.c.id == dataset_id)
        return str(self.row(query, f"dataset {dataset_id}").created)

    def dataset_certificate(self, dataset_id: int) -> str | None:
        """Text of the certificate of a dataset, None where it is that of its campaign; raises `NotInStore`."""
        query = select(tables.datasets.c.certificate).where(tables.datasets.c.id == dataset_id)
        text: str | None = self.row(query, f"dataset {dataset_id}").certificate
        return text

    def datasets(self, scan_id: int | None = None) -> dict[int, int | None]:
        """Scan id of every dataset (of one scan) by its id, oldest first; None where it was imported or simulated."""
        table = tables.datasets
        query = select(table.c.id, table.c.scan_id).order_by(table.c.id)
        if scan_id is not None:
            query = query.where(table.c.scan_id == scan_id)
        return {row.id: row.scan_id for row in self.rows(query)}

    def add_fit(self, dataset_id: int, model: str, text: str) -> int:
        """Write a fit of a dataset as JSON and return its id."""
        with self.writing() as connection:
            return insert_row(
                connection,
                tables.fits,
                dataset_id=dataset_id,
                model=model,
                json=text,
                software_version=software_version(),
                created=now(),
            )

    def fits(self, dataset_id: int) -> list[StoredText]:
        """All fits of a dataset, oldest first."""
        query = select(tables.fits).where(tables.fits.c.dataset_id == dataset_id).order_by(tables.fits.c.id)
        return [StoredText(row.id, row.dataset_id, row.model, row.json) for row in self.rows(query)]

    def newest_fit(self, dataset_id: int) -> int:
        """Id of the newest fit of a dataset; 0 where it has none."""
        query = select(func.max(tables.fits.c.id).label("id")).where(tables.fits.c.dataset_id == dataset_id)
        return int(self.rows(query)[0].id or 0)

    def has_export(self, dataset_id: int, path: Path, file_format: str, sha256: str) -> bool:
        """Whether that content was written to `path` as an export of a dataset in a format."""
        here = tables.exports.c
        wanted = select(here.id).where(
            here.dataset_id == dataset_id,
            here.path == str(path),
            here.format == file_format,
            here.sha256 == sha256,
        )
        return bool(self.rows(wanted.limit(1)))

    def add_export(self, dataset_id: int, path: Path, file_format: str, sha256: str) -> int:
        """Note that a file was written from a dataset; returns the export's id."""
        with self.writing() as connection:
            return insert_row(
                connection,
                tables.exports,
                dataset_id=dataset_id,
                path=str(path),
                format=file_format,
                sha256=sha256,
                created=now(),
            )

    def exports(self, dataset_id: int) -> list[StoredText]:
        """All files written from a dataset, oldest first."""
        query = select(tables.exports).where(tables.exports.c.dataset_id == dataset_id).order_by(tables.exports.c.id)
        return [StoredText(row.id, row.dataset_id, row.format, row.path) for row in self.rows(query)]

    def fit(self, fit_id: int) -> StoredText:
        """One fit; raises `NotInStore`."""
        row = self.row(select(tables.fits).where(tables.fits.c.id == fit_id), f"fit {fit_id}")
        return StoredText(row.id, row.dataset_id, row.model, row.json)

    def export(self, export_id: int) -> ExportRow:
        """One file that was written; raises `NotInStore`."""
        return _export(self.row(select(tables.exports).where(tables.exports.c.id == export_id), f"export {export_id}"))

    def export_rows(self, dataset_id: int) -> list[ExportRow]:
        """All files written from a dataset with all that is known of them, oldest first."""
        query = select(tables.exports).where(tables.exports.c.dataset_id == dataset_id).order_by(tables.exports.c.id)
        return [_export(row) for row in self.rows(query)]

    # The bench itself

    def add_characterisation(self, kind: str, text: str) -> int:
        """Write what was measured of the bench itself, as JSON, and return its id."""
        with self.writing() as connection:
            return insert_row(
                connection,
                tables.characterisations,
                bench=self.bench,
                kind=kind,
                json=text,
                software_version=software_version(),
                created=now(),
            )

    def characterisations(self, kind: str | None = None) -> list[Characterisation]:
        """What was measured of the bench itself (of one kind), oldest first."""
        table = tables.characterisations
        query = select(table).order_by(table.c.id)
        if kind is not None:
            query = query.where(table.c.kind == kind)
        return [Characterisation(row.id, row.kind, row.json, row.created, row.bench) for row in self.rows(query)]
