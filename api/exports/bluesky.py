"""A dataset as a stream of documents of the event model, as beamlines keep their scans.

One run: `start`, a descriptor of the stream "primary" with one event a point (angles, BRDF, its standard uncertainty,
flags), for a scan of this database a descriptor of the stream "exposures" with one event for every raw spectrum, and
`stop`. As lines of JSON, each `[name, document]`, the way of suitcase-jsonl. JSON knows no NaN: null is no value. The
same dataset gives the same documents. https://blueskyproject.io/event-model
"""

import json
import uuid
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.files.dataset_document import MEANINGS, UNITS, document, without_nan
from goniometer.storage.records import Exposure, Scan
from goniometer.storage.store import Store

Document = tuple[str, dict[str, Any]]


def bluesky_lines(store: Store, dataset_id: int) -> str:
    """The text of the file."""
    return "".join(json.dumps(each, allow_nan=False) + "\n" for each in bluesky_documents(store, dataset_id))


def bluesky_documents(store: Store, dataset_id: int) -> Iterator[Document]:
    """The documents of a dataset in their order; raises `NotInStore`."""
    dataset = store.dataset(dataset_id)
    scan_id = store.scan_of(dataset_id)
    scan = None if scan_id is None else store.scan(scan_id)
    exposures = [] if scan is None else store.exposures(scan.id)
    began = ended = _seconds(store.dataset_created(dataset_id))
    if scan is not None and scan.started is not None and scan.finished is not None:
        began, ended = _seconds(scan.started), _seconds(scan.finished)
    run, primary, raw = (_uid(dataset, name) for name in ("start", "primary", "exposures"))
    yield "start", _start(dataset) | {"uid": run, "time": began, "scan_id": dataset_id if scan is None else scan.id}
    of_run = {"run_start": run, "time": began}
    yield "descriptor", _primary(dataset) | of_run | {"uid": primary}
    moments = _moments(store, scan, exposures, dataset.theta_in.size, ended)
    for number, data in enumerate(_points(dataset), start=1):
        yield "event", _event(dataset, primary, number, data, moments[number - 1])
    events = {"primary": dataset.theta_in.size}
    if scan is not None and exposures:
        yield "descriptor", _exposures(store, scan) | of_run | {"uid": raw}
        for number, exposure in enumerate(exposures, start=1):
            yield "event", _event(dataset, raw, number, _raw(exposure), _seconds(exposure.taken))
        events["exposures"] = len(exposures)
    closing = {"uid": _uid(dataset, "stop"), "run_start": run, "time": ended}
    yield "stop", closing | {"exit_status": "success", "num_events": events}


_OF_START = (
    *("kind", "content_hash", "aperture_deg", "u_angle_deg", "u_zero_deg"),
    *("flags", "checks", "lineage", "software"),
)


def _start(dataset: Dataset) -> dict[str, Any]:
    said = document(dataset)
    return {
        "plan_name": "goniometer",
        "sample": {"name": dataset.sample},
        "motors": ["theta_in", "theta_out"],
        "detectors": ["spectrometer"],
        "num_points": int(dataset.theta_in.size),
        "hints": {"dimensions": [[["theta_in"], "primary"], [["theta_out"], "primary"]]},
    } | {name: without_nan(said[name]) for name in _OF_START}


def _primary(dataset: Dataset) -> dict[str, Any]:
    number = dataset.wavelengths.size
    columns = ("theta_in", "theta_out", "brdf", "standard_uncertainty", "flags")
    keys = {name: _key("number", UNITS[name], MEANINGS[name]) for name in columns}
    for name in ("brdf", "standard_uncertainty"):
        keys[name] |= {"dtype": "array", "dtype_numpy": "<f8", "shape": [number], "dims": ["wavelength"]}
    keys["flags"] |= {"dtype": "integer"}
    return _descriptor("primary", keys, {"wavelength": (dataset.wavelengths.tolist(), "nm")})


