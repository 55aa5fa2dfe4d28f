"""Which dataset is meant by a name, and how one is made from raw data."""

import hashlib
from dataclasses import replace

from goniometer.certificates.certificate import Override
from goniometer.certificates.certificate_file import parse_certificate
from goniometer.datasets.dataset import Dataset, Kind, kind_of
from goniometer.errors import InputError, NotInStore, OptionError
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.radiometry.response import STANDARD, Settings
from goniometer.scans.exposure import below_wanted
from goniometer.storage import look_up
from goniometer.storage.catalogue import Wanted
from goniometer.storage.lineage import own_datasets
from goniometer.storage.records import Scan
from goniometer.storage.store import Store

_NAMED = 50
"""Datasets that are named to who asks for another."""


def is_called(scan: Scan, name: str) -> bool:
    """Whether a person may mean `scan` by `name`: the name of its sample, with or without the number of the repeat."""
    return name.lower() in {scan.sample.lower(), scan.name.lower()}


def campaign_datasets(store: Store, campaign_id: int) -> dict[str, Dataset]:
    """What a campaign has made so far: the newest own dataset of every measurement by its name, in their order."""
    newest = {scan.name: max(own_datasets(store, scan.id), default=None) for scan in store.scans(campaign_id)}
    return {name: store.dataset(dataset_id) for name, dataset_id in newest.items() if dataset_id is not None}


def dataset_names(store: Store, dataset_id: int) -> tuple[str, str]:
    """The name of the sample of a dataset, and that with the number of the repeat; raises `NotInStore`."""
    entry = store.entry(dataset_id)
    return entry.sample if entry.scan_id is None else store.scan(entry.scan_id).sample, entry.sample


def find_datasets(store: Store, name: str) -> list[int]:
    """Ids of the datasets called `name`, oldest first: one by its number, those of one repeat, or all of a sample.

    Raises `NotInStore` with the names of the newest that there are.
    """
    # more digits than an id has are no id
    if name.isdecimal() and len(name) < 19 and store.has_dataset(int(name)):
        return [int(name)]
    found = store.called(name)
    if not found:
        newest = store.entries(Wanted(), _NAMED + 1)
        older = "older ones, " if len(newest) > _NAMED else ""
        known = ", ".join(f'{entry.id} ("{entry.sample}")' for entry in reversed(newest[:_NAMED])) or "none yet"
        raise NotInStore(f'There is no dataset "{name}"; there are: {older}{known}.')
    return found


def uncalibrated_scan(store: Store, name: str) -> Scan | None:
    """The newest completed scan of the sample `name` that has no dataset; None where there is none."""
    found = look_up.uncalibrated_scans(store)
    return next((scan for scan in reversed(found) if is_called(scan, name)), None)


def make_dataset(
    store: Store,
    scan_id: int,
    *,
    made_from: int | None = None,
    certificate: str | None = None,
    settings: Settings = STANDARD,
    override: Override | None = None,
) -> int:
    """Calibrate a scan, write the result beside what there is, and return the id of the new dataset.

    `made_from` is the dataset of the same raw data that is made anew. `certificate` is the text of a certificate, None
    for that of this dataset, or else of the campaign. Raises `CertificateError` where the certificate cannot be
    used, `OptionError` for an `override` of one that was valid, and `CalibrationError`.
    """
    where = "the given certificate" if certificate is not None else f"certificate of dataset {made_from}"
    text = certificate
    if text is None and made_from is not None:
        text = store.dataset_certificate(made_from)
    panel = None if text is None else parse_certificate(text, where)
    dataset = calibrate_scan(store, scan_id, settings, panel, override)
    lineage = dict(dataset.lineage)
    if override is not None and lineage["certificate_override"] is None:
        raise OptionError(
            f"{{override_name}} and {{override_reason}} have no use for scan {scan_id}: the certificate "
            f"{lineage['certificate']} was valid on the day of its reference scan; leave them out.",
            "override_name",
            "override_reason",
        )
    used = store.certificate(store.scan(scan_id).campaign_id) if text is None else text
    if used is not None:
        lineage["certificate_sha256"] = hashlib.sha256(used.encode()).hexdigest()
    if made_from is not None:
        lineage["recalibrated_from"] = made_from
    return store.add_dataset(scan_id, replace(dataset, lineage=lineage), text)


def too_noisy(store: Store, scan: Scan) -> str:
    """Which points of a scan missed the signal-to-noise ratio that its campaign wants; empty where none did."""
    return below_wanted(store.points(scan.id), store.campaign(scan.campaign_id).integration.signal_to_noise)


_WITHOUT_RAW_DATA: dict[Kind, str] = {
    "simulated": "was simulated and has no raw data; simulate it again instead.",
    "measured": "came from a file, and its raw data are in another database; calibrate it there.",
    "imported": "was imported and has no raw data; import its file again instead.",
}


def recalibrate(
    store: Store, dataset_id: int, certificate: str | None, settings: Settings, override: Override | None
) -> int:
    """Calibrate the raw data of a dataset anew, and return the id of the new one; see `make_dataset`.

    Raises `InputError` for a dataset without raw data.
    """
    scan_id = store.scan_of(dataset_id)
    if scan_id is None:
        raise InputError(f"Dataset {dataset_id} {_WITHOUT_RAW_DATA[kind_of(store.lineage(dataset_id))]}")
    return make_dataset(
        store, scan_id, made_from=dataset_id, certificate=certificate, settings=settings, override=override
    )
