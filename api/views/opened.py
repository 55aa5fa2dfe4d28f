"""A dataset with what its stored fits say, and what it takes long to find out, kept for the next who asks."""

import gc
import io
import json
import logging
import os
import threading
import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from analysis.colour import COLOUR_RANGE, colour_differences, has_colour, xyz_weights
from analysis.figures.filled import STEP
from analysis.fits.fit_json import SCHEMA_VERSION, fit_from_json
from analysis.fits.noise import hue_is_known
from analysis.fits.stored_fit import StoredFit, as_measured
from analysis.reflectance.fresnel import load_conductor
from analysis.results import ColourDifferences
from goniometer.datasets.between import FEWEST
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled, fill, unmeasured
from goniometer.errors import GoniometerError
from goniometer.storage.catalogue import Entry
from goniometer.storage.derived import software_version
from goniometer.storage.records import StoredText
from goniometer.storage.store import Store

log = logging.getLogger(__name__)

SHIFT_MODELS = ("cook-torrance-shift", "dielectric-shift")
"""The models whose colours a map compares with the measurement, the first of those that were fitted."""

_DATASETS = 12
"""Datasets that are kept in memory."""
_ANSWERS = 100
"""Answers about them that are kept in memory."""
_FILLED = 5000
"""Files of filled directions that are kept; some 100 kB each."""
_LOOK = 5.0
"""Seconds between two looks for new datasets."""

_UNREADABLE = (OSError, ValueError, KeyError, zipfile.BadZipFile, zlib.error)
"""What is raised by a file of filled directions that is not there, or was cut short."""

T = TypeVar("T")

Fill = Callable[[int, threading.Event], bytes | None]
"""Finds `filled_content` of the dataset of an id, and gives up with a `GoniometerError` when the event is set."""


@dataclass(frozen=True)
class Opened:
    """A dataset and its fits."""

    entry: Entry
    dataset: Dataset
    fits: tuple[StoredText, ...]
    """Oldest first."""

    @cached_property
    def newest(self) -> dict[str, StoredText]:
        """The newest fit of every model that this version can read, "analysis" for all of a scan's end together."""
        found = {}
        for fit in self.fits:
            if json.loads(fit.text).get("schema_version") == SCHEMA_VERSION:
                found[fit.kind] = fit
        return found

    @cached_property
    def analysis(self) -> dict[str, Any] | None:
        """The newest analysis; None where there is none."""
        stored = self.newest.get("analysis")
        content: dict[str, Any] | None = None if stored is None else json.loads(stored.text)
        return content

    @cached_property
    def models(self) -> dict[str, StoredFit]:
        """The newest fit of every model."""
        return {model: fit_from_json(fit.text) for model, fit in self.newest.items() if model != "analysis"}

    @cached_property
    def shift(self) -> StoredFit | None:
        """The model with a shift whose colours are compared with the measurement; None where none was fitted."""
        return next((self.models[model] for model in SHIFT_MODELS if model in self.models), None)

    @cached_property
    def differences(self) -> ColourDifferences | None:
        """Between `shift` and the measurement; None without one, or where the wavelengths have no colour."""
        data = self.dataset
        if self.shift is None or not has_colour(data.wavelengths):
            return None
        fitted = as_measured(self.shift, data.theta_in, data.theta_out, data.wavelengths)
        found = colour_differences(data.brdf, fitted, data.wavelengths, data.theta_in)
        dim = ~hue_is_known(data, self.shift.lambda_n)
        return ColourDifferences(found.absolute, np.where(dim, np.nan, found.chromatic))


