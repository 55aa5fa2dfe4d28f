"""How many points and spectra a second are committed and read, by SQLite, without hashes, and by PostgreSQL.

    python -m tests.benchmarks.write_rate [ROUNDS]

All keep what is committed through a power cut: SQLite with synchronous=FULL, the server with fsync; it listens on a
socket of this machine. A third way is SQLite without the hashes of raw spectra, to tell what those cost. They take
turns in every round, so that a busy machine is busy for all; told are rates at the median of the rounds, with the
lowest and highest, and the median of the ratios of the rounds to SQLite. A point is begun and then finished with one
spectrum of 1044 pixels, in two transactions, as a scan does it.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.geometry import Geometry
from goniometer.storage.store import Store
from tests.benchmarks.figures import tell
from tests.databases import fresh_database, start_server

POINTS, SPECTRA, BATCH, PIXELS = 100, 100, 10, 1044
CAMPAIGN = Campaign(name="Rates", samples=(Sample(name="Sample 1", material="sample-1"),))

BARE = "SQLite without hashes"

Work = Callable[[Store, int], int]
"""Does something on a store and a scan of it, and tells how often."""


def main(rounds: int) -> None:
    """Print a table of rates."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        server = stack.enter_context(fresh_database(start_server(folder, durable=True)))
        files = {"SQLite": folder / "rates.db", BARE: folder / "bare.db", "PostgreSQL": server}
        stores = {name: Store.open(file) for name, file in files.items()}
        scans = {name: store.scans(store.add_campaign(CAMPAIGN))[1].id for name, store in stores.items()}
        rates: dict[str, dict[str, list[float]]] = {what: {name: [] for name in stores} for what in WORK}
        for turn in range(rounds):
            for what, work in WORK.items():
                for name in list(stores) if turn % 2 else list(stores)[::-1]:
                    unhashed = patch("goniometer.storage.records.exposure_hash", _known)
                    with unhashed if name == BARE else nullcontext():
                        start = time.perf_counter()
                        count = work(stores[name], scans[name])
                        rates[what][name].append(count / (time.perf_counter() - start))
        for store in stores.values():
            store.close()
    print(f"per second at the median of {rounds} rounds (lowest to highest); load {os.getloadavg()[0]:.1f}", end="")
    print(f" on {os.cpu_count()} cores")
    for what, found in rates.items():
        sqlite, *others = (np.array(found[name]) for name in stores)
        bare, server = (f"{np.median(other / sqlite):.2f}" for other in others)
        span = f"a second ({sqlite.min():.0f} to {sqlite.max():.0f})"
        tell(
            f"{what}, SQLite", np.median(sqlite), f"{span}; without hashes {bare} times that, PostgreSQL {server} times"
        )


def _known(row: Mapping[Any, Any]) -> str:
    """The hash that the row has, without any work; of a new row some other."""
    return str(row["sha256"]) if "sha256" in row else "0" * 64


def _spectra(count: int) -> Iterator[Spectrum]:
    random = np.random.default_rng(1)
    for number in range(count):
        yield Spectrum(random.integers(0, 200_001, PIXELS, dtype=np.uint32), 0.1, number, -10.0)


def _measure_points(store: Store, scan: int) -> int:
    before = len(store.points(scan))
    store.add_points(scan, [Geometry(10.0, angle) for angle in np.linspace(-60, 60, POINTS)])
    for point, spectrum in zip(store.points(scan)[before:], _spectra(POINTS), strict=True):
        store.start_point(point.id)
        store.finish_point(point, point.geometry, [spectrum], "one", 0.0, 1.0, 50.0)
    return POINTS


def _write_spectra(store: Store, scan: int) -> int:
    for spectrum in _spectra(SPECTRA):
        store.add_exposures(scan, "dark", [spectrum], "one", 0.0)
    return SPECTRA


def _write_batches(store: Store, scan: int) -> int:
    spectra = list(_spectra(SPECTRA))
    for first in range(0, SPECTRA, BATCH):
        store.add_exposures(scan, "dark", spectra[first : first + BATCH], "one", 0.0)
    return SPECTRA


def _read_spectra(store: Store, scan: int) -> int:
    return len(store.exposures(scan))


def _read_points(store: Store, scan: int) -> int:
    return len(store.points(scan))


def _ask(store: Store, scan: int) -> int:
    for _ in range(SPECTRA):
        store.command(scan)
    return SPECTRA


WORK: dict[str, Work] = {
    "points, two commits each": _measure_points,
    "spectra written, a commit each": _write_spectra,
    f"spectra written, {BATCH} a commit": _write_batches,
    "spectra read": _read_spectra,
    "points read": _read_points,
    "small questions": _ask,
}

if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 9)