def _exposures(store: Store, scan: Scan) -> dict[str, Any]:
    constants = store.constants(scan.id)
    keys = {
        "kind": _key("string", None, "light, dark, stray, monitor or sweep") | {"dtype_numpy": "<U7"},
        "theta_in": _key("number", "deg", "where the stages stood; null for a dark"),
        "theta_out": _key("number", "deg", "where the stages stood; null for a dark"),
        "integration_time": _key("number", "s", "of the spectrum"),
        "detector_temperature": _key("number", "degC", "of the detector"),
        "counts": _key("array", "counts", "as read from the device")
        | {"shape": [constants.wavelengths.size], "dtype_numpy": "<u4", "dims": ["pixel"]},
    }
    configuration: dict[str, tuple[list[float], str]] = {
        "pixel_wavelength": (constants.wavelengths.tolist(), "nm"),
        "nonlinearity": (constants.nonlinearity.tolist(), "1"),
    }
    return _descriptor("exposures", keys, configuration)


def _descriptor(
    name: str, keys: dict[str, dict[str, Any]], configuration: dict[str, tuple[list[float], str]]
) -> dict[str, Any]:
    array = {"dtype_numpy": "<f8"}
    return {
        "name": name,
        "data_keys": {key: told | {"object_name": "goniometer"} for key, told in keys.items()},
        "object_keys": {"goniometer": list(keys)},
        "hints": {"goniometer": {"fields": [key for key in keys if key in {"theta_in", "theta_out"}]}},
        "configuration": {
            "goniometer": {
                "data": {key: values for key, (values, _) in configuration.items()},
                "timestamps": dict.fromkeys(configuration, 0.0),
                "data_keys": {
                    key: _key("array", units, "of the bench") | array | {"shape": [len(values)]}
                    for key, (values, units) in configuration.items()
                },
            }
        },
    }


def _key(dtype: str, units: str | None, meaning: str) -> dict[str, Any]:
    return {"source": f"goniometer: {meaning}", "dtype": dtype, "shape": [], "units": units}


def _points(dataset: Dataset) -> Iterator[dict[str, Any]]:
    for i in range(dataset.theta_in.size):
        yield {
            "theta_in": float(dataset.theta_in[i]),
            "theta_out": float(dataset.theta_out[i]),
            "brdf": _values(dataset.brdf[i]),
            "standard_uncertainty": _values(dataset.u[i]),
            "flags": int(dataset.flags[i]),
        }


def _raw(exposure: Exposure) -> dict[str, Any]:
    geometry = exposure.geometry
    return {
        "kind": exposure.kind,
        "theta_in": None if geometry is None else geometry.theta_in,
        "theta_out": None if geometry is None else geometry.theta_out,
        "integration_time": exposure.integration_time,
        "detector_temperature": exposure.detector_temperature,
        "counts": exposure.counts.tolist(),
    }


def _event(dataset: Dataset, descriptor: str, number: int, data: dict[str, Any], moment: float) -> dict[str, Any]:
    return {
        "uid": _uid(dataset, f"{descriptor} {number}"),
        "descriptor": descriptor,
        "seq_num": number,
        "time": moment,
        "data": data,
        "timestamps": dict.fromkeys(data, moment),
        "filled": {},
    }


def _moments(store: Store, scan: Scan | None, exposures: list[Exposure], points: int, ended: float) -> list[float]:
    """[points] when each was measured; when the dataset was made where nobody knows."""
    if scan is None:
        return [ended] * points
    last = {exposure.point_id: exposure.taken for exposure in exposures if exposure.point_id is not None}
    return [_seconds(last[point.id]) for point in store.points(scan.id) if point.status == "done"]


def _values(row: FloatArray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in row.tolist()]


def _seconds(moment: str) -> float:
    """Seconds since 1970 of a time as the database has it."""
    return datetime.fromisoformat(moment).timestamp()


def _uid(dataset: Dataset, what: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"{dataset.content_hash} {what}"))
