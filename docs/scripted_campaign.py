"""Campaigns from Python: one that repeats, and another that goes on where the budget of the first says that it must.

    python docs/scripted_campaign.py                     # on the simulated bench
    python docs/scripted_campaign.py INSTRUMENT_FILE     # on a real one; it asks for panel and sample on the terminal

A sheet is measured twice on a coarse grid, ten minutes apart, with a warm lamp. Where reading its BRDF between
the directions is less certain than the measured directions themselves, it is measured again, at those incident angles
only, in the directions that a plan finds. Stop the script at any moment and start it again: a campaign that is complete
is not measured again, and one that is not goes on where it stood.
"""

import asyncio
import sys
from pathlib import Path

import numpy as np

from api.datasets import campaign_datasets
from api.service import open_bench, run
from api.settings import load_instrument
from api.terminal import ask_to_mount
from goniometer.campaigns.campaign import Campaign, Resolution, Sample
from goniometer.campaigns.conditions import Conditions
from goniometer.datasets.between import interpolate
from goniometer.datasets.dataset import Dataset
from goniometer.storage.store import Store

# A campaign has the keys of docs/campaign.yaml and checks them as it does those of a file.
CAMPAIGN = Campaign(
    name="Sheet",
    samples=(Sample(name="Sheet", material="sample-5", repeats=2, wait="10 min"),),
    incident=(20, 60),
    resolution=Resolution(mode="uniform", step=30),
    conditions=Conditions(lamp_warm="20 min", lamp_change="0.2 %"),
)


def uncertainties(dataset: Dataset, theta_in: float) -> tuple[float, float]:
    """Relative standard uncertainties at one incident angle: where it was measured, and at worst between (medians)."""
    here = np.isclose(dataset.theta_in, theta_in, atol=0.1) & dataset.usable
    directions = np.arange(0.0, 80.0, 2.5)
    between = interpolate(dataset, np.full(directions.size, theta_in), directions)
    measured = np.median(dataset.u[here] / dataset.brdf[here])
    return float(measured), float(np.median(between.u / between.brdf, axis=1).max())


async def measure(instrument_file: str | None) -> None:
    """Measure until the budget is content, or the plan has done what it can."""
    store = Store.open("scripted.db")
    settings = None if instrument_file is None else load_instrument(Path(instrument_file))
    campaigns = [CAMPAIGN]
    async with open_bench(settings, seed=1, ask=ask_to_mount) as bench:  # once: its lamp stays warm
        for campaign in campaigns:
            result = await run(store, campaign, Path("results") / campaign.name, settings, bench=bench)
            datasets = campaign_datasets(store, result.campaign_id)  # by name, here "Sheet #1" and "Sheet #2"
            for name, dataset in datasets.items():
                print(f"{campaign.name}, {name}: {len(dataset.theta_in)} directions")
            known = {theta_in: uncertainties(dataset, theta_in) for theta_in in campaign.theta_in}
            for theta_in, (measured, between) in known.items():
                print(f"  theta_in {theta_in:g}°: {measured:.1%} measured, up to {between:.1%} between (k = 1)")
            poor = tuple(theta_in for theta_in, (measured, between) in known.items() if between > measured)
            if poor and campaign is CAMPAIGN:
                changes = {
                    "name": "Sheet, finer",
                    "samples": (CAMPAIGN.samples[0].model_copy(update={"repeats": 1}),),
                    "incident": poor,
                    "resolution": Resolution(tolerance=0.05, colour_tolerance=None),
                }
                campaigns.append(CAMPAIGN.model_copy(update=changes))


if __name__ == "__main__":  # fits run in a process of their own, which reads this file as well
    asyncio.run(measure(*sys.argv[1:2] or [None]))
