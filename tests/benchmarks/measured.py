"""A campaign measured on the simulated bench, through the drivers, as an operator would run it."""

import asyncio

from api.service import open_bench
from goniometer.campaigns.campaign import Campaign
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from simulators.materials.materials import PANEL_CERTIFICATE


def measure(store: Store, campaign: Campaign, imperfections: Imperfections | None = None) -> list[Scan]:
    """Run `campaign` and return its scans; `imperfections` of None are drawn from its seed."""

    async def nobody(scan: Scan) -> None:
        raise AssertionError(f"asked a person to mount {scan.sample}")

    async def run() -> None:
        async with open_bench(None, campaign.seed, nobody, imperfections=imperfections) as (instrument, mount):
            text = certificate_csv(PANEL_CERTIFICATE)
            await run_campaign(store, campaign, instrument, mount, lambda _: None, lambda _: None, text)

    asyncio.run(run())
    return store.scans()
