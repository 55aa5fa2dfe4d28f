"""What a year of a busy lab weighs, and how soon its database answers.

    python -m tests.benchmarks.year [DATASETS [SHARE [FOLDER]]]

10,000 datasets and 3 million spectra are written in bulk, as `tests.busy_year` says, into FOLDER, where they stay for
the next time, or into a temporary one. A SHARE of the campaigns has its numbers; of the others every row is there, but
for raw counts, arrays and fits, so that a small disk will do. Then every question is asked with other parameters each
time, through the Store and over loopback. The first table are octets. The second are milliseconds of whole answers, and
at the end of the line what this process has computed for one at 95 %, which the load of a machine does not change; and
whether the query planner reads a whole table.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import event
from typer.testing import CliRunner

from api.commands.main import app
from api.datasets import find_datasets
from api.results.certificates import known_certificates
from api.service import active_scan
from goniometer.datasets.dataset import Flag
from goniometer.errors import NotInStore
from goniometer.storage import look_up
from goniometer.storage.catalogue import Wanted
from goniometer.storage.store import Store
from tests.benchmarks.figures import tell
from tests.busy_year import BEGINNING, NAMES, SAMPLES, octets, spectra_of, write_year
from tests.served import Served, served

TIMES = 100
"""For which each question is asked."""
FEW = 10
"""The same of what takes long the first time."""
PER_CAMPAIGN = SAMPLES + 1
"""Scans."""


class _Lot:
    """Draws what a question is about."""

    def __init__(self, datasets: int, share: float) -> None:
        self.random = np.random.default_rng(7)
        self.datasets = datasets
        self.campaigns = max(1, round(0.9 * datasets / SAMPLES))
        numbers = range(1, self.campaigns + 1)
        self.full = [n for n in numbers if int(n * share) > int((n - 1) * share)]

    def any(self, most: int) -> int:
        return 1 + int(self.random.integers(most))

    def campaign(self) -> int:
        return self.any(self.campaigns)

    def full_campaign(self) -> int:
        return self.full[int(self.random.integers(len(self.full)))]

    def dataset(self) -> int:
        """One that can be opened."""
        return (self.full_campaign() - 1) * SAMPLES + self.any(SAMPLES)

    def scan(self) -> int:
        """One of a sample, whose raw data are there."""
        return (self.full_campaign() - 1) * PER_CAMPAIGN + 1 + self.any(SAMPLES)

    def exposure(self) -> int:
        return spectra_of(self.full_campaign() - 1) + self.any(spectra_of(1))

    def sample(self) -> str:
        return f"Sheet {1 + (SAMPLES - 1 + self.any(self.campaigns * SAMPLES)) % NAMES:04d}"

    def month(self) -> tuple[str, str]:
        month = self.any(11)
        return f"{BEGINNING.year}-{month:02d}-01", f"{BEGINNING.year}-{month + 1:02d}-01"


def through_store(store: Store, lot: _Lot) -> dict[str, Callable[[], object]]:
    """Questions to the Store."""

    def listed(after: int | None = None, **wanted: Any) -> object:
        return store.entries(Wanted(**wanted), 51, after)

    def running() -> object:
        try:
            return active_scan(store)
        except NotInStore:
            return None

    return {
        "list: newest": listed,
        "list: somewhere": lambda: listed(lot.any(lot.datasets)),
        "list: of a sample": lambda: listed(sample=lot.sample()),
        "list: of no sample": lambda: listed(sample="Nothing of that name"),
        "list: of a campaign": lambda: listed(campaign_id=lot.campaign()),
        "list: simulated": lambda: listed(kind="simulated"),
        "list: a rare flag": lambda: listed(flag=Flag.SATURATED),
        "list: a flag that nothing has": lambda: listed(flag=Flag.BEYOND_REFERENCE),
        "list: of a month": lambda: listed(**dict(zip(("since", "until"), lot.month(), strict=True))),
        "search by name": lambda: find_datasets(store, lot.sample()),
        "search by number": lambda: find_datasets(store, str(lot.any(lot.datasets))),
        "samples": store.samples,
        "entry": lambda: store.entry(lot.any(lot.datasets)),
        "dataset": lambda: store.dataset(lot.dataset()),
        "fits of a dataset": lambda: store.fits(lot.dataset()),
        "recalibrations of a dataset": lambda: store.recalibrations(lot.any(lot.datasets)),
        "scan": lambda: store.scan(lot.any(PER_CAMPAIGN * lot.campaigns)),
        "scans of a campaign": lambda: store.scans(lot.campaign()),
        "reference of a scan": lambda: store.reference_scan(lot.any(PER_CAMPAIGN * lot.campaigns)),
        "points of a scan": lambda: store.points(lot.any(PER_CAMPAIGN * lot.campaigns)),
        "raw spectra of a scan": lambda: store.exposures(lot.scan()),
        "a raw spectrum": lambda: look_up.exposure(store, lot.exposure()),
        "campaigns": store.campaigns,
        "the scan that runs": running,
        "certificates": lambda: known_certificates(store),
    }


def over_rest(lot: _Lot) -> dict[str, Callable[[], str]]:
    """Questions to the service."""
    since, until = lot.month()
    return {
        "/api/datasets": lambda: "/api/datasets",
        "/api/datasets?limit=200": lambda: "/api/datasets?limit=200",
        "/api/datasets?after=N": lambda: f"/api/datasets?after={lot.any(lot.datasets)}",
        "/api/datasets?sample=NAME": lambda: f"/api/datasets?sample={lot.sample()}",
        "/api/datasets?campaign=N": lambda: f"/api/datasets?campaign={lot.campaign()}",
        "/api/datasets?kind=imported": lambda: "/api/datasets?kind=imported",
        "/api/datasets?flag=saturated": lambda: "/api/datasets?flag=saturated",
        "/api/datasets?since=&until=": lambda: f"/api/datasets?since={since}&until={until}",
        "/api/datasets?order=oldest": lambda: "/api/datasets?order=oldest",
        "/api/datasets/N": lambda: f"/api/datasets/{lot.dataset()}",
        "/api/datasets/N/map?filled=false": lambda: f"/api/datasets/{lot.dataset()}/map?filled=false",
        "/api/datasets/N/map": lambda: f"/api/datasets/{lot.dataset()}/map",
        "/api/datasets/N/points/7": lambda: f"/api/datasets/{lot.dataset()}/points/7",
        "/api/datasets/N/lineage": lambda: f"/api/datasets/{lot.dataset()}/lineage",
        "/api/datasets/N/models": lambda: f"/api/datasets/{lot.dataset()}/models",
        "/api/datasets/N/spectra": lambda: f"/api/datasets/{lot.dataset()}/spectra",
        "/api/samples": lambda: "/api/samples",
        "/api/samples/NAME": lambda: f"/api/samples/{lot.sample()}",
        "/api/campaigns": lambda: "/api/campaigns",
        "/api/campaigns/N": lambda: f"/api/campaigns/{lot.campaign()}",
        "/api/scans": lambda: "/api/scans",
        "/api/scans?after=N": lambda: f"/api/scans?after={lot.any(PER_CAMPAIGN * lot.campaigns)}",
        "/api/scans/N": lambda: f"/api/scans/{lot.any(PER_CAMPAIGN * lot.campaigns)}",
        "/api/scans/N/points": lambda: f"/api/scans/{lot.any(PER_CAMPAIGN * lot.campaigns)}/points",
        "/api/points/N": lambda: f"/api/points/{lot.any(1000 * lot.campaigns)}",
        "/api/exposures/N": lambda: f"/api/exposures/{lot.exposure()}",
        "/api/references": lambda: "/api/references",
        "/api/certificates": lambda: "/api/certificates",
        "/api/instrument": lambda: "/api/instrument",
        "/api/queue": lambda: "/api/queue",
        "/health": lambda: "/health",
    }


def _times(ask: Callable[[], object], times: int = TIMES) -> list[tuple[float, float]]:
    """Milliseconds until the answer was there, and of computing."""
    taken = []
    for _ in range(times):
        start, computing = time.perf_counter(), time.process_time()
        ask()
        taken.append((1000 * (time.perf_counter() - start), 1000 * (time.process_time() - computing)))
    return taken


def _asked(service: Served, path: str, known: dict[str, str]) -> None:
    answer = service.client.get(path)
    assert answer.status_code == 200, (path, answer.text)
    if "etag" in answer.headers:
        known[path] = answer.headers["etag"]


def _asked_again(service: Served, path: str, tag: str) -> None:
    answer = service.client.get(path, headers={"If-None-Match": tag})
    assert answer.status_code == 304, (path, answer.status_code)


def _show(name: str, taken: list[tuple[float, float]], read_whole: str = "") -> tuple[float, float]:
    """Print a row; returns milliseconds at the median and at 95 %."""
    whole, computed = np.array(taken).T
    median, high, worst = np.percentile(whole, [50, 95, 100])
    spent = float(np.percentile(computed, 95))
    print(f"{name:36} {median:8.1f} {high:8.1f} {worst:8.1f} {spent:9.1f}  {read_whole}", flush=True)
    return float(median), float(high)


class _Plans:
    """Which tables the planner would read as a whole for the statements of one question."""

    def __init__(self, store: Store) -> None:
        self.whole: set[str] = set()
        self._busy = False
        event.listen(store._engine, "before_cursor_execute", self._explain)

    def _explain(self, connection: Any, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if statement.startswith("SELECT"):
            rows = connection.connection.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)
            told = [str(row[3]) for row in rows]
            self.whole |= {line for line in told if line.startswith("SCAN ") and "CONSTANT" not in line}

    def take(self) -> str:
        """What was found since it was asked last."""
        found, self.whole = sorted(self.whole), set()
        return "; ".join(found).replace("SCAN ", "all of ")


def sizes(file: Path, lot: _Lot, share: float) -> None:
    """Print what the tables take, a dataset, a spectrum, and a year."""
    found = octets(file)
    spectra, datasets = spectra_of(lot.campaigns), lot.datasets
    print(f"{datasets} datasets, {spectra} spectra, numbers in {100 * share:g} % of the campaigns")
    print(f"{'':36} {'MB':>10}")
    for name, size in sorted(found.items(), key=lambda row: -row[1])[:8]:
        print(f"{name:36} {size / 1e6:10.1f}")
    tell("datasets", datasets)
    tell("spectra", spectra, f"with numbers in {100 * share:g} % of the campaigns")
    tell("the file", file.stat().st_size / 1e6, "MB")


def main(datasets: int, share: float, folder: Path) -> None:
    """Write the database where it is not there yet, and ask."""
    file = folder / "goniometer.db"
    if not file.exists():
        start = time.perf_counter()
        write_year(file, datasets, share)
        print(f"written in {time.perf_counter() - start:.0f} s")
    lot = _Lot(datasets, share)
    sizes(file, lot, share)
    print(f"\nload average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; each question {TIMES} times")
    print(f"{'':36} {'median':>8} {'95 %':>8} {'worst':>8} {'computed':>9}")
    store = Store.open(file)
    plans = _Plans(store)
    told = {}
    for name, ask in through_store(store, lot).items():
        ask()
        whole = plans.take()
        told[name] = _show(name, _times(ask), whole)
        plans.take()
    store.close()
    slowest = max(told, key=lambda name: told[name][1])
    tell(f"the slowest of {len(told)} questions to the Store: {slowest}, 95 %", told[slowest][1], "ms", "< 100")
    known: dict[str, str] = {}
    with served(folder, mounts_by_itself=True) as service:
        service.live.datasets.warm_up()
        for name, path in over_rest(lot).items():

            def ask(path: Callable[[], str] = path) -> None:
                _asked(service, path(), known)

            filled = name.endswith("N/map")
            median, high = _show(name, _times(ask, FEW if filled else TIMES))
            because = "the first who asks waits for the fit; a service makes it of every new dataset" if filled else ""
            tell(f"`{name}`, 95 %", high, f"ms (median {median:.1f})", "< 100", because)
        tags = iter(list(known.items())[-TIMES:])
        _show("not modified (304)", _times(lambda: _asked_again(service, *next(tags)), min(TIMES, len(known))))
        begun = time.perf_counter()
        CliRunner().invoke(app, ["status", "-d", str(file)], catch_exceptions=False)
        tell("`goniometer status`, without its start", 1000 * (time.perf_counter() - begun), "ms")


if __name__ == "__main__":
    chosen = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    part = float(sys.argv[2]) if len(sys.argv) > 2 else 1.0
    place = nullcontext(sys.argv[3]) if len(sys.argv) > 3 else tempfile.TemporaryDirectory()
    with place as where:
        main(chosen, part, Path(where))
