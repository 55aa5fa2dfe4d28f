"""A dataset as HDF5, arranged as NeXus does: every number of it, with uncertainty, flags, checks and lineage.

| place | what |
|---|---|
| /entry | NXentry: title, program, hash of the content, lineage as JSON |
| /entry/brdf | NXdata: BRDF, its combined standard uncertainty, angles, wavelengths, flags |
| /entry/sources/NN | NXcollection: one source of error, its values and which points share it |
| /entry/checks | NXcollection: what the checks asked and found |
| /entry/sample, /entry/instrument | NXsample, NXinstrument |
| /entry/raw/NAME | NXcollection, where asked for: all exposures of a scan |

Units are attributes. Arrays are compressed and bit for bit as they were. What is read must be plain: links that leave
the file, or name a thing twice, are refused, as are arrays that are kept elsewhere.
"""

import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from goniometer.constants import Constants
from goniometer.datasets.dataset import MEANING, Dataset
from goniometer.errors import DataFileError, OptionError
from goniometer.files.dataset_document import (
    MEANINGS,
    MOST_SOURCES,
    SHARING,
    UNITS,
    Arrays,
    assembled,
    document,
    parsed,
)
from goniometer.files.plain_hdf5 import PlainHdf5, is_plain
from goniometer.storage.records import Exposure, constants_json
from goniometer.storage.store import Store

if TYPE_CHECKING:
    from h5py import Group

MAGIC = b"\x89HDF\r\n\x1a\n"
"""How such a file begins."""

_PASSED = {None: -1, False: 0, True: 1}


Raw = dict[str, tuple[Constants, list[Exposure]]]
"""Constants of the devices and all exposures of scans by name."""


def raw_of(store: Store, dataset_id: int) -> Raw:
    """The raw data that a dataset was made of: those of its scan, its reference, its spot, and scans in between.

    Raises `InputError` for a dataset that was made of no raw data in this database.
    """
    if store.scan_of(dataset_id) is None:
        told = f"Dataset {dataset_id} was made of no raw data in this database; export it without {{raw}}."
        raise OptionError(told, "raw")
    lineage = store.lineage(dataset_id)
    between = lineage["scans_between"]
    assert isinstance(between, list)  # as calibration wrote it
    names = {"sample": lineage["scan"], "reference": lineage["reference_scan"], "spot": lineage["spot_scan"]}
    names |= {f"between_{number}": number for number in between}
    scans = {name: int(str(number)) for name, number in names.items() if number is not None}
    return {name: (store.constants(number), store.exposures(number)) for name, number in scans.items()}


def dataset_to_hdf5(dataset: Dataset, raw: Raw | None = None) -> bytes:
    """The content of the file; the same dataset gives the same bytes. `raw` are scans by name, to be written too."""
    import h5py  # noqa: PLC0415  (is only needed here)

    said = document(dataset)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("earliest", "v110")) as file:
        file.attrs["default"] = "entry"
        entry = _group(file, "entry", "NXentry")
        entry.attrs["default"] = "brdf"
        for name in ("format", "format_version", "kind", "content_hash", "history_hash"):
            entry.attrs[name] = said[name]
        entry["title"] = f"In-plane spectral BRDF of {dataset.sample}"
        entry["program_name"] = said["software"]["name"]
        entry["program_name"].attrs["version"] = said["software"]["version"]
        entry["lineage"] = json.dumps(dataset.lineage, sort_keys=True)
        entry["lineage"].attrs["type"] = "application/json"
        _group(entry, "sample", "NXsample")["name"] = dataset.sample
        _write_instrument(_group(entry, "instrument", "NXinstrument"), said)
        _write_brdf(_group(entry, "brdf", "NXdata"), dataset)
        sources = _group(entry, "sources", "NXcollection")
        sources.attrs["sharing"] = SHARING
        for i, source in enumerate(dataset.sources):
            group = _group(sources, f"{i:03d}", "NXcollection")
            group.attrs["name"], group.attrs["part"] = source.name, source.part
            group.attrs["shared_by_wavelengths"] = source.shared_by_wavelengths
            _array(group, "values", source.values, "1/sr", "change of the BRDF for one standard uncertainty, signed")
            if source.groups is not None:
                _array(group, "groups", source.groups.astype(np.int64), None, "points of one group share the error")
        _write_checks(_group(entry, "checks", "NXcollection"), dataset)
        for name, (constants, exposures) in (raw or {}).items():
            holder = entry["raw"] if "raw" in entry else _group(entry, "raw", "NXcollection")
            write_exposures(_group(holder, name, "NXcollection"), constants, exposures)
    return buffer.getvalue()


def _group(parent: "Group", name: str, nx_class: str) -> "Group":
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    return group


def _array(group: "Group", name: str, values: NDArray[Any], units: str | None, meaning: str = "") -> None:
    packed = {"compression": "gzip", "shuffle": True} if values.nbytes > 1000 else {}
    made = group.create_dataset(name, data=values, **packed)
    if units is not None:
        made.attrs["units"] = units
    if meaning:
        made.attrs["long_name"] = meaning


def _write_instrument(instrument: "Group", said: dict[str, Any]) -> None:
    for name, meaning in (
        ("aperture", "full angle of the detector aperture over which brdf is an average; 0 where corrected for"),
        ("u_angle", "standard uncertainty of one stage position, independent between moves"),
        ("u_zero", "standard uncertainty of the zero of each stage, the same for all points"),
    ):
        instrument[name] = said[f"{name}_deg"]
        instrument[name].attrs["units"] = "deg"
        instrument[name].attrs["long_name"] = meaning


