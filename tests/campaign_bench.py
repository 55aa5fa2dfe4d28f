"""Campaigns on the wire-level simulators: the real drivers talk to simulated devices."""

from contextlib import asynccontextmanager

from drivers.oriental_az import OrientalAZ
from drivers.qepro import QEPro, QEProLight
from drivers.smc100 import SMC100
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Override, Reference
from goniometer.scans.scheduler import run_campaign
from simulators.bench.imperfections import IDEAL
from simulators.bench.laboratory import simulated_laboratory

NOMINAL_PANEL = Reference(override=Override(name="Test", reason="The panel of the simulated bench is nominal."))


@asynccontextmanager
async def bench(seed, imperfections=IDEAL):
    """An instrument in a simulated laboratory, what a person does who mounts samples, and the laboratory."""
    with simulated_laboratory(seed, imperfections=imperfections) as laboratory:
        spectrometer = QEPro("QE Pro", laboratory.clock, usb_backend=laboratory.usb_backend)
        instrument = Instrument(
            SMC100("sample stage", laboratory.sample_stage_url, laboratory.clock),
            OrientalAZ("detector stage", laboratory.detector_stage_url, laboratory.clock),
            spectrometer,
            QEProLight(spectrometer),
            laboratory.clock,
            data=laboratory.data,
        )
        await instrument.open()

        async def mount(scan):
            laboratory.mount(scan.material, spot=int(scan.kind == "spot"))

        try:
            yield instrument, mount, laboratory
        finally:
            await instrument.close()


async def run(
    store, campaign, report=lambda _: None, finished=lambda _: None, change=lambda _: None, imperfections=IDEAL
):
    """Run a campaign on a fresh bench; `change` may tamper with the instrument."""
    async with bench(campaign.seed, imperfections) as (instrument, mount, _):
        change(instrument)
        with store.exclusive():
            await run_campaign(store, campaign, instrument, mount, report, finished)
