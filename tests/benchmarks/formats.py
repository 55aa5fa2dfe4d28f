"""Sizes of a dataset's files, and the time that it takes to write and to read them.

    python -m tests.benchmarks.formats

Beside ours, in the same run: what pandas makes of the same table, and NumPy of the same arrays, which keep the numbers
but neither who shares an error nor what a flag means. Processor time, best of three.
"""

import io
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas

from goniometer.dataset import Dataset
from goniometer.dataset_file import reloaded
from goniometer.dataset_hdf5 import dataset_to_hdf5
from goniometer.dataset_table import columns, dataset_to_csv, dataset_to_parquet
from goniometer.uncertainty import ErrorSource, everywhere

POINTS, WAVELENGTHS, SOURCES = 150, 134, 20


def dataset() -> Dataset:
    """As many numbers as a campaign with 15 incident angles gives, all digits of them random."""
    random = np.random.default_rng(1)
    shape = POINTS, WAVELENGTHS
    sources = tuple(
        ErrorSource(f"source {i}", "random", random.standard_normal(shape), everywhere(POINTS), bool(i % 2))
        for i in range(SOURCES)
    )
    theta_in, theta_out = np.sort(random.uniform(0, 80, POINTS)), random.uniform(-80, 80, POINTS)
    wavelengths = np.sort(random.uniform(380, 990, WAVELENGTHS))
    flags = np.zeros(POINTS, dtype=np.uint16)
    return Dataset(
        "random", theta_in, theta_out, wavelengths, random.uniform(0, 1, shape), sources, flags, 0.005, 0.01, 1.0
    )


def seconds(task: Callable[[], object]) -> float:
    """Processor time of a task, best of three."""
    found = []
    for _ in range(3):
        begin = time.process_time()
        task()
        found.append(time.process_time() - begin)
    return min(found)


def main() -> None:
    """Print the table."""
    made = dataset()
    frame = pandas.DataFrame(columns(made))
    arrays = {name: values for name, values in vars(made).items() if isinstance(values, np.ndarray)}
    arrays |= {source.name: source.values for source in made.sources}

    def in_memory(write: Callable[[io.BytesIO], object]) -> bytes:
        buffer = io.BytesIO()
        write(buffer)
        return buffer.getvalue()

    def ours(content: bytes) -> object:
        return reloaded(Path("it"), content)

    def lossless(content: bytes) -> str:
        back = reloaded(Path("it"), content)
        return "yes" if back is not None and back.content_hash == made.content_hash else "no"

    rows: dict[str, tuple[Callable[[], bytes], Callable[[bytes], object]]] = {
        "hdf5": (lambda: dataset_to_hdf5(made), ours),
        "parquet": (lambda: dataset_to_parquet(made), ours),
        "csv": (lambda: dataset_to_csv(made).encode(), ours),
        "NumPy .npz": (
            lambda: in_memory(lambda buffer: np.savez_compressed(buffer, **arrays)),
            lambda content: {name: values for name, values in np.load(io.BytesIO(content)).items()},
        ),
        "pandas parquet": (
            lambda: in_memory(frame.to_parquet),
            lambda content: pandas.read_parquet(io.BytesIO(content)),
        ),
        "pandas CSV": (
            lambda: frame.to_csv(index=False).encode(),
            lambda content: pandas.read_csv(io.BytesIO(content)),
        ),
    }
    print(f"{POINTS} points, {WAVELENGTHS} wavelengths, {SOURCES} sources of error")
    print(f"{'format':16}{'MB':>8}{'write, s':>10}{'read, s':>10}  the very same dataset again")
    for name, (write, read) in rows.items():
        content = write()
        times = seconds(write), seconds(partial(read, content))
        again = lossless(content) if read is ours else "numbers only"
        print(f"{name:16}{len(content) / 1e6:8.2f}{times[0]:10.3f}{times[1]:10.3f}  {again}")


if __name__ == "__main__":
    main()
