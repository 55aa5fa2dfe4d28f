"""The texts of a data package, by which people and machines find their way: README, citation, licence, checksums.

`datapackage.json` follows the Data Package standard of Frictionless Data (specs.frictionlessdata.io), version 1;
`CITATION.cff` the Citation File Format 1.2.0; `SHA256SUMS` is what `sha256sum -c` reads.
"""

import hashlib
import json
from dataclasses import dataclass

import yaml

from goniometer.datasets.dataset import Dataset
from goniometer.errors import InputError, OptionError
from goniometer.files.dataset_document import MEANINGS, UNITS
from goniometer.files.dataset_table import columns
from goniometer.storage.derived import software_version

LICENSES = {
    "CC0-1.0": ("Creative Commons Zero v1.0 Universal", "https://creativecommons.org/publicdomain/zero/1.0/"),
    "CC-BY-4.0": ("Creative Commons Attribution 4.0", "https://creativecommons.org/licenses/by/4.0/"),
    "CC-BY-SA-4.0": ("Creative Commons Attribution Share Alike 4.0", "https://creativecommons.org/licenses/by-sa/4.0/"),
    "CC-BY-NC-4.0": (
        "Creative Commons Attribution NonCommercial 4.0",
        "https://creativecommons.org/licenses/by-nc/4.0/",
    ),
    "ODC-By-1.0": ("Open Data Commons Attribution 1.0", "https://opendatacommons.org/licenses/by/1-0/"),
    "ODbL-1.0": ("Open Data Commons Open Database 1.0", "https://opendatacommons.org/licenses/odbl/1-0/"),
    "PDDL-1.0": ("Open Data Commons Public Domain Dedication 1.0", "https://opendatacommons.org/licenses/pddl/1-0/"),
}
"""SPDX identifier -> title and address of the licences under which data are published."""

KEYWORDS = ["BRDF", "gonioreflectometry", "spectral reflectance", "in-plane"]

_MEDIA_TYPES = {
    "h5": "application/x-hdf5",
    "csv": "text/csv",
    "json": "application/json",
    "brdf": "application/json",
    "html": "text/html",
}


@dataclass(frozen=True)
class Part:
    """One file of a package."""

    path: str
    """Within the package, with slashes."""
    content: bytes
    about: str
    """What it holds, one sentence without its full stop."""


@dataclass(frozen=True)
class Published:
    """Who publishes a dataset, and how."""

    license: str
    """One of `LICENSES`."""
    creators: tuple[str, ...]
    """Of the data, in order: "Family, Given" for a person, anything else for an organisation."""
    created: str
    """When the dataset was made, ISO 8601 in UTC."""

    def __post_init__(self) -> None:
        check_terms(self.license, self.creators)


def check_terms(license_: str, creators: tuple[str, ...]) -> None:
    """Raise `InputError` for a licence that is not known and for creators that have no name."""
    if license_ not in LICENSES:
        raise InputError(f'"{license_}" is no licence for data that is known here; use {", ".join(LICENSES)}.')
    if not all(creator.strip(" ,") for creator in creators):
        told = 'A creator has no name; write {creators} "Family, Given", or the name of an organisation.'
        raise OptionError(told, creators="--creator")


def texts(dataset: Dataset, published: Published, parts: list[Part], notes: list[str]) -> list[Part]:
    """README, licence, citation, `datapackage.json` and checksums of a package of `parts`, in this order."""
    made = [
        Part("README.md", _readme(dataset, published, parts, notes).encode(), "What is here, for people"),
        Part("LICENSE.txt", _license(published).encode(), "Under which terms the data may be used"),
        Part("CITATION.cff", _citation(dataset, published).encode(), "How to cite the data"),
    ]
    description = json.dumps(_data_package(dataset, published, [*parts, *made]), indent=1, ensure_ascii=False) + "\n"
    made.append(Part("datapackage.json", description.encode(), "What is here, for machines"))
    sums = "".join(f"{_sha256(part)}  {part.path}\n" for part in sorted([*parts, *made], key=lambda part: part.path))
    return [*made, Part("SHA256SUMS", sums.encode(), "Checksums of all other files")]


def title(dataset: Dataset) -> str:
    """What a package is called."""
    kind = {"measured": "Measured", "simulated": "Simulated", "imported": "Imported"}[dataset.kind]
    return f"{kind} in-plane spectral BRDF of {dataset.sample}"


def _sha256(part: Part) -> str:
    return hashlib.sha256(part.content).hexdigest()


