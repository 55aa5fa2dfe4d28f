"""What the hashes of raw exposures cost, when points are written and when they are read again; run as a script.

    python -m tests.benchmarks.raw_hashes

The same points are written and read with the hashes and without, in turns, so that what else the machine does meets
both alike; told are the medians.
"""

import os
import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from drivers.interfaces import Spectrum
from goniometer.campaign import Campaign, Sample
from goniometer.geometry import Geometry
from goniometer.records import exposure_hash
from goniometer.store import Store

CAMPAIGN = Campaign(name="Hashes", samples=(Sample(name="A", material="sample-1"),))
POINTS, SPECTRA, TURNS = 60, 4, 9
HASH = "goniometer.records.exposure_hash"


def written(store: Store, spectra: list[Spectrum]) -> float:
    """Seconds to begin and finish the points of a batch."""
    scan = store.scans()[0].id
    before = len(store.points(scan))
    store.add_points(scan, [Geometry(10.0, 0.01 * (before + i)) for i in range(POINTS)])
    points = store.points(scan)[before:]
    began = time.perf_counter()
    for point in points:
        store.start_point(point.id)
        store.finish_point(point, point.geometry, spectra, "one", 0.0, 1.0, 50.0)
    return time.perf_counter() - began


def read(store: Store) -> float:
    """Seconds to read everything."""
    began = time.perf_counter()
    store.exposures(store.scans()[0].id)
    return time.perf_counter() - began


def known(row: Mapping[Any, Any]) -> str:
    """The hash that the row has, without any work; of a new row some other."""
    return str(row["sha256"]) if "sha256" in row else "0" * 64


def main() -> None:
    """Measure and print."""
    chance = np.random.default_rng(1)
    spectra = [Spectrum(chance.integers(0, 200_001, 1044, dtype=np.uint32), 0.1, i, -10.0) for i in range(SPECTRA)]
    seconds: dict[str, list[float]] = {"write": [], "write, no hash": [], "read": [], "read, no hash": []}
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "bench.db")
        bare = Store.open(Path(folder) / "bare.db")
        for each in (store, bare):
            each.add_campaign(CAMPAIGN)
        for _ in range(TURNS):
            seconds["write"].append(written(store, spectra))
            seconds["read"].append(read(store))
            with patch(HASH, known):
                seconds["write, no hash"].append(written(bare, spectra))
                seconds["read, no hash"].append(read(bare))
        for each in (store, bare):
            each.close()
    row = {
        "kind": "light",
        "integration_time": 0.1,
        "device_count": 1,
        "detector_temperature": -10.0,
        "theta_in": 10.0,
        "theta_out": 20.0,
        "theta_out_end": None,
        "session": "one",
        "moment": 1.0,
        "taken": "2026-01-02T03:04:05.678+00:00",
        "counts": spectra[0].counts.tobytes(),
    }
    began = time.perf_counter()
    for _ in range(10_000):
        exposure_hash(row)
    alone = (time.perf_counter() - began) / 10_000
    ratio = {
        what: statistics.median(a / b for a, b in zip(seconds[what], seconds[f"{what}, no hash"], strict=True))
        for what in ("write", "read")
    }
    point = statistics.median(seconds["write"]) / POINTS
    print(f"One hash of one spectrum: {alone * 1e6:.1f} us")
    print(f"A point of {SPECTRA} spectra is committed in {point * 1e3:.2f} ms: {ratio['write']:.3f} times as long")
    print(f"Raw data are read {ratio['read']:.3f} times as long as without")
    print(f"Load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
