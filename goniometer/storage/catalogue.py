"""Which datasets there are in the database, told without reading their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from sqlalchemy import CompoundSelect, Row, ScalarSelect, Select, func, select

from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset, Flag, Kind
from goniometer.storage import tables
from goniometer.storage.database import Database
from goniometer.storage.service_tables import queue

Order = Literal["newest", "oldest"]


@dataclass(frozen=True)
class Entry:
    """A dataset as a list shows it."""

    id: int
    scan_id: int | None
    """None where it was imported, simulated, or measured elsewhere."""
    sample: str
    """Its name, with the number of the repeat where a campaign measured it several times."""
    kind: Kind
    points: int
    incident_angles: int
    shortest: float
    """Wavelength, nm."""
    longest: float
    """Wavelength, nm."""
    flags: int
    """All flags that occur, a sum of `Flag`."""
    flagged: int
    """Points with any flag."""
    checks_failed: int
    recalibrated_from: int | None
    """The dataset of the same raw data that it was made anew from."""
    content_hash: str
    """SHA-256 of its numbers."""
    software_version: str
    created: str
    """ISO 8601 in UTC."""
    campaign_id: int | None
    campaign: str | None
    """Name of the campaign."""
    bench: str | None
    """Name of the bench; None where no campaign measured it."""
    operator: str | None
    """Who put the campaign into the queue of a service; None where no service measured it."""


@dataclass(frozen=True)
class Wanted:
    """Which datasets are asked for; None asks for any."""

    sample: str | None = None
    """Name of the sample, with or without the number of the repeat, whatever the case of its letters."""
    campaign_id: int | None = None
    kind: Kind | None = None
    flag: Flag | None = None
    """Those with at least one point of this flag."""
    since: str | None = None
    """ISO 8601 in UTC: made then or later."""
    until: str | None = None
    """Made before."""
    operator: str | None = None
    """Who put its campaign into the queue."""
    passed: bool | None = None
    """Those whose checks all passed, or those of which any failed."""


def facts_of(dataset: Dataset) -> dict[str, object]:
    """What the table of datasets tells of one beside its numbers."""
    source = dataset.lineage.get("recalibrated_from")
    return {
        "sample": dataset.sample,
        "kind": dataset.kind,
        "points": dataset.theta_in.size,
        "incident_angles": int(incidence_groups(dataset.theta_in, SAME_INCIDENCE).max(initial=-1)) + 1,
        "shortest": float(dataset.wavelengths[0]),
        "longest": float(dataset.wavelengths[-1]),
        "flags": int(np.bitwise_or.reduce(dataset.flags, initial=0)),
        "flagged": int(np.count_nonzero(dataset.flags)),
        "checks_failed": sum(check.passed is False for check in dataset.checks),
        # the number of one that came from a file is of another database
        "recalibrated_from": source if isinstance(source, int) and "reloaded" not in dataset.lineage else None,
        "content_hash": dataset.content_hash,
    }


class Catalogue(Database):
    """The part of an open database that lists datasets; `goniometer.storage.store.Store` is the whole."""

    def entry(self, dataset_id: int) -> Entry:
        """One dataset; raises `NotInStore`."""
        return _entry(self.row(_entries().where(tables.datasets.c.id == dataset_id), f"dataset {dataset_id}"))

    def entries(self, wanted: Wanted, limit: int, after: int | None = None, order: Order = "newest") -> list[Entry]:
        """At most `limit` datasets that are `wanted`, from the one behind the dataset `after` on."""
        here, query = tables.datasets.c, _entries()
        if wanted.sample is not None:
            query = query.where(here.id.in_(_called(wanted.sample)))
        if wanted.campaign_id is not None:
            query = query.where(tables.scans.c.campaign_id == wanted.campaign_id)
        if wanted.kind is not None:
            query = query.where(here.kind == wanted.kind)
        if wanted.flag is not None:
            # of the index alone, for few rows have a rare flag
            having = select(here.id).where(here.flags.bitwise_and(int(wanted.flag)) != 0)
            query = query.where(here.id.in_(having))
        if wanted.since is not None:
            query = query.where(here.created >= wanted.since)
        if wanted.until is not None:
            query = query.where(here.created < wanted.until)
        if wanted.operator is not None:
            query = query.where(_operator() == wanted.operator)
        if wanted.passed is not None:
            query = query.where(here.checks_failed == 0 if wanted.passed else here.checks_failed > 0)
        newest = order == "newest"
        if after is not None:
            query = query.where(here.id < after if newest else here.id > after)
        return [_entry(row) for row in self.rows(query.order_by(here.id.desc() if newest else here.id).limit(limit))]

    def called(self, name: str) -> list[int]:
        """Ids of the datasets of a sample, oldest first, by its name as `Wanted` takes it."""
        here = tables.datasets.c
        return [row.id for row in self.rows(select(here.id).where(here.id.in_(_called(name))).order_by(here.id))]

    def scan_of(self, dataset_id: int) -> int | None:
        """Id of the scan that a dataset was made of, None of an import or a simulation; raises `NotInStore`."""
        query = select(tables.datasets.c.scan_id).where(tables.datasets.c.id == dataset_id)
        scan_id: int | None = self.row(query, f"dataset {dataset_id}").scan_id
        return scan_id

    def recalibrations(self, dataset_id: int) -> list[int]:
        """Ids of the datasets that were made anew from this one, oldest first."""
        here = tables.datasets.c
        query = select(here.id).where(here.recalibrated_from == dataset_id).order_by(here.id)
        return [row.id for row in self.rows(query)]

    def has_dataset(self, dataset_id: int) -> bool:
        """Whether there is a dataset of this id."""
        here = tables.datasets.c
        return bool(self.rows(select(here.id).where(here.id == dataset_id)))

    def newest_dataset(self) -> int:
        """Id of the newest dataset; 0 where there is none."""
        return self.rows(select(func.max(tables.datasets.c.id).label("newest")))[0].newest or 0

    def datasets_after(self, dataset_id: int) -> list[int]:
        """Ids of the datasets above `dataset_id`, oldest first."""
        here = tables.datasets.c
        return [row.id for row in self.rows(select(here.id).where(here.id > dataset_id).order_by(here.id))]

    def samples(self) -> list[str]:
        """Names of all samples that have a dataset or were asked for in a campaign, in alphabetical order."""
        alone = select(tables.datasets.c.sample).where(tables.datasets.c.scan_id.is_(None))
        measured = select(tables.scans.c.sample).where(tables.scans.c.kind == "sample")
        return sorted({row.sample for query in (alone, measured) for row in self.rows(query.distinct())})

    def of_samples(self, names: Sequence[str]) -> dict[str, tuple[int, Entry]]:
        """How many datasets these samples have, and the newest of each, by their names without number of a repeat.

        Samples without any are left out.
        """
        here, scans = tables.datasets.c, tables.scans.c
        alone = select(here.sample.label("name"), here.id).where(here.scan_id.is_(None), here.sample.in_(names))
        measured = select(scans.sample.label("name"), here.id).join(tables.scans)
        measured = measured.where(scans.kind == "sample", scans.sample.in_(names))
        all_of_them = alone.union_all(measured).subquery()
        query = select(all_of_them.c.name, func.count().label("datasets"), func.max(all_of_them.c.id).label("newest"))
        counted = {row.newest: row for row in self.rows(query.group_by(all_of_them.c.name))}
        found = [_entry(row) for row in self.rows(_entries().where(here.id.in_(counted)))]
        return {counted[entry.id].name: (int(counted[entry.id].datasets), entry) for entry in found}


def _called(name: str) -> CompoundSelect[Any]:
    """Ids of the datasets of a sample, by its name with or without the number of the repeat."""
    # two questions, for SQLite uses no index where names of two tables are joined by "or"
    here, scans = tables.datasets.c, tables.scans.c
    wanted = func.lower(name)
    own = select(here.id).where(func.lower(here.sample) == wanted)
    return own.union(select(here.id).join(tables.scans).where(func.lower(scans.sample) == wanted))


def _entries() -> Select[Any]:
    columns = [column for column in tables.datasets.c if column.name in {field.name for field in fields(Entry)}]
    of_campaign = (
        tables.scans.c.campaign_id,
        tables.campaigns.c.name.label("campaign"),
        tables.campaigns.c.bench,
        _operator().label("operator"),
    )
    joined = tables.datasets.outerjoin(tables.scans).outerjoin(tables.campaigns)
    return select(*columns, *of_campaign).select_from(joined)


def _operator() -> ScalarSelect[Any]:
    """Who ordered the campaign of a dataset last."""
    here = queue.c
    mine = select(here.who).where(here.campaign_id == tables.scans.c.campaign_id)
    return mine.order_by(here.id.desc()).limit(1).correlate(tables.scans).scalar_subquery()


def _entry(row: Row[Any]) -> Entry:
    return Entry(**{field.name: getattr(row, field.name) for field in fields(Entry)})
