"""What the universal BRDF format wants to know beside the numbers: who, when, where, with what, of which sample.

Most of it is in no database. A person says it in a YAML or JSON file whose keys are those of `metadata` in the format,
e.g. `provenance`, `license`, `sample`, `environment`; it is laid over what is known. What the format demands and nobody
said is written as "not stated", and "NA" stands for a whole part that would need numbers.
"""

import base64
import json
import math
from pathlib import Path
from typing import Any

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import DataFileError
from goniometer.files.dataset_document import document, without_nan
from goniometer.files.measured_table import read_text
from goniometer.storage.derived import software_version
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from goniometer.yaml_text import parsed_yaml

SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
"""Name of version 1.0 of the format."""

NOT_STATED = "not stated"
_NO_EMAIL = "not.stated@example.invalid"
_OF_OURS = ("kind", "content_hash", "aperture_deg", "u_angle_deg", "u_zero_deg", "checks", "lineage")
"""What of our own document goes into the section for whatever the format has no place for."""

_OF_A_PERSON = (
    *("provenance", "license", "description", "instrumentation", "software", "sample", "environment"),
    *("data_links", "comments"),
)


def read_about(path: Path) -> dict[str, Any]:
    """What a person says; raises `DataFileError` for a file that is no mapping, or has a key that is not asked for."""
    text, _ = read_text(path)
    try:
        content = parsed_yaml(text)
    except ValueError as error:
        raise DataFileError(f"{path}: is no valid YAML or JSON: it {error}.") from None
    try:
        json.dumps(content)
    except (TypeError, ValueError) as error:
        raise DataFileError(f"{path}: holds a value that JSON does not know ({error}); write it in quotes.") from None
    if not isinstance(content, dict):
        raise DataFileError(f"{path}: must be a mapping with keys such as provenance, sample and environment.")
    for name in content:
        if name not in _OF_A_PERSON:
            raise DataFileError(f'{path}: "{name}" is not asked for; the keys are {", ".join(_OF_A_PERSON)}.')
    return content


def bird_metadata(store: Store, dataset_id: int, said: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The metadata of a dataset, and sentences about what was not stated; `said` is what `read_about` gives.

    Raises `DataFileError` where `said` has an instrumentation without what the format wants of every one.
    """
    dataset = store.dataset(dataset_id)
    scan_id = store.scan_of(dataset_id)
    scan = None if scan_id is None else store.scan(scan_id)
    moment = store.dataset_created(dataset_id) if scan is None or scan.started is None else scan.started
    digest = base64.urlsafe_b64encode(bytes.fromhex(dataset.content_hash)).decode().rstrip("=")
    known: dict[str, Any] = {
        "schema": SCHEMA,
        "id": f"ni:///sha-256;{digest}",
        "type": "BRDF",
        "timestamp": moment,
        "provenance": {
            "organization": NOT_STATED,
            "location": dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), NOT_STATED),
            "email": _NO_EMAIL,
            "contact_person": NOT_STATED,
        },
        "description": f"In-plane spectral BRDF of {dataset.sample}, {dataset.kind}.",
        "method": "simulation" if dataset.simulated else "measurement",
        "instrumentation": "NA",
        "software": _software(dataset),
        "sample": _sample(store, dataset, scan),
        "environment": "NA",
        "adhoc_section": {name: without_nan(said) for name, said in document(dataset).items() if name in _OF_OURS},
    }
    if scan_id is not None and "instrumentation" in said:
        _check_instrumentation(said["instrumentation"])
        known["instrumentation"] = _instrumentation(store, dataset, scan_id)
    metadata = _laid_over(known, said)
    return metadata, _unsaid(metadata)


def _software(dataset: Dataset) -> dict[str, Any]:
    software: dict[str, Any] = {"name": "goniometer", "version": software_version()}
    if dataset.simulated:
        told = str(dataset.lineage["simulated"])
        software["simulation_model"] = {"name": told, "description": f"{told}; see adhoc_section of the metadata"}
    return software


def _sample(store: Store, dataset: Dataset, scan: Scan | None) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": dataset.sample,
        "type": NOT_STATED,
        "shape": NOT_STATED,
        "dimensions": {},
        "zero_azimuth_location": "in the plane of incidence, on the side of the lamp",
    }
    if scan is None:
        return found
    (sample,) = (each for each in store.campaign(scan.campaign_id).samples if each.name == scan.sample)
    found |= {"shape": "round", "dimensions": {"diameter": {"value": sample.diameter, "unit": "mm"}}}
    if sample.description:
        found["type"] = sample.description
    return found | ({"treatment": sample.preparation} if sample.preparation else {})


_OF_THE_LAMP = ("source.type", "source.power", "beam.shape", "beam.dimensions.area")


def _check_instrumentation(said: object) -> None:
    """Raise `DataFileError` where what a person says of the instrument lacks what the format wants of every one."""
    for place in _OF_THE_LAMP:
        found = said
        for name in ("illumination_system", *place.split(".")):
            found = found.get(name) if isinstance(found, dict) else None
        if found is None:
            raise DataFileError(
                f"The instrumentation needs illumination_system.{place}, as it does {', '.join(_OF_THE_LAMP)}; state "
                f"all of them, or leave instrumentation out."
            )


def _instrumentation(store: Store, dataset: Dataset, scan_id: int) -> dict[str, Any]:
    """The bench as far as it is known; lamp and beam are not."""
    constants = store.constants(scan_id)
    half = math.radians(constants.bench.aperture / 2)
    return {
        "name": "spectral gonioreflectometer",
        "operation_type": "relative",
        "illumination_system": {
            "name": "fixed lamp",
            "source": {"name": "lamp", "wl_range": _range(dataset.wavelengths)},
        },
        "detection_system": {
            "name": "spectrometer on the arm of the detector",
            "sensors": [
                {
                    "name": constants.spectrometer,
                    "spectral_response_range": _range(constants.wavelengths),
                }
            ],
            # of a cone, exact
            "solid_angle": {"value": 2 * math.pi * (1 - math.cos(half)), "unit": "sr"},
        },
    }


def _range(wavelengths: FloatArray) -> dict[str, Any]:
    return {"min_value": float(wavelengths.min()), "max_value": float(wavelengths.max()), "unit": "nm"}


def _laid_over(known: dict[str, Any], said: dict[str, Any]) -> dict[str, Any]:
    """`known` with everything that was said; objects are laid over each other, anything else takes the place."""
    merged = dict(known)
    for name, value in said.items():
        before = merged.get(name)
        merged[name] = _laid_over(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return merged


def _unsaid(metadata: dict[str, Any]) -> list[str]:
    """What is written as not stated or not applicable, by its place."""
    found: list[str] = []

    def look(part: dict[str, Any], place: str) -> None:
        for name, value in part.items():
            if isinstance(value, dict):
                look(value, f"{place}{name}.")
            elif value in {NOT_STATED, _NO_EMAIL} if isinstance(value, str) else False:
                found.append(f"{place}{name}")

    look({name: metadata[name] for name in _OF_A_PERSON if name in metadata}, "")
    if metadata["method"] == "measurement":
        found += [name for name in ("instrumentation", "environment") if metadata[name] == "NA"]
    return [f"Not stated: {', '.join(found)}; say it in a file and name that with --about."] if found else []