def _abstract(dataset: Dataset) -> str:
    return (
        f"{dataset.theta_in.size} pairs of directions in the plane of incidence, at {dataset.wavelengths.size} "
        f"wavelengths from {dataset.wavelengths[0]:.0f} to {dataset.wavelengths[-1]:.0f} nm, with standard "
        f"uncertainties (coverage factor 1) and how their errors are correlated."
    )


def _readme(dataset: Dataset, published: Published, parts: list[Part], notes: list[str]) -> str:
    listed = "\n".join(f"| `{part.path}` | {part.about} |" for part in parts)
    said = "".join(f"\n- {note}" for note in notes)
    name, address = LICENSES[published.license]
    return f"""# {title(dataset)}

{_abstract(dataset)}

By {"; ".join(published.creators)}. Licence: {name} ({published.license}), {address}.
How to cite it stands in `CITATION.cff`.

| File | What it holds |
|---|---|
{listed}

Angles are in degrees from the surface normal. theta_out is signed: the mirror direction is theta_out = theta_in, the
way back to the lamp theta_out = -theta_in. Wavelengths are in nm, the BRDF in 1/sr. An uncertainty is a standard
uncertainty (k = 1). In tables an empty cell is no value; a point with a flag is kept, and the flag says what is
doubtful. Fits hold model, parameters, their uncertainties and a verdict whether to trust them.
{said}

`sha256sum -c SHA256SUMS` tells whether the files are whole; `datapackage.json` says the same to machines. The dataset
has the hash {dataset.content_hash}. goniometer {software_version()} wrote it, and reads its HDF5 and CSV back as the
very same dataset: `goniometer import data/brdf.h5`.
"""


def _license(published: Published) -> str:
    name, address = LICENSES[published.license]
    return (
        f"Copyright {published.created[:4]} {'; '.join(published.creators)}\n\n"
        f"These data are licensed under {name}.\nSPDX-License-Identifier: {published.license}\n{address}\n"
    )


def _citation(dataset: Dataset, published: Published) -> str:
    content = {
        "cff-version": "1.2.0",
        "message": "If you use these data, please cite them as below.",
        "type": "dataset",
        "title": title(dataset),
        "abstract": _abstract(dataset),
        "authors": [_author(creator) for creator in published.creators],
        "date-released": published.created[:10],
        "license": published.license,
        "keywords": KEYWORDS,
    }
    text: str = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100)
    return text


def _author(creator: str) -> dict[str, str]:
    """A person where there is one comma, else an organisation."""
    family, comma, given = (part.strip() for part in creator.partition(","))
    if comma and family and given:
        return {"family-names": family, "given-names": given}
    return {"name": creator.strip()}


def _data_package(dataset: Dataset, published: Published, parts: list[Part]) -> dict[str, object]:
    name, address = LICENSES[published.license]
    return {
        "profile": "data-package",
        "name": f"brdf-{dataset.content_hash[:12]}",
        "title": title(dataset),
        "description": _abstract(dataset),
        "created": published.created,
        "keywords": KEYWORDS,
        "licenses": [{"name": published.license, "title": name, "path": address}],
        "contributors": [{"title": creator, "role": "author"} for creator in published.creators],
        "dataset_sha256": dataset.content_hash,
        "software": {"name": "goniometer", "version": software_version()},
        "resources": [_resource(dataset, part) for part in parts],
    }


def _resource(dataset: Dataset, part: Part) -> dict[str, object]:
    ending = part.path.rpartition(".")[2].lower()
    found: dict[str, object] = {
        "name": part.path.lower().replace(" ", "-"),
        "path": part.path,
        "title": part.about,
        "format": ending,
        "mediatype": _MEDIA_TYPES.get(ending, "application/octet-stream"),
        "bytes": len(part.content),
        "hash": f"sha256:{_sha256(part)}",
    }
    if part.path != "data/brdf.csv":
        return found
    fields = [
        {
            "name": name,
            "type": "integer" if name in {"point", "flags"} else "number",
            "description": MEANINGS.get(name, "what one standard uncertainty of a source of error does to brdf"),
            "unit": UNITS.get(name, "1/sr"),
        }
        for name in columns(dataset)
    ]
    fields[0] |= {"description": "number of the point, from 0", "unit": "1"}
    return found | {
        "profile": "tabular-data-resource",
        "encoding": "utf-8",
        "dialect": {"commentChar": "#"},
        "schema": {"fields": fields, "missingValues": [""]},
    }
