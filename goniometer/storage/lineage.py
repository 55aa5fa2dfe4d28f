"""Which datasets a scan has, and which it lacks."""

from goniometer.storage.records import Scan
from goniometer.storage.store import Store


def own_datasets(store: Store, scan_id: int) -> dict[int, dict[str, object]]:
    """Lineage of every dataset that was made of a scan by its id, oldest first, without those made anew from another.

    What somebody tries with another certificate or other corrections does not take the place of the campaign's result.
    """
    lineages = {dataset_id: store.lineage(dataset_id) for dataset_id in store.datasets(scan_id)}
    return {dataset_id: lineage for dataset_id, lineage in lineages.items() if "recalibrated_from" not in lineage}


def lacks_dataset(store: Store, scan: Scan) -> bool:
    """Whether `scan` is the completed one of a sample, and has no dataset or none that knows its completed spot."""
    if scan.kind != "sample" or scan.outcome != "completed":
        return False
    known = [lineage.get("spot_scan") for lineage in own_datasets(store, scan.id).values()]
    after = [s for s in store.scans(scan.campaign_id) if s.number == scan.number + 1]
    spots = [s.id for s in after if s.kind == "spot" and s.outcome == "completed"]
    return not known or any(spot not in known for spot in spots)
