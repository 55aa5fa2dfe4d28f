"""What a scan needs beside its points: darks, stray light, a pre-scan, and a look at the lamp again and again.

Whether something is missing is read from the database and from the clock of the bench, so that a resumed scan takes
what an uninterrupted one would have. Only the monitors are bound to time: every run of a scan begins and ends with one,
as nobody knows what the lamp did in between.
"""

import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import numpy as np

from drivers.arrays import CountArray
from drivers.interfaces import Spectrum
from goniometer.bench.instrument import Instrument
from goniometer.bench.moves import ARRIVAL
from goniometer.bench.safety import safe_path
from goniometer.bench.track import Passage
from goniometer.campaigns.campaign import Campaign, Prescan
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import monitor_direction, plan_spec
from goniometer.radiometry.raw import Dark, RawScan
from goniometer.scans.duration import DARKS, STRAY_SCANS, besides, unknown_darks, unknown_exposure
from goniometer.scans.exposure import DarkSignal, detector_of, ladder, once, step_down, take
from goniometer.scans.prescan import cost, way
from goniometer.storage.records import Expected
from goniometer.storage.store import Store

DARK_TEMPERATURE = 0.3
"""Degrees Celsius of the detector within which a dark is reused. Dark current doubles every 6 degrees or so, thus
changes by 3.5 %: of the 120 counts that it gives in 30 s at -10 degrees 4 counts, less than one read-out is uncertain.
"""

log = logging.getLogger(__name__)
T = TypeVar("T")


class Darks:
    """The dark signals of one scan, by integration time."""

    def __init__(self, store: Store, scan_id: int, instrument: Instrument, stored: Sequence[Dark]) -> None:
        self._store = store
        self._scan_id = scan_id
        self._instrument = instrument
        self._sets: dict[float, list[DarkSignal]] = {}
        for dark in stored:
            self._sets.setdefault(dark.integration_time, []).append(_signal(dark.counts, dark.temperature))

    def stored(self, integration_time: float, temperature: float) -> DarkSignal:
        """The first dark signal of this time, s, and temperature, degrees Celsius, else the nearest; there must be one.

        The first, and not the nearest: a set that is taken later must not change what an earlier point looked like.
        """
        sets = self._sets[integration_time]
        valid = (dark for dark in sets if abs(dark.temperature - temperature) <= DARK_TEMPERATURE)
        return next(valid, min(sets, key=lambda dark: abs(dark.temperature - temperature)))

    def to_come(self, campaign: Campaign) -> Expected:
        """Time for darks that a scan may still need, seconds: any of the times that it has not used yet, or none.

        Before it has used any, what a preview expects.
        """
        if not self._sets:
            return unknown_darks(campaign)
        policy = campaign.integration
        return Expected(0.0, 0.0, DARKS * sum(time for time in ladder(policy) if not self._sets.get(time)))

    async def of(self, integration_time: float, temperature: float) -> DarkSignal:
        """The dark signal of this time, s, and temperature, degrees Celsius; taken and written where none is valid."""
        sets = self._sets.setdefault(integration_time, [])
        if any(abs(dark.temperature - temperature) <= DARK_TEMPERATURE for dark in sets):
            return self.stored(integration_time, temperature)
        instrument = self._instrument
        began = instrument.clock.now()
        spectra = [await instrument.dark(integration_time) for _ in range(DARKS)]
        moment = (began + instrument.clock.now()) / 2
        self._store.add_exposures(self._scan_id, "dark", spectra, instrument.session, moment)
        counts = np.stack([s.counts for s in spectra])
        sets.append(_signal(counts, float(np.mean([s.detector_temperature for s in spectra]))))
        return sets[-1]


def _signal(counts: CountArray, temperature: float) -> DarkSignal:
    return DarkSignal(np.asarray(counts.mean(axis=0)), float(counts.var(axis=0, ddof=1).mean()), temperature)