def _write_brdf(data: "Group", dataset: Dataset) -> None:
    data.attrs["signal"] = "brdf"
    data.attrs["axes"] = [".", "wavelength"]
    for name, axis in (("theta_in", 0), ("theta_out", 0), ("flags", 0), ("wavelength", 1)):
        data.attrs[f"{name}_indices"] = axis
    columns: dict[str, NDArray[Any]] = {
        "theta_in": dataset.theta_in,
        "theta_out": dataset.theta_out,
        "wavelength": dataset.wavelengths,
        "brdf": dataset.brdf,
        "flags": dataset.flags,
    }
    for name, values in columns.items():
        _array(data, name, values, UNITS[name], MEANINGS[name])
    _array(data, "brdf_errors", dataset.u, "1/sr", MEANINGS["standard_uncertainty"])
    data["flags"].attrs["flag_masks"] = np.array([int(flag) for flag in MEANING], dtype=np.uint16)
    data["flags"].attrs["flag_meanings"] = list(MEANING.values())


def _write_checks(group: "Group", dataset: Dataset) -> None:
    group["name"] = np.array([check.name for check in dataset.checks], dtype=object).astype(_text())
    group["passed"] = np.array([_PASSED[check.passed] for check in dataset.checks], dtype=np.int8)
    group["passed"].attrs["long_name"] = "1 passed, 0 failed, -1 where the data do not tell"
    group["message"] = np.array([check.message for check in dataset.checks], dtype=object).astype(_text())


def _text() -> Any:
    import h5py  # noqa: PLC0415  (is only needed here)

    return h5py.string_dtype()


def write_exposures(group: "Group", constants: Constants, exposures: list[Exposure]) -> None:
    """Raw spectra of one scan in the order in which they were written; NaN where a dark has no direction."""
    group["constants"] = constants_json(constants)
    group["constants"].attrs["type"] = "application/json"
    _array(group, "wavelength", constants.wavelengths, "nm", "of each pixel, by the spectrometer's coefficients")
    if not exposures:
        return
    _array(group, "counts", np.stack([e.counts for e in exposures]), "counts", "[exposures, pixels] as read")
    columns: dict[str, tuple[list[float], str | None]] = {
        "integration_time": ([e.integration_time for e in exposures], "s"),
        "detector_temperature": ([e.detector_temperature for e in exposures], "degC"),
        "moment": ([e.moment for e in exposures], "s"),
        "theta_in": ([np.nan if e.geometry is None else e.geometry.theta_in for e in exposures], "deg"),
        "theta_out": ([np.nan if e.geometry is None else e.geometry.theta_out for e in exposures], "deg"),
        "theta_out_end": ([np.nan if e.theta_out_end is None else e.theta_out_end for e in exposures], "deg"),
    }
    for name, (values, units) in columns.items():
        _array(group, name, np.array(values, dtype=float), units)
    _array(group, "id", np.array([e.id for e in exposures], dtype=np.int64), None)
    _array(group, "point", np.array([-1 if e.point_id is None else e.point_id for e in exposures]), None)
    for name in ("kind", "session", "taken"):
        group[name] = np.array([getattr(e, name) for e in exposures], dtype=object).astype(_text())


def dataset_from_hdf5(where: str, content: bytes) -> Dataset:
    """The dataset of a file that `dataset_to_hdf5` wrote; raw exposures are left alone.

    Raises `DataFileError` where the file is of another program, damaged, changed, or not plain.
    """
    import h5py  # noqa: PLC0415  (is only needed here)

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            return _read(where, PlainHdf5(where, file["entry"] if is_plain(where, file, "entry") else file))
    # what the library and the conversions below raise for content that is not what we wrote
    except (OSError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise DataFileError(f"{where}: cannot be read as HDF5 of a dataset ({error}); export it again.") from error


def _read(where: str, file: PlainHdf5) -> Dataset:
    if (count := len(file.group("sources"))) > MOST_SOURCES:
        raise DataFileError(f"{where}: has {count} sources of error; {MOST_SOURCES} is more than any budget has.")
    names = sorted(file.group("sources"))
    sources = []
    for name in names:
        place = f"sources/{name}"
        sources.append(
            {
                "name": str(file.attribute(place, "name")),
                "part": str(file.attribute(place, "part")),
                "shared_by_wavelengths": bool(file.attribute(place, "shared_by_wavelengths")),
                "groups": file.integers(f"{place}/groups") if file.has(place, "groups") else None,
            }
        )
    passed = {number: meaning for meaning, number in _PASSED.items()}
    checks = file.texts("checks/name"), file.integers("checks/passed"), file.texts("checks/message")
    content = {
        "format": str(file.attribute("", "format")),
        "format_version": int(file.attribute("", "format_version")),
        "sample": file.texts("sample/name")[0],
        "content_hash": str(file.attribute("", "content_hash")),
        "history_hash": str(file.attribute("", "history_hash")),
        **{f"{name}_deg": float(file.numbers(f"instrument/{name}")) for name in ("aperture", "u_angle", "u_zero")},
        "sources": sources,
        "checks": [{"name": n, "passed": passed[p], "message": m} for n, p, m in zip(*checks, strict=True)],
        "lineage": json.loads(file.texts("lineage")[0]),
    }
    arrays = Arrays(
        theta_in=file.numbers("brdf/theta_in"),
        theta_out=file.numbers("brdf/theta_out"),
        wavelengths=file.numbers("brdf/wavelength"),
        brdf=file.numbers("brdf/brdf"),
        flags=file.numbers("brdf/flags"),
        sources=tuple(file.numbers(f"sources/{name}/values") for name in names),
    )
    return assembled(where, parsed(where, content), arrays)
