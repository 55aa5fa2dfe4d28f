"""A night on the simulated bench: a campaign is run while faults strike, and run again by an operator who repairs."""

import asyncio
import random
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from drivers.errors import DriverError
from drivers.k10cr1 import K10CR1
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.qepro import QEPro, QEProLight
from drivers.smc100 import SMC100
from goniometer.bench.instrument import RECOVERY_PAUSES, Instrument
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import ReferenceIncomplete
from goniometer.scans.progress import Progress
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.bench.laboratory import COUNTS_PER_DEGREE, FAMILIES, STAGES, Laboratory, simulated_laboratory
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from simulators.devices.oriental_az import SimulatedOrientalAZ
from simulators.devices.qepro import QEProFaults
from tests.stage_bench import PATIENCE, give_time

TIMEOUT = 0.1
"""Real seconds that a driver waits for a reply."""
LASTS = 0.12
"""Seconds of a fault that lasts."""
RTU = "oriental-az on a serial line"
"""A family of stages beside those of the laboratory."""
STAGE_LIMITS = {"sample stage": (-5.0, 90.0), "detector stage": (-90.0, 175.0)}
ROLES = ("sample_stage", "detector_stage", "spectrometer")
"""The devices of a laboratory that can be struck."""

Disturb = Callable[[Laboratory, Progress], None]
"""Called at every progress; what it does to the laboratory is the night's misfortune."""


class PatientClock(SimulatedClock):
    """Simulated time whose pauses of a recovery also take a little real time, as unplugging does."""

    async def sleep(self, seconds: float) -> None:
        """Let `seconds` pass."""
        if seconds in RECOVERY_PAUSES:
            await asyncio.sleep(seconds / 200)
        await super().sleep(seconds)


def repair(laboratory: Laboratory) -> None:
    """Put right what only a person can, and let nothing more befall the devices; it takes a minute."""
    sound = {"_encoder_error": 0.0, "_drift": 0.0, "_zero": 0.0, "_slowness": 1.0, "_refusing": False}
    for role in ROLES:
        device: Any = getattr(laboratory, role)
        device.script = FaultScript()
        for name, value in sound.items():
            if hasattr(device, name):
                setattr(device, name, value)
    laboratory.spectrometer.faults = QEProFaults()
    laboratory.clock.advance_to(laboratory.clock.now() + 60.0)
    time.sleep(LASTS)


def _stage(name: str, family: str, url: str, clock: SimulatedClock) -> Any:
    limits = STAGE_LIMITS[name]
    if family == "owis":
        return OwisPS(name, url, clock, counts_per_degree=COUNTS_PER_DEGREE, limits=limits, timeout=TIMEOUT)
    drivers: dict[str, Any] = {"smc100": SMC100, "k10cr1": K10CR1, "oriental-az": OrientalAZ, RTU: OrientalAZ}
    return drivers[family](name, url, clock, limits=limits, timeout=TIMEOUT)


@contextmanager
def bench(seed: int, stages: tuple[str, str] = STAGES) -> Iterator[tuple[Laboratory, Instrument]]:
    """A laboratory, and an instrument in it that is not yet open."""
    with (
        patch("simulators.bench.laboratory.SimulatedClock", PatientClock),
        patch.dict(FAMILIES, {RTU: lambda axis, _: SimulatedOrientalAZ(axis, rtu=True)}),
        simulated_laboratory(seed, stages) as laboratory,
    ):
        clock = laboratory.clock
        spectrometer = QEPro("QE Pro", clock, usb_backend=laboratory.usb_backend, timeout=TIMEOUT)
        sample, detector = laboratory.families
        yield (
            laboratory,
            Instrument(
                _stage("sample stage", sample, laboratory.sample_stage_url, clock),
                _stage("detector stage", detector, laboratory.detector_stage_url, clock),
                spectrometer,
                QEProLight(spectrometer),
                clock,
                data=laboratory.data,
            ),
        )


def run(
    store: Store,
    campaign: Campaign,
    stages: tuple[str, str],
    disturb: Disturb,
    *,
    runs: int = 2,
    quiet_last: bool = True,
) -> list[str]:
    """Run the campaign until it is completed; returns the typed errors that ended the runs before.

    After each the operator repairs the bench and runs the campaign again, `runs` times in all; the last of them is
    left in peace where `quiet_last`. Whatever is no typed error is raised, and so is the error of the last run.
    """
    ended: list[str] = []
    with bench(campaign.seed, stages) as (laboratory, instrument), store.exclusive():

        async def mount(scan: Any) -> None:
            laboratory.bench.mount(scan.material)

        async def one(report: Callable[[Progress], None]) -> None:
            give_time(PATIENCE, *instrument.arm.stages)  # nothing befalls what is being opened
            await instrument.open()
            give_time(TIMEOUT, *instrument.arm.stages)
            try:
                await run_campaign(store, campaign, instrument, mount, report, lambda _: None)
            finally:
                await _quietly(instrument.close())

        for number in range(1, runs + 1):
            left_in_peace = quiet_last and number == runs
            try:
                asyncio.run(one((lambda _: None) if left_in_peace else lambda progress: disturb(laboratory, progress)))
                break
            except (DriverError, ReferenceIncomplete) as error:
                if number == runs:
                    raise
                ended.append(type(error).__name__)
                repair(laboratory)
    return ended


async def _quietly(action: Awaitable[None]) -> None:
    try:
        await action
    except DriverError:
        return


def chance(*key: object) -> random.Random:
    """Random numbers that depend on `key` only."""
    return random.Random(repr(key))