class Auxiliary:
    """Stray light, sweeps and monitors of one run of a scan, of which `raw` holds what earlier runs have taken."""

    def __init__(self, store: Store, instrument: Instrument, campaign: Campaign, raw: RawScan, darks: Darks) -> None:
        self._store = store
        self._scan_id = raw.scan_id
        self._instrument = instrument
        self._campaign = campaign
        self._detector = detector_of(raw.constants)
        self._darks = darks
        self._spec = plan_spec(campaign, instrument.arm.motion)
        self._direction = monitor_direction(self._spec)
        self._prescan = campaign.prescan if store.scan(raw.scan_id).kind == "sample" else None
        self._swept = {sweep.shot.geometry.theta_in for sweep in raw.sweeps}
        self._settled = {shot.geometry.theta_in for shot in raw.stray}
        self._stray_time = raw.stray[-1].integration_time if raw.stray else None
        self._monitor_time = raw.monitors[0].integration_time if raw.monitors else None
        self._looked: float | None = None  # when this run looked at the lamp, on the clock of the bench

    async def before(self, point: Geometry) -> None:
        """Take what is due before `point` is measured. Raises `DriverError`.

        What the arm cannot reach, or from where it could not go on to the point, is left out with a warning.
        """
        monitor, now = self._campaign.monitor, self._instrument.clock.now()
        if monitor is not None and (self._looked is None or now - self._looked >= monitor.every):
            if self._looked is not None:
                self._looked = now  # what goes wrong now must not cost the point all its attempts
            await self._look_at_lamp(point)
        if self._campaign.stray_light and not any(abs(point.theta_in - t) <= ARRIVAL for t in self._settled):
            await self._take_stray(point)
        if self._prescan is not None and not any(abs(point.theta_in - t) <= ARRIVAL for t in self._swept):
            await self._sweep(point, self._prescan)

    def to_come(self, path: Sequence[Geometry], lasts: Expected) -> Expected:
        """Time for what is due before the points of `path`, which last so long, and after them."""
        campaign, policy = self._campaign, self._campaign.integration
        angles = {p.theta_in for p in path if all(abs(p.theta_in - t) > ARRIVAL for t in self._settled)}
        stray = policy.maximum if self._stray_time is None else self._stray_time
        time = self._monitor_time
        look = unknown_exposure(once(policy)) if time is None else Expected(time, time, time)
        motion = self._instrument.arm.motion
        due = besides(campaign, motion, len(angles), lasts, stray, look, self._darks.to_come(campaign))
        if self._prescan is None:
            return due
        unseen = [p for p in path if all(abs(p.theta_in - t) > ARRIVAL for t in self._swept)]
        sweeping = cost(unseen, self._spec, self._prescan, motion).seconds
        return due + Expected(sweeping, sweeping, sweeping)

    async def closing(self) -> None:
        """Look at the lamp once more after the last point. Raises `DriverError`."""
        if self._campaign.monitor is not None:
            await self._look_at_lamp(self._direction)

    async def _look_at_lamp(self, onward: Geometry) -> None:
        """One spectrum in the fixed direction, of the integration time of the first one of this scan."""
        instrument = self._instrument
        here = await self._reach("the lamp is not monitored", instrument.arm.goto, self._direction, onward)
        if here is None:
            self._looked = instrument.clock.now()  # not again at the next point
            return
        if self._monitor_time is None:
            taken = await take(instrument, self._detector, once(self._campaign.integration), None, self._darks.of)
            spectra, moment = taken.spectra, taken.moment
        else:
            spectra = [await instrument.expose(self._monitor_time)]
            moment = instrument.clock.now() - self._monitor_time / 2
            await self._has_dark(spectra)
        self._store.add_exposures(self._scan_id, "monitor", spectra, instrument.session, moment, here)
        self._monitor_time = spectra[0].integration_time
        self._looked = instrument.clock.now()

    async def _take_stray(self, point: Geometry) -> None:
        """`STRAY_SCANS` spectra of the longest time that does not saturate, with the detector before the source."""
        instrument, policy = self._instrument, self._campaign.integration
        time, shortest = policy.maximum, ladder(policy)[0]

        async def go(facing: Geometry) -> Geometry:
            return await instrument.arm.face_source(facing.theta_in)

        facing = Geometry(point.theta_in, -point.theta_in)
        here = await self._reach("stray light is not measured", go, facing, point)
        if here is not None:
            spectra = await instrument.sequence(time, STRAY_SCANS)
            while time > shortest and any(s.counts.max() >= self._detector.saturation for s in spectra):
                time = step_down(time, policy)
                spectra = await instrument.sequence(time, STRAY_SCANS)
            moment = instrument.clock.now() - STRAY_SCANS * time / 2
            await self._has_dark(spectra)
            self._store.add_exposures(self._scan_id, "stray", spectra, instrument.session, moment, here)
            self._stray_time = time
        self._settled.add(point.theta_in)

    async def _sweep(self, point: Geometry, prescan: Prescan) -> None:
        """Readings of the moving detector over all directions of the incident angle of `point`, on the way to it."""
        instrument, theta_in, time = self._instrument, point.theta_in, prescan.integration
        start, stop = way(self._spec, point)

        async def go(_: Geometry) -> tuple[list[Passage], float]:
            return await instrument.sweep(theta_in, start, stop, prescan.velocity, time)

        seen = await self._reach("there is no pre-scan", go, Geometry(theta_in, stop), point)
        if seen is not None:
            passages, sample_angle = seen
            await self._has_dark([p.spectrum for p in passages])
            self._store.add_sweep(self._scan_id, sample_angle, passages, instrument.session)
        self._swept.add(theta_in)

    async def _reach(
        self, otherwise: str, go: Callable[[Geometry], Awaitable[T]], there: Geometry, onward: Geometry
    ) -> T | None:
        """Go `there`, if the arm can also go `onward` from there, and return what `go` does; else warn."""
        start, end = ((g.sample_angle, g.detector_angle) for g in (there, onward))
        try:
            safe_path(start, end, self._instrument.arm.forbidden)
            return await go(there)
        except GeometryError as error:
            log.warning("At theta_in = %g deg %s: %s", there.theta_in, otherwise, error)
            return None

    async def _has_dark(self, spectra: Sequence[Spectrum]) -> None:
        """Before spectra are written their dark is: stored spectra can always be calibrated."""
        temperature = float(np.mean([s.detector_temperature for s in spectra]))
        await self._darks.of(spectra[0].integration_time, temperature)
