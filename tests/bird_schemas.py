"""The schemas of the BiRD project, which are not part of this repository but may lie beside it."""

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

_PLACES = [folder / "shared" / "reference" / "bird_schema" for folder in Path(__file__).parents]
SCHEMAS = next((place for place in _PLACES if place.is_dir()), None)


def validator() -> Any:
    """Of the whole format; skips the test where the schemas are not at hand."""
    if SCHEMAS is None:
        pytest.skip("the schemas of the BiRD project are not at hand")
    # that of sample holders is no valid JSON, and nothing refers to it
    files = [path for path in SCHEMAS.glob("*schema_v1.0.json") if "holder" not in path.name]
    schemas = [json.loads(path.read_text()) for path in files]
    registry: Any = Registry()
    registry = registry.with_resources([(each["$id"], Resource.from_contents(each)) for each in schemas])
    (root,) = (each for each in schemas if each["$id"].endswith("/brdf_json_schema_v1.0.json"))
    return Draft202012Validator(root, registry=registry, format_checker=Draft202012Validator.FORMAT_CHECKER)
