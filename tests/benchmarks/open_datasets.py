"""How long a dataset takes to open among many, as a page of the service asks for it.

    python -m tests.benchmarks.open_datasets [DATASETS]

Datasets of one measurement under other names, of about a hundred directions and 134 wavelengths, are opened in random
order over loopback. Shown are milliseconds of whole answers at the median and at 95 %, and what service and client
compute together, at the median, which the load of a machine does not change. "First" are datasets that were never
opened before, "after a restart" those whose filled directions are in the cache on the disk, "again" those in memory.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.analyse import analyse
from analysis.fit_json import analysis_to_json, fit_to_json
from api.views.opened import Datasets
from drivers.arrays import FloatArray
from tests.drawn_dataset import drawn_dataset
from tests.served import Served, served

PARTS = ("", "/map?filled=false", "/map", "/models", "/slopes", "/distributions", "/checks", "/points/7", "/spectra")


def main(count: int) -> None:
    """Print a table of answers and their times."""
    with tempfile.TemporaryDirectory() as folder, served(Path(folder), mounts_by_itself=True) as service:
        _fill(service, count)
        service.live.datasets.warm_up()
        random = np.random.default_rng(1)
        chosen = random.permutation(count)[: min(count, 12)] + 1
        few = chosen[:8]
        print(f"{count} datasets; milliseconds at the median / at 95 % (computed)")
        print(f"{'':32}{'first':>22}{'after a restart':>22}{'again':>22}")
        for part in PARTS:
            first = _times(service, part, chosen)
            _forget(service)
            restarted = _times(service, part, chosen)
            _times(service, part, few)
            again = _times(service, part, np.tile(few, 5))
            print(f"{'/api/datasets/N' + part:32}{''.join(map(_shown, (first, restarted, again)))}", flush=True)
        listed = np.array([_time(service, "/api/datasets?limit=50") for _ in range(40)])
        print(f"{'/api/datasets?limit=50':32}{_shown(listed)}")


def _shown(times: FloatArray) -> str:
    whole, computed = times.T
    told = f"{np.median(whole):.0f} / {np.percentile(whole, 95):.0f} ({np.median(computed):.0f})"
    return f"{told:>22}"


def _fill(service: Served, count: int) -> None:
    dataset = drawn_dataset("sample-4")
    fine = np.linspace(383, 995, 134)
    columns = np.clip(np.searchsorted(dataset.wavelengths, fine), 0, dataset.wavelengths.size - 1)
    dataset = replace(dataset.at_wavelengths(columns), wavelengths=fine)
    analysis = analyse(dataset)
    metal = analysis.conductor
    texts = {fit.model: fit_to_json(fit, dataset, analysis.differences[fit.model], metal) for fit in analysis.models}
    texts["analysis"] = analysis_to_json(analysis, metal)
    for i in range(count):
        number = service.live.store.add_dataset(None, replace(dataset, sample=f"Sample {i}"))
        for model, text in texts.items():
            service.live.store.add_fit(number, model, text)


def _forget(service: Served) -> None:
    """As after a restart: what is in memory is gone, what is on the disk stays."""
    fresh = Datasets(service.live.store, service.live.output / "cache")
    service.live.datasets.__dict__.update(fresh.__dict__)


def _times(service: Served, part: str, numbers: NDArray[np.int64]) -> FloatArray:
    return np.array([_time(service, f"/api/datasets/{number}{part}") for number in numbers.tolist()])


def _time(service: Served, path: str) -> tuple[float, float]:
    """Milliseconds until the answer is there, and those that this process has computed."""
    start, computing = time.perf_counter(), time.process_time()
    answer = service.client.get(path)
    taken = 1000 * (time.perf_counter() - start), 1000 * (time.process_time() - computing)
    assert answer.status_code == 200, answer.text
    return taken


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