class Datasets:
    """The datasets of a database as they are looked at, the last ones kept in memory.

    What is filled between the measured directions takes seconds to find, so it is kept in files in `folder`, by the
    hash of the numbers that it comes from; whoever deletes them loses time and nothing else.
    """

    def __init__(self, store: Store, folder: Path, fill: Fill) -> None:
        self._store = store
        self._folder = folder
        self._fill = fill
        self._kept: OrderedDict[int, tuple[Entry, Dataset]] = OrderedDict()
        self._opened: OrderedDict[tuple[int, int], Opened] = OrderedDict()
        self._answers: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()
        self._filling = threading.Lock()
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """From now on, fill what comes into the database as soon as it is there, so that nobody waits for it."""
        newest = self._store.newest_dataset()  # here, for the thread may begin later
        self._thread = threading.Thread(target=self._fill_after, args=(newest,), name="fill", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Fill no more, and return when nothing is being filled."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def warm_up(self) -> None:
        """Load what takes seconds the first time; call it in a thread of its own when the service starts."""
        load_conductor()
        xyz_weights(np.array(COLOUR_RANGE))
        # What is loaded by now stays until the end. To search it for garbage again and again would hold up all answers
        # for a tenth of a second each time.
        gc.collect()
        gc.freeze()

    def version(self, dataset_id: int) -> tuple[object, ...]:
        """What all views of a dataset are made of: they change with nothing else. Raises `NotInStore`."""
        return self._entry(dataset_id).content_hash, self._store.newest_fit(dataset_id), software_version()

    def open(self, dataset_id: int) -> Opened:
        """A dataset with its fits; raises `NotInStore`."""
        entry, dataset = self._remembered(self._kept, dataset_id, lambda: self._read(dataset_id))
        newest = self._store.newest_fit(dataset_id)
        return self._remembered(
            self._opened, (dataset_id, newest), lambda: Opened(entry, dataset, tuple(self._store.fits(dataset_id)))
        )

    def answer(self, tag: str, make: Callable[[], bytes]) -> bytes:
        """What `make` makes, or has made for the same `tag` not long ago."""
        return self._remembered(self._answers, tag, make, _ANSWERS)

    def filled(self, opened: Opened) -> Filled | None:
        """What can be said of the directions that were not measured; None of a simulation, or with too few points.

        Raises what the `fill` of this object raises.
        """
        return self._filled(opened.entry) if _can_be_filled(opened.dataset) else None

    def _filled(self, entry: Entry) -> Filled | None:
        file = self._folder / f"filled-{entry.content_hash[:32]}-{software_version()}.npz"
        with suppress(*_UNREADABLE):
            return _unpack(file.read_bytes())
        with self._filling:
            with suppress(*_UNREADABLE):  # who had it filled meanwhile has kept it
                return _unpack(file.read_bytes())
            content = self._fill(entry.id, self._closed)
            if content is None:
                return None
            self._keep(file, content)
            return _unpack(content)

    def _fill_after(self, last: int) -> None:
        while not self._closed.wait(_LOOK):
            try:
                for dataset_id in self._store.datasets_after(last):
                    last = dataset_id
                    self._filled(self._store.entry(dataset_id))
            except GoniometerError as error:  # whoever opens it is told, too
                if not self._closed.is_set():
                    log.warning("Dataset %s was not filled beforehand: %s", last, error)

    def _entry(self, dataset_id: int) -> Entry:
        with self._lock:
            known = self._kept.get(dataset_id)
        return self._store.entry(dataset_id) if known is None else known[0]

    def _read(self, dataset_id: int) -> tuple[Entry, Dataset]:
        return self._store.entry(dataset_id), self._store.dataset(dataset_id)

    def _remembered(self, kept: "OrderedDict[Any, T]", key: object, make: Callable[[], T], most: int = _DATASETS) -> T:
        with self._lock:
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        made = make()  # twice where two ask at once, which is better than to make the others wait
        with self._lock:
            kept[key] = made
            while len(kept) > most:
                kept.popitem(last=False)
        return made

    def _keep(self, file: Path, content: bytes) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{threading.get_ident()}.part")
        part.write_bytes(content)
        os.replace(part, file)
        known = sorted(self._folder.glob("filled-*.npz"), key=lambda each: each.stat().st_mtime)
        for old in known[:-_FILLED]:
            old.unlink(missing_ok=True)


def filled_content(dataset: Dataset) -> bytes | None:
    """What can be said of the directions of a dataset that were not measured, as the content of a file.

    None of a simulation, or with too few points. It takes seconds.
    """
    return _pack(fill(dataset, *unmeasured(dataset, STEP))) if _can_be_filled(dataset) else None


def _can_be_filled(dataset: Dataset) -> bool:
    enough = np.count_nonzero(dataset.usable & np.isfinite(dataset.brdf).any(axis=1)) >= FEWEST
    return bool(enough) and not dataset.simulated


def _pack(filled: Filled) -> bytes:
    buffer = io.BytesIO()
    arrays = {name: getattr(filled, name) for name in _ARRAYS}
    told = json.dumps({"by": filled.by, "points": filled.points})
    np.savez_compressed(buffer, told=np.array(told), **arrays)
    return buffer.getvalue()


def _unpack(content: bytes) -> Filled:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        told = json.loads(str(arrays["told"]))
        points = tuple(map(tuple, told["points"]))
        return Filled(**{name: arrays[name] for name in _ARRAYS}, by=tuple(told["by"]), points=points)


_ARRAYS = tuple(field.name for field in fields(Filled) if field.name not in {"by", "points"})
