"""Where a dataset comes from and what was made of it: raw -> dark -> reference -> BRDF -> fits and files."""

from pathlib import Path
from typing import Any

from api.bodies.datasets import Lineage, LineageNode, NodeKind
from api.views.opened import Opened
from goniometer.storage.archive_file import archive_of
from goniometer.storage.store import Store


def lineage(store: Store, opened: Opened) -> Lineage:
    """The tree of a dataset."""
    entry, told = opened.entry, dict(opened.dataset.lineage)
    sources: list[LineageNode] = []
    if "imported" in told:
        sources.append(LineageNode(kind="file", title=str(told.pop("imported")), about=_words(told)))
    elif "simulated" in told:
        sources.append(LineageNode(kind="simulation", title=str(told.pop("simulated")), about=_words(told)))
    elif entry.scan_id is not None:
        sources = _measured(store, entry.scan_id, told)
    else:
        sources.append(LineageNode(kind="file", title="a file of this program; its raw data are in another database"))
    if entry.recalibrated_from is not None:
        before = entry.recalibrated_from
        sources.append(LineageNode(kind="dataset", title=f"dataset {before}, made anew", href=_dataset(before)))
    root = LineageNode(
        kind="dataset",
        title=f"{entry.sample}, dataset {entry.id}",
        href=_dataset(entry.id),
        ids=[entry.id],
        about={
            "content_sha256": entry.content_hash,
            "software_version": entry.software_version,
            "created": entry.created,
        }
        | _words({name: told[name] for name in ("corrections", "parameters", "devices", "material") if name in told}),
        sources=sources,
    )
    return Lineage(dataset=root, derived=_derived(store, opened))


def _measured(store: Store, scan_id: int, told: dict[str, Any]) -> list[LineageNode]:
    scan = store.scan(scan_id)
    known = {
        "serial_number": told.get("certificate"),
        "calibrated": told.get("certificate_calibrated"),
        "valid_until": told.get("certificate_valid_until"),
        "sha256": told.get("certificate_sha256"),
        "override": told.get("certificate_override"),
    }
    sha = told.get("certificate_sha256")
    certificate = LineageNode(
        kind="certificate",
        title=f"certificate {told.get('certificate')}",
        href=None if sha is None else f"/api/certificates/{sha}",
        about=_words(known),
    )
    reference = LineageNode(
        kind="reference",
        title="scan of the reference panel",
        href=f"/api/scans/{told['reference_scan']}" if "reference_scan" in told else None,
        ids=[int(told["reference_scan"])] if "reference_scan" in told else [],
        sources=[*_exposures(told, "reference_"), certificate],
    )
    archive = archive_of(store, scan_id)
    own = LineageNode(
        kind="scan",
        title=f"scan of {scan.name}",
        href=f"/api/scans/{scan_id}",
        ids=[scan_id],
        about=_words({"started": scan.started, "finished": scan.finished, "raw_counts": archive and archive.path}),
        sources=_exposures(told, ""),
    )
    return [own, reference]


_RAW: tuple[tuple[NodeKind, str], ...] = (
    ("exposures", "raw exposures"),
    ("darks", "dark spectra"),
    ("stray", "stray light"),
    ("monitors", "exposures that watch the lamp"),
)


def _exposures(told: dict[str, Any], prefix: str) -> list[LineageNode]:
    found = []
    for kind, title in _RAW:
        ids = [int(each) for each in told.get(prefix + kind, ())]
        if ids:
            found.append(LineageNode(kind=kind, title=title, href=f"/api/exposures/{ids[0]}", ids=ids))
    return found


def _derived(store: Store, opened: Opened) -> list[LineageNode]:
    fits = [LineageNode(kind="fit", title=fit.kind, href=f"/api/fits/{fit.id}", ids=[fit.id]) for fit in opened.fits]
    exports = [
        LineageNode(
            kind="export",
            title=f"{each.kind}: {Path(each.text).name}",
            href=f"/api/exports/{each.id}/file",
            ids=[each.id],
        )
        for each in store.exports(opened.entry.id)
    ]
    anew = [
        LineageNode(kind="dataset", title=f"dataset {each}, made anew", href=_dataset(each), ids=[each])
        for each in store.recalibrations(opened.entry.id)
    ]
    return [*fits, *exports, *anew]


def _dataset(dataset_id: int) -> str:
    return f"/api/datasets/{dataset_id}"


def _words(values: dict[str, Any]) -> dict[str, str]:
    return {name: _text(value) for name, value in values.items() if value is not None}


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_text(each)}" for name, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    return str(value)
