"""Runs campaigns: a short loop around the plan, the instrument and the database.

The phases of a scan, as they stand in the database:

    idle ── its campaign is run ──> running
    running ── the plan has no more points ──────────────────> finished (completed)
    running ── pause ──> pausing ── the point is done ──> paused
    pausing, paused ── resume ──> running
    running, pausing, paused ── abort ──> aborting ──────────> finished (aborted: why)
    any of these ── stopped at once, or its process killed ──> finished (aborted: why)
    any of these ── device gone, conditions unmet, ... ──────> finished (failed: why)
    finished (aborted, failed) ── its campaign is run again ──> running

Pausing takes effect after the point in hand, aborting at once. Cancelling the task that runs a scan is the
emergency stop: stages stopped, shutter closed, scan aborted. An aborted or failed scan, and one whose process
was killed, goes on where it stood when its campaign is run again; a completed one is not repeated.

After every fault of a device the bench is made safe and then usable again (`Instrument.recover`), and the point is
tried again. The scan fails when the bench cannot be recovered, or when points fail one after the other.

Points are measured when the sample is mounted, the time that it asks for has passed, and the conditions of the campaign
hold (`goniometer.scans.waiting`); they are looked at again after a pause. A scan that has points does not let the time
pass again.

Everything that decides what happens next is read from the database. A batch of the plan is written before its
first point is measured and a point together with its exposures, so a resumed scan measures the same
directions with the same integration times as one that was never interrupted. Darks, stray light, pre-scans and looks
at the lamp come as `goniometer.scans.auxiliary` says, before the point that needs them.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Coroutine
from typing import Any

from drivers.errors import DriverError
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import GeometryError, GoniometerError, ReferenceIncomplete, RunAborted, StoreError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import plan_spec
from goniometer.plans.reach import check_plan
from goniometer.radiometry.raw import RawScan, read_raw
from goniometer.scans.auxiliary import Auxiliary, Darks
from goniometer.scans.batches import batches
from goniometer.scans.duration import Foreseen
from goniometer.scans.estimate import Estimate
from goniometer.scans.exposure import Brightness, Detector, brightness, check_limits, detector_of, predict, take
from goniometer.scans.prescan import check_prescan
from goniometer.scans.progress import Progress, ToldPhase, Waiting
from goniometer.scans.waiting import Readiness, pass_time
from goniometer.states import Outcome
from goniometer.storage.lineage import lacks_dataset
from goniometer.storage.records import Point, Scan
from goniometer.storage.store import Store

ATTEMPTS = 3
"""How often a point is tried before it is given up."""

FAILURES_IN_A_ROW = 3
"""After so many given-up points in a row the scan fails: something is wrong with a device, not with a point."""

POLL = 0.05
"""Seconds of real time between two looks for a command."""

LETTING_GO = 10.0
"""Seconds of real time that work which was cancelled may take to end; then it is left behind."""

_ABORTED = "The operator aborted it; run the campaign again to go on where it stood."

log = logging.getLogger(__name__)

Mount = Callable[[Scan], Coroutine[Any, Any, None]]
"""Called before every scan, also where its sample lies there already; returns when the sample, or the reference panel,
lies on the bench: for the scan of a spot with another place in the light, or turned by 90 degrees about its normal."""
Report = Callable[[Progress], None]
"""Called at every change; must return soon. What it raises ends the scan, as any other fault."""


async def run_campaign(
    store: Store,
    campaign: Campaign,
    instrument: Instrument,
    mount: Mount,
    report: Report,
    on_scan_finished: Callable[[Scan], None],
    certificate: str | None = None,
) -> int:
    """Run or resume a campaign on an open instrument, and return its id in the database.

    `certificate` is the text of the panel's where the campaign names no file.

    The caller must hold `store.exclusive()`: whatever the database calls running then has lost its process.
    `on_scan_finished` is called once the scan of a sample is complete and that of its spot has ended, however it did,
    and for one that was complete before but lacks its dataset, so that nothing is lost to what comes next. Raises
    `CampaignError` (changed content or certificate, impossible integration times), `GeometryError` (directions that the
    bench cannot take), `RunAborted` (an operator's wish), `ConditionsUnmet`, `ReferenceIncomplete`, and what stopped
    the campaign: `DriverError`, ...
    """
    store.end_stale_scans()
    check_limits(campaign.integration, instrument)
    if campaign.prescan is not None:
        check_prescan(campaign.prescan, instrument.integration_limits, instrument.arm.motion)
    check_plan(plan_spec(campaign), instrument.arm.limits, instrument.arm.forbidden)
    campaign_id = store.add_campaign(campaign, certificate)
    before_spot = campaign.homogeneity is not None
    scans = store.scans(campaign_id)
    for scan in scans:
        try:
            if scan.outcome != "completed":
                await run_scan(store, scan.id, instrument, mount, report)
        finally:  # what stops a spot must not keep its sample from being calibrated
            if scan.kind == ("spot" if before_spot else "sample"):
                sample = store.scan(scans[scan.number - before_spot].id)
                if lacks_dataset(store, sample):
                    on_scan_finished(sample)
    return campaign_id


async def run_scan(store: Store, scan_id: int, instrument: Instrument, mount: Mount, report: Report) -> None:
    """Run or resume one scan; returns when it is complete, or is that of a spot where nothing can be compared.

    Whatever else ends it (see `run_campaign`) is written down as its outcome, after the bench has been made
    safe, and raised again.
    """
    scan = store.scan(scan_id)
    run = _Run(store, scan, instrument, report)
    store.release_points(scan_id)
    store.clear_command(scan_id)
    store.set_phase(scan_id, "running")
    try:
        if run.has_nothing_to_compare():
            reason = f"No direction of {scan.name} has a value with which another spot could be compared."
            log.warning("%s", reason)
            store.finish_scan(scan_id, "failed", reason)
            run.tell("finished", outcome="failed")
            return
        await run.unless_aborted(mount(scan))
        await run.measure()
        await instrument.safe()
    except BaseException as error:
        # The one place that catches everything: whatever ends a scan is put down as its outcome and raised again.
        # The device may be what failed, and the disk may be full: do what can be done, then tell the first cause.
        with contextlib.suppress(DriverError):
            await instrument.safe()
        ended = _ending(error)
        with contextlib.suppress(StoreError):
            store.finish_scan(scan_id, *ended)
        run.tell("finished", outcome=ended[0])
        raise
    store.finish_scan(scan_id, "completed", run.batches.accuracy())
    run.tell("finished", outcome="completed")


def _ending(error: BaseException) -> tuple[Outcome, str]:
    """Outcome and reason of a scan that `error` ended."""
    if isinstance(error, RunAborted):
        return "aborted", str(error)
    if isinstance(error, asyncio.CancelledError | KeyboardInterrupt):
        return "aborted", "It was stopped at once."
    if isinstance(error, DriverError | GoniometerError | OSError):
        return "failed", str(error)
    return "failed", f"It met a fault of the program ({type(error).__name__}: {error})."


class _Run:
    """One run of one scan: what its steps share. All that must survive it is in the database."""

    def __init__(self, store: Store, scan: Scan, instrument: Instrument, report: Report) -> None:
        self.store = store
        self.scan = scan
        self.instrument = instrument
        self.report = report
        self.campaign = store.campaign(scan.campaign_id)
        self.batches = batches(
            store, scan, self.campaign, plan_spec(self.campaign, instrument.arm.motion, instrument.u_angle)
        )
        self.ahead: tuple[list[Geometry], Foreseen] | None = None
        self.policy = self.campaign.integration
        if scan.kind == "reference":  # its points serve all others and are bright: none is cut short
            changes = {"scans": self.campaign.reference.scans, "signal_to_noise": None}
            self.policy = self.policy.model_copy(update=changes)
        budget = self.campaign.resolution.time if scan.kind == "sample" else None
        self.estimate = Estimate(store, scan.id, instrument.arm.motion, self.policy, budget)
        # Repeats stored exposures, so that choosing an exposure does not read them all again.
        self.seen: dict[float, list[tuple[float, Brightness]]] = {}
        self.began = time.monotonic()
        self.waiting: Waiting | None = None
        self.done = self.failed = 0
        self.bench_seconds = self.bench_seconds_before = 0.0

    async def measure(self) -> None:
        """Measure until the plan has no more points."""
        self.store.save_constants(self.scan.id, await self.instrument.constants())
        raw = read_raw(self.store, self.scan.id)
        self.detector: Detector = detector_of(raw.constants)
        self.darks = Darks(self.store, self.scan.id, self.instrument, raw.darks)
        self.auxiliary = Auxiliary(self.store, self.instrument, self.campaign, raw, self.darks)
        self._recall(raw)
        self.foreseen = self.estimate.total = self.batches.foreseen(self.store.points(self.scan.id))
        await self._pass_time()
        await self._make_ready()
        self.began = time.monotonic()  # what was waited for tells nothing about the time that points take
        failures = 0
        while batch := self._pending():
            for left, point in zip(reversed(range(len(batch))), batch, strict=True):
                await self._obey()
                failure = await (self._attempt(point) if point is not batch[-1] else self._attempt_last(point))
                self.done += 1
                self.failed += failure is not None
                self.estimate.update(left, self.done, self.auxiliary)
                failures = failures + 1 if failure else 0
                if failure and failures >= FAILURES_IN_A_ROW:
                    raise failure
                self.tell("running", point.geometry)
        await self._obey()  # what was asked for during the last point
        fault = await self._tried(self.auxiliary.closing, "after the last point")
        if fault is not None:
            raise fault
        await self._obey()  # and during that
        if self.scan.kind == "reference":
            self._check_whole()

    async def _pass_time(self) -> None:
        """Let the time pass that the sample asks for, unless this scan has begun before."""
        seconds = {sample.name: sample.wait for sample in self.campaign.samples}
        if self.scan.kind == "sample" and not self.store.points(self.scan.id):
            clock = self.instrument.clock
            await self.unless_aborted(pass_time(clock, seconds[self.scan.sample], "as the campaign asks", self._wait))
            self._wait(None)

    async def _make_ready(self) -> None:
        """Wait until the conditions of the campaign hold; raises `ConditionsUnmet` and `DriverError`."""
        readiness = Readiness(self.campaign, self.instrument, self.detector, self.darks, self._wait)
        fault = await self._tried(readiness.reach, "before the first point")
        self._wait(None)
        if fault is not None:
            raise fault

    def _wait(self, waiting: Waiting | None) -> None:
        """Tell what is waited for now, None for nothing more."""
        before, self.waiting = self.waiting, waiting
        if waiting is None and before is None:
            return
        what = None if waiting is None else waiting.what
        if before is None or what != before.what:
            self.store.explain(self.scan.id, "" if what is None else f"It waits: {what}.")
        if waiting is not None:  # else the next point tells, once it is known how long it all takes
            self.tell("running")

    def _check_whole(self) -> None:
        """Raise `ReferenceIncomplete` where a point failed: the next run tries it again, before any sample."""
        points = self.store.points(self.scan.id)
        failed = [p for p in points if p.status == "failed"]
        if failed:
            first = failed[0]
            raise ReferenceIncomplete(
                f"{len(failed)} of the {len(points)} points of the reference scan failed, the first at theta_in = "
                f"{first.geometry.theta_in:g}, theta_out = {first.geometry.theta_out:g} deg "
                f"({first.reason.rstrip('.')}); find the cause and run the campaign again to measure them"
            )

    def tell(self, phase: ToldPhase, geometry: Geometry | None = None, outcome: Outcome | None = None) -> None:
        """Report a snapshot."""
        elapsed = time.monotonic() - self.began
        here, left = self.bench_seconds - self.bench_seconds_before, self.estimate.remaining
        self.report(
            Progress(
                self.scan.id,
                self.scan.name,
                self.scan.kind,
                phase,
                geometry,
                self.done,
                self.failed,
                self.estimate.total.points,
                self.bench_seconds,
                left,
                elapsed,
                left.seconds * elapsed / here if here else None,
                self.estimate.dead_time,
                self.waiting,
                outcome,
            )
        )

    def _recall(self, raw: RawScan) -> None:
        """Take up what earlier runs of this scan have done."""
        shortest = {shot.point: shot for shot in sorted(raw.shots, key=lambda s: s.integration_time, reverse=True)}
        for i, geometry in enumerate(raw.planned):
            shot = shortest[i]
            dark = self.darks.stored(shot.integration_time, shot.temperature)
            self._remember(geometry, brightness(shot.counts, shot.integration_time, dark, self.detector))
        points = self.store.points(self.scan.id)
        self.done = sum(p.status in {"done", "failed", "skipped"} for p in points)
        self.failed = sum(p.status in {"failed", "skipped"} for p in points)
        self.bench_seconds = self.bench_seconds_before = sum(p.seconds for p in points)

    def _pending(self) -> list[Point]:
        """Points to measure now: what is left of a batch, or the plan's next one; empty when the scan is complete."""
        points = self.store.points(self.scan.id)
        pending = [p for p in points if p.status == "pending"]
        if not pending:
            batch, self.foreseen = self.ahead if self.ahead and self.ahead[0] else self.batches.look(points)
            if batch:
                self.store.add_points(self.scan.id, batch)
            pending = [p for p in self.store.points(self.scan.id) if p.status == "pending"]
        self.ahead = None
        self.estimate.begin([p.geometry for p in pending], self.foreseen, self.done, self.auxiliary)
        return pending

    async def _attempt_last(self, point: Point) -> DriverError | GeometryError | None:
        """`_attempt` on the last point of a batch, while the plan finds the next batch."""
        planning = asyncio.to_thread(self.batches.look, self.store.points(self.scan.id))
        thinking = asyncio.create_task(planning)
        try:
            failure = await self._attempt(point)
        finally:
            await asyncio.wait({thinking})
        self.ahead = thinking.result()
        return failure

    def has_nothing_to_compare(self) -> bool:
        """Whether this is the scan of a spot, and the sample before it has no direction fit to be measured again."""
        points = self.store.points(self.scan.id)
        return self.scan.kind == "spot" and not points and not self.batches.next(points)

    async def unless_aborted(self, work: Coroutine[Any, Any, None]) -> None:
        """Wait for `work`, but cancel it and raise `RunAborted` as soon as an abort is asked for."""
        task = asyncio.create_task(work)
        try:
            while not task.done():
                await asyncio.wait({task}, timeout=POLL)
                if not task.done() and self.store.command(self.scan.id) == "abort":
                    raise RunAborted(_ABORTED)
        finally:
            if not task.done():
                task.cancel()
                # at once, not when the work has ended: a device that it waits for may be slow to let go
                with contextlib.suppress(DriverError):
                    await self.instrument.safe()
                await asyncio.wait({asyncio.gather(task, return_exceptions=True)}, timeout=LETTING_GO)
        task.result()

    async def _obey(self) -> None:
        """Do what was asked for between two points: pause until resumed, or raise `RunAborted`."""
        command = self.store.command(self.scan.id)
        if command == "pause":
            self.store.clear_command(self.scan.id, command)
            try:
                await self.instrument.safe()
            except DriverError:  # which it has logged
                await self.unless_aborted(self.instrument.recover())
            self.store.set_phase(self.scan.id, "paused")
            self.tell("paused")
            # Another process answers, so there is no event to wait for.
            while (command := self.store.command(self.scan.id)) not in {"resume", "abort"}:  # noqa: ASYNC110
                await asyncio.sleep(POLL)
        if command == "abort":
            raise RunAborted(_ABORTED)
        if command == "resume":
            self.store.clear_command(self.scan.id, command)
            self.store.set_phase(self.scan.id, "running")
            await self._make_ready()

    async def _attempt(self, point: Point) -> DriverError | GeometryError | None:
        """Measure a point, trying again after a fault; returns why it was given up, or None.

        Raises `DriverError` where the bench cannot be made usable again.
        """

        async def attempt() -> None:
            self.store.start_point(point.id, self.estimate.total.points, self.estimate.remaining)
            await self._measure_point(point)

        geometry = point.geometry
        where = f"theta_in = {geometry.theta_in:g}, theta_out = {geometry.theta_out:g} deg"
        try:
            fault = await self._tried(attempt, where)
        except GeometryError as error:
            self.store.give_up_point(point.id, "skipped", str(error))
            return error
        if fault is not None:
            self.store.give_up_point(point.id, "failed", str(fault))
        return fault

    async def _tried(self, work: Callable[[], Coroutine[Any, Any, None]], where: str) -> DriverError | None:
        """Do `work`, again after a fault; returns the last one when it was given up, or None.

        Raises `DriverError` where the bench cannot be made usable again.
        """
        fault: DriverError | None = None
        for attempt in range(1, ATTEMPTS + 1):
            try:
                await self.unless_aborted(work())
            except DriverError as error:
                fault = error
                log.warning("%s, attempt %d of %d: %s", where, attempt, ATTEMPTS, error)
                # Recovery meets again whatever is wrong now; what is told is why this attempt failed.
                with contextlib.suppress(DriverError):
                    await self.instrument.safe()
                await self.unless_aborted(self.instrument.recover())
            else:
                return None
        return fault

    async def _measure_point(self, point: Point) -> None:
        """Do what is due before it, go there, expose, and write the point with its exposures."""
        self.tell("running", point.geometry)
        began = self.instrument.clock.now()
        await self.auxiliary.before(point.geometry)
        read_back = await self.instrument.arm.goto(point.geometry)
        predicted = predict(point.geometry.theta_out, self.seen.get(point.geometry.theta_in, []))
        taken = await take(self.instrument, self.detector, self.policy, predicted, self.darks.of)
        seconds = self.instrument.clock.now() - began
        session = self.instrument.session
        self.store.finish_point(
            point, read_back, taken.spectra, session, taken.moment, seconds, taken.signal_to_noise, taken.reason
        )
        self._remember(point.geometry, taken.brightness)
        self.bench_seconds += seconds

    def _remember(self, geometry: Geometry, seen: Brightness) -> None:
        self.seen.setdefault(geometry.theta_in, []).append((geometry.theta_out, seen))
