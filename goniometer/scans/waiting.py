"""What a scan waits for before it measures: a time, and the conditions of its campaign.

All of it passes on the clock of the bench. Conditions are looked at one after the other, the lamp last, as it changes
while the others are waited for. By how much it changes is measured: spectra in the direction in which it is monitored,
of one integration time and without their dark signal, as the sum over the pixels that are not saturated. They tell
nothing about the sample, so only their darks are written.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.errors import DeviceTimeout
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import ConditionsUnmet
from goniometer.plans.plan_spec import monitor_direction, plan_spec
from goniometer.scans.auxiliary import Darks
from goniometer.scans.exposure import Detector, once, take
from goniometer.scans.progress import Waiting

TOLD_EVERY = 10.0
"""Seconds of bench time between two words about what is waited for."""

Tell = Callable[[Waiting], None]


async def pass_time(clock: Clock, seconds: float, what: str, tell: Tell) -> None:
    """Return when `seconds` have passed on the clock of the bench."""
    end = clock.now() + seconds
    while (left := end - clock.now()) > 0:
        tell(Waiting(what, left))
        await clock.sleep(min(left, TOLD_EVERY))


@dataclass(frozen=True)
class _Look:
    """A spectrum of the lamp."""

    moment: float
    """When it was taken, seconds on the clock of the bench."""
    time: float
    """Integration time, seconds."""
    light: FloatArray
    """[pixels] counts without dark signal; not a number where saturated."""


class Readiness:
    """The conditions of a campaign on the bench; patience with them begins now."""

    def __init__(
        self, campaign: Campaign, instrument: Instrument, detector: Detector, darks: Darks, tell: Tell
    ) -> None:
        self._campaign = campaign
        self._wanted = campaign.conditions
        self._instrument = instrument
        self._clock = instrument.clock
        self._detector = detector
        self._darks = darks
        self._tell = tell
        self._deadline = self._clock.now() + self._wanted.patience

    async def reach(self) -> None:
        """Return when all conditions hold.

        Raises `ConditionsUnmet` where one does not in time, `DriverError`, and `GeometryError` where the arm cannot go
        to where the lamp is monitored.
        """
        if self._wanted.cooler_stable:
            await self._cooler_is_stable()
        if self._wanted.lamp_warm is not None:
            await self._lamp_is_warm(self._wanted.lamp_warm)
        if self._wanted.lamp_change is not None:
            await self._lamp_is_steady(self._wanted.lamp_change, self._wanted.lamp_change_within)

    async def _cooler_is_stable(self) -> None:
        while True:
            try:
                return await self._instrument.wait_until_cold()
            except DeviceTimeout as error:
                self._check_patience(0.0, str(error))
                self._tell(Waiting("cooling the detector", None))

    async def _lamp_is_warm(self, least: float) -> None:
        missing = least - self._instrument.lamp_on_for
        if missing > 0:
            is_on = f"the lamp has been on for {least - missing:.0f} s of {least:g} s"
            self._check_patience(missing, is_on)
            await pass_time(self._clock, missing, "warming the lamp", self._tell)

    async def _lamp_is_steady(self, most: float, within: float) -> None:
        await self._instrument.arm.goto(monitor_direction(plan_spec(self._campaign)))
        before, change = await self._look(None), np.inf
        while True:
            pause = max(before.moment + within - before.time / 2 - self._clock.now(), 0.0)
            known = "" if np.isinf(change) else f", which changed by {100 * change:.2g} % in {within:g} s"
            self._check_patience(pause, f"the signal of the lamp{known} must change by less than {100 * most:.3g} %")
            await pass_time(self._clock, pause, f"watching the lamp{known}", self._tell)
            now = await self._look(before.time)
            seen = np.isfinite(before.light) & np.isfinite(now.light)
            signal = before.light[seen].sum()
            if not signal > 0:
                raise ConditionsUnmet(
                    "Where the lamp is monitored no light is seen, or nothing but saturation, so nobody knows whether "
                    "it is steady; look whether it burns, or leave lamp_change out of the conditions"
                )
            change = abs(float(now.light[seen].sum() / signal) - 1)
            if change < most:
                return
            before = now

    async def _look(self, time: float | None) -> _Look:
        """A spectrum of `time` seconds, None for a time that suits what is seen."""
        if time is None:
            taken = await take(self._instrument, self._detector, once(self._campaign.integration), None, self._darks.of)
            spectrum, moment = taken.spectra[0], taken.moment
        else:
            spectrum = await self._instrument.expose(time)
            moment = self._clock.now() - time / 2
        dark = await self._darks.of(spectrum.integration_time, spectrum.detector_temperature)
        light = np.where(spectrum.counts < self._detector.saturation, spectrum.counts - dark.mean, np.nan)
        return _Look(moment, spectrum.integration_time, light)

    def _check_patience(self, pause: float, what: str) -> None:
        """Raise `ConditionsUnmet` where patience ends before `pause` seconds have passed."""
        if self._clock.now() + pause > self._deadline:
            raise ConditionsUnmet(
                f"A condition of the campaign did not hold within a patience of {self._wanted.patience:g} s: "
                f"{what.rstrip('.')}; find the cause and run the campaign again, or change its conditions"
            )
