"""How well the time of a scan is known: beforehand, and while its points tell.

`python -m tests.benchmarks.time_left` runs a campaign of three materials on the simulated bench and prints, for each
scan, the time on the clock of the bench that it took, beside what the preview said and what was told when a quarter,
half and three quarters of it were over. A ratio is foreseen over true; a star says that the truth lies outside the
limits.
"""

import asyncio
import tempfile
from pathlib import Path

from api.preview import preview
from api.service import open_instrument
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.scans.progress import Progress
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.records import Expected
from goniometer.storage.store import Store
from simulators.materials.materials import PANEL_CERTIFICATE
from tests.benchmarks.figures import tell

MATERIALS = ("sample-1", "sample-4", "mirror")
CAMPAIGN = Campaign(name="Time", seed=3, samples=tuple(Sample(name=name, material=name) for name in MATERIALS))
PARTS = (0.25, 0.5, 0.75)


async def watch(store: Store) -> tuple[list[tuple[float, Progress]], tuple[Expected, ...]]:
    """Run the campaign; returns every progress with the moment on the clock of the bench, and the preview."""
    told: list[tuple[float, Progress]] = []
    async with open_instrument(None, CAMPAIGN.seed) as (instrument, laboratory):
        assert laboratory is not None
        clock = laboratory.clock

        async def mount(scan):
            laboratory.mount(scan.material)

        def report(progress: Progress) -> None:
            told.append((clock.now(), progress))

        certificate = certificate_csv(PANEL_CERTIFICATE)
        await run_campaign(store, CAMPAIGN, instrument, mount, report, lambda _: None, certificate)
        return told, tuple(leg.time for leg in preview(CAMPAIGN, instrument.arm.motion).legs)


def compared(foreseen: Expected, true: float) -> str:
    """Ratio with its limits, and a star where these are missed."""
    missed = " " if foreseen.low <= true <= foreseen.high else "*"
    return f"{foreseen.seconds / true:5.2f} ({foreseen.low / true:.2f} to {foreseen.high / true:.2f}){missed}"


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "bench.db")
        told, before = asyncio.run(watch(store))
        store.close()
    print(
        f"{'scan':<12}{'true, s':>8}{'points':>8}   {'preview':<24}", *(f"after {part:.0%}".ljust(24) for part in PARTS)
    )
    compare: list[str] = []
    for foreseen, name in zip(before, ("reference", *MATERIALS), strict=True):
        mine = [(moment, progress) for moment, progress in told if progress.sample == name]
        begin, end = mine[0][0], mine[-1][0]
        cells = [compared(foreseen, end - begin)]
        for part in PARTS:
            moment, progress = min(mine, key=lambda each: abs(each[0] - begin - part * (end - begin)))
            cells.append(compared(progress.bench_remaining, end - moment))
        compare += cells
        print(f"{name:<12}{end - begin:8.0f}{mine[-1][1].done:8d}  ", *(cell.ljust(24) for cell in cells))
        tell(f"{name}: time of the preview over the true one", foreseen.seconds / (end - begin))
    inside = sum(not cell.endswith("*") for cell in compare)
    tell("foreseen times whose limits hold the truth", inside, f"of {len(compare)}")


if __name__ == "__main__":
    main()
