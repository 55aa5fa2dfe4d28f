"""The whole job on the simulated bench: Samples 1, 4 and the mirror from the wire to the report."""

import time
from dataclasses import dataclass
from pathlib import Path

from api.results.outcome import SampleOutcome, outcomes
from api.service import Watch, run
from api.written import make_folder
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.storage.store import Store

SAMPLES = (
    Sample(
        name="Sample 1",
        material="sample-1",
        description="Sandblasted aluminium AlMg3, rms roughness 2.39 um",
        preparation="Glass beads of 70-100 um at 6.5 bar from 100 mm",
    ),
    Sample(
        name="Sample 4",
        material="sample-4",
        description="Sandblasted aluminium AlMg3, rms roughness 0.98 um",
        preparation="Glass beads of 70-100 um at 2 bar from 100 mm",
    ),
    Sample(
        name="Mirror",
        material="mirror",
        description="Polished aluminium AlMg3 (Sample 6), rms roughness 0.10 um",
        preparation="Polished, not sandblasted",
    ),
)


@dataclass(frozen=True)
class DemoResult:
    """What the demo came to."""

    database: str
    seed: int
    seconds: float
    """Real time of this call."""
    bench_seconds: float
    """Time that all points took on the simulated bench, those of the reference panel included."""
    samples: list[SampleOutcome]
    failures: tuple[str, ...]
    """Why samples that were measured have no fits; empty when all have."""


async def demo(output: Path, seed: int, watch: Watch, cluster: str | None = None) -> DemoResult:
    """Run or resume the demo in the folder `output`; when it is complete, only its results are shown.

    Fits run on the Dask scheduler `cluster`, where there is one. Raises what `api.service.run` raises; `CampaignError`
    when `output` holds a demo with another seed.
    """
    began = time.monotonic()
    make_folder(output)
    database = output / "goniometer.db"
    store = Store.open(database)
    # The lamp of the simulated bench does not drift; looks at it are bound to time, which a killed run cannot repeat.
    campaign = Campaign(name="Demo", seed=seed, samples=SAMPLES, monitor=None)
    result = await run(store, campaign, output, None, watch, cluster=cluster)
    campaign_id = result.campaign_id
    samples = outcomes(store, campaign_id, truth=True)
    bench_seconds = sum(point.seconds for scan in store.scans(campaign_id) for point in store.points(scan.id))
    store.close()
    return DemoResult(str(database), seed, time.monotonic() - began, bench_seconds, samples, result.failures)
