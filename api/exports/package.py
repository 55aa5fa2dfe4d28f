"""A data package: all that is known of one dataset in a folder or a zip file, ready to be published."""

import hashlib
import io
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from analysis.bsdf.search import USUAL_BUDGET
from analysis.errors import AnalysisError
from api.exports.texts import Part, Published, texts
from api.results.products import write_dataset_report, write_fits, write_mitsuba
from api.written import Export, slug, write_bytes
from goniometer.errors import InputError, StoreFull
from goniometer.files.bird_json import bird_json
from goniometer.files.bird_metadata import bird_metadata
from goniometer.files.dataset_hdf5 import dataset_to_hdf5, raw_of
from goniometer.files.dataset_table import dataset_to_csv
from goniometer.files.measured_table import read_content
from goniometer.storage.store import Store
from goniometer.wording import check_name

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every file in a zip, so that the same data give the same bytes."""


def write_package(
    store: Store,
    dataset_id: int,
    path: Path,
    terms: tuple[str, tuple[str, ...]],
    said: dict[str, Any],
    attached: tuple[Path, ...],
) -> Export:
    """Write the package of a dataset to `path`: a zip file where it ends so, else a folder.

    `terms` are the licence and the creators, `said` what `goniometer.files.bird_metadata.read_about` gives, `attached`
    files that belong to the sample and that no database holds: photographs, a topography. The same dataset gives the
    same bytes. Raises `InputError` for terms that are not known, a folder that has something in it, and attached files
    that cannot be read.
    """
    published = Published(*terms, store.dataset_created(dataset_id))
    if path.suffix.lower() != ".zip" and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"{path} is there already; name a new folder, or a file that ends in .zip.")
    parts = _attached(attached)  # what a person may have got wrong comes before what takes long
    of_bird = {"license": {"type": published.license, "rights_holder": "; ".join(published.creators)}} | said
    data, notes = _data(store, dataset_id, of_bird)
    derived, more = _derived(store, dataset_id)
    parts = [*data, *derived, *parts]
    notes += more
    files = [*parts, *texts(store.dataset(dataset_id), published, parts, notes)]
    if path.suffix.lower() == ".zip":
        written = write_bytes("package", path, _zipped(path.stem.strip(".") or "package", files))
    else:
        written = _write_folder(path, files)
    return Export("package", written.path, written.sha256, tuple(notes), {"files": [part.path for part in files]})


def _data(store: Store, dataset_id: int, said: dict[str, Any]) -> tuple[list[Part], list[str]]:
    """The dataset itself, what it was measured with, and sentences about what is not there."""
    dataset = store.dataset(dataset_id)
    scan_id = store.scan_of(dataset_id)
    raw = None if scan_id is None else raw_of(store, dataset_id)
    metadata, unsaid = bird_metadata(store, dataset_id, said)
    text, left_out = bird_json(dataset, metadata)
    with_raw = "; all raw exposures" if raw else ""
    parts = [
        Part("data/brdf.h5", dataset_to_hdf5(dataset, raw), f"Everything, NeXus-style{with_raw}"),
        Part("data/brdf.csv", dataset_to_csv(dataset).encode(), "The same as a table, one value a row"),
        Part("data/brdf.brdf", text.encode(), "The BRDF in the universal format of the BiRD project"),
    ]
    notes = [f"data/brdf.brdf: {sentence}" for sentence in (*left_out, *unsaid)]
    certificate = store.dataset_certificate(dataset_id)
    if scan_id is None:
        return parts, [*notes, "Raw exposures are not in the package: they are in no database, or there are none."]
    campaign_id = store.scan(scan_id).campaign_id
    certificate = certificate or store.certificate(campaign_id)
    campaign = store.campaign(campaign_id).model_dump_json(indent=1) + "\n"
    parts.append(Part("data/campaign.json", campaign.encode(), "What was asked to be measured, and how"))
    if certificate is not None:
        parts.append(Part("data/certificate.csv", certificate.encode(), "Certificate of the reference panel"))
    return parts, notes


def _derived(store: Store, dataset_id: int) -> tuple[list[Part], list[str]]:
    """Fits, rendering file and report, and for each that cannot be made a sentence that says why."""
    bsdf = f"fits/{slug(store.dataset(dataset_id).sample)}.bsdf"
    wanted: tuple[tuple[str, Callable[[Store, int, Path], Export], str], ...] = (
        ("fits/analysis.json", write_fits, "All fits with their uncertainties and verdicts"),
        (bsdf, _write_bsdf, "The fitted model for Mitsuba 3"),
        ("report.html", write_dataset_report, "Report with figures, one file for any browser"),
    )
    parts, notes = [], []
    for name, write, about in wanted:
        with tempfile.TemporaryDirectory() as folder:
            inside, _, last = name.rpartition("/")
            try:
                write(store, dataset_id, Path(folder) / last)
            except (AnalysisError, StoreFull) as error:  # the latter is also what cannot be written in its format
                notes.append(f"{name} is not in the package: {error}")
                continue
            for file in sorted(each for each in Path(folder).rglob("*") if each.is_file()):
                told = about if file.name == last else f"Belongs to {last}"
                parts.append(Part(f"{inside}/{file.relative_to(folder)}".lstrip("/"), file.read_bytes(), told))
    return parts, notes


def _write_bsdf(store: Store, dataset_id: int, path: Path) -> Export:
    return write_mitsuba(store, dataset_id, path, None, USUAL_BUDGET)


def _attached(files: tuple[Path, ...]) -> list[Part]:
    names = [file.name for file in files]
    for name in names:
        try:
            check_name(name)
        except ValueError as error:
            raise InputError(f"An attached file cannot be called {name!r}: {error}.") from None
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f'Two attached files are called "{twice[0]}"; give one of them another name.')
    return [Part(f"attached/{file.name}", read_content(file), "Attached by hand") for file in files]


def _zipped(folder: str, parts: list[Part]) -> bytes:
    """A zip file of one folder; files in the order of their names, all of one date."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for part in sorted(parts, key=lambda part: part.path):
            entry = zipfile.ZipInfo(f"{folder}/{part.path}", _EPOCH)
            entry.create_system, entry.external_attr = 3, 0o644 << 16  # as on Unix, whatever this machine is
            archive.writestr(entry, part.content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _write_folder(path: Path, parts: list[Part]) -> Export:
    """Write a folder beside its place and put it there in one step; its hash is that of the checksums."""
    path = path.resolve()
    half = path.with_name(path.name + ".part")
    try:
        shutil.rmtree(half, ignore_errors=True)
        for part in parts:
            file = half / part.path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(part.content)
        if path.exists():
            path.rmdir()
        os.replace(half, path)
    except OSError as error:
        shutil.rmtree(half, ignore_errors=True)
        raise StoreFull(
            f"{path} cannot be written ({error.strerror}); make room there or name another place."
        ) from error
    sums = next(part for part in parts if part.path == "SHA256SUMS")
    return Export("package", path, hashlib.sha256(sums.content).hexdigest())
