"""Runs an entry of the queue on the operated bench, and tells how far it is."""

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.errors import AnalysisError
from api.bench import queue
from api.bench.messages import Told
from api.bench.operated import OperatedBench
from api.bodies.bench import Alarm, Prompt, Running, Span
from api.bodies.events import EntryChanged, Notice, PointDone, PromptGone, QueueChanged
from api.errors import Conflict
from api.mount_request import mount_request
from api.preflight import preflight
from api.results.fitting import Fits, fitting
from api.service import measure, mounting
from api.settings import InstrumentSettings
from api.written import slug
from drivers.errors import DriverError
from goniometer.errors import CampaignError, GoniometerError, NotInStore, RunAborted, StoreError
from goniometer.scans.progress import Progress
from goniometer.states import Outcome
from goniometer.storage.records import Scan, now
from goniometer.storage.store import Store

REPORT_EVERY = 0.1
"""Seconds between two reports of progress; a simulated bench would make more of them than anybody reads."""
LOOK_AT_FITS = 0.5
"""Seconds between two looks whether somebody has aborted fits that are made."""
PATIENCE_WITH_DISK = 5.0
"""Seconds until a database that refused is tried again."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Task:
    """What the process that drives the bench is started with."""

    database: Path | str
    output: Path
    settings: InstrumentSettings | None
    """None for the simulated bench."""
    url: str
    """Where the service answers."""
    mounts_by_itself: bool
    """Whether samples are laid on the simulated bench without asking anybody."""
    bench: str
    """Name of the bench."""
    cluster: str | None = None
    """Address of the Dask scheduler that does heavy work; None for this machine."""
    since: str = ""
    """When the process was started, ISO 8601 in UTC: what was queued before waits for somebody to look."""
    alarm: Alarm | None = None
    """Why there was no process for a while; None where this is the first."""


class Runner:
    """Runs one entry at a time."""

    def __init__(
        self, store: Store, bench: OperatedBench, task: Task, say: Callable[[Told], None], changed: Callable[[], None]
    ) -> None:
        """`say` tells all listeners; `changed` is called when there is something new about the bench."""
        self.entry: queue.Entry | None = None
        """What is run; None for nothing."""
        self.prompt: Prompt | None = None
        """What somebody must mount before it goes on."""
        self.fitting: dict[int, asyncio.Task[None]] = {}
        """Entries that are measured, and whose fits are made now."""
        self.leaving = False
        """Whether the bench is let go of, so that what is stopped has not ended but goes on another time."""
        self._store = store
        self._bench = bench
        self._task = task
        self._say = say
        self._changed = changed
        self._progress: Progress | None = None
        self._told = 0.0
        self._mounted: asyncio.Future[None] | None = None

    async def run(self, entry: queue.Entry) -> None:
        """Run an entry of the queue and put down how it ended."""
        if (before := self.fitting.get(entry.id)) is not None:  # aborted and started again at once
            before.cancel()
            await asyncio.wait({before})
        self.entry = entry
        self.tell_queue()
        campaign = entry.campaign
        folder = self._task.output / slug(campaign.name)
        try:
            refused = preflight(self._store, campaign, self._bench.settings)
            if refused:
                raise CampaignError(" ".join(refused))
            await self._connect(campaign.seed)
            assert self._bench.instrument is not None  # it is connected
            asks = self._bench.laboratory is None or not self._task.mounts_by_itself
            mount = mounting(self._ask, self._bench.laboratory, asks=asks)

            async def begin(scan: Scan) -> None:
                self._note_campaign(entry)
                await mount(scan)

            bench = nullcontext((self._bench.instrument, begin))
            async with AsyncExitStack() as held:
                fits = await held.enter_async_context(fitting(self._store, folder, self._task.cluster))
                work = measure(self._store, campaign, fits, self._bench.settings, bench, self._report)
                await self._bench.run(f'Measuring the campaign "{campaign.name}".', work)
                self._note_campaign(entry)  # where all was measured before, no scan has begun
                self.fitting[entry.id] = asyncio.ensure_future(self._fit(entry, fits, held.pop_all()))
                await asyncio.sleep(0)  # what is cancelled before it has begun would let go of nothing
        except (RunAborted, Conflict) as error:
            if not self.leaving:
                queue.finish_entry(self._store, entry.id, "aborted", str(error))
        except (GoniometerError, AnalysisError, DriverError, OSError) as error:
            log.error("%s: %s", campaign.name, error)
            queue.finish_entry(self._store, entry.id, "failed", str(error))
        except Exception as error:  # it ends this entry and not the night: the scan has made the bench safe
            log.exception("A fault of the program ended %s", campaign.name)
            told = f"It met a fault of the program ({type(error).__name__}: {error}); the log says where."
            queue.finish_entry(self._store, entry.id, "failed", told)
        finally:
            self.entry = self._progress = None
            self._changed()
            self.tell_queue()

    async def _fit(self, entry: queue.Entry, fits: Fits, held: AsyncExitStack) -> None:
        """Wait for the fits of an entry that is measured, and put down how it ended; the bench is free meanwhile.

        An entry that is not running any more in the database was aborted: its fits are stopped.
        """
        try:
            outcome: Outcome
            try:
                async with held:
                    await self._unless_ended(entry, fits.kept(self._note))
                outcome, reason = "failed" if fits.broken else "completed", " ".join(fits.failures)
            except RunAborted:  # how it ended is written down already
                return
            except (GoniometerError, OSError) as error:
                log.error("%s: %s", entry.name, error)
                outcome, reason = "failed", str(error)
            while True:
                try:
                    queue.finish_entry(self._store, entry.id, outcome, reason)
                    return
                except StoreError as error:
                    log.error("%s", error)
                    await asyncio.sleep(PATIENCE_WITH_DISK)
        finally:
            del self.fitting[entry.id]
            self.tell_queue()

    async def _unless_ended(self, entry: queue.Entry, work: Coroutine[Any, Any, None]) -> None:
        """Do `work` as long as the entry is running; raises `RunAborted` where it has been ended."""
        making = asyncio.ensure_future(work)
        try:
            while not making.done():
                await asyncio.wait({making}, timeout=LOOK_AT_FITS)
                if not making.done() and self._has_ended(entry):
                    raise RunAborted(queue.FITS_ABORTED)
        finally:
            making.cancel()
        making.result()

    def _has_ended(self, entry: queue.Entry) -> bool:
        """Whether somebody has ended an entry, or forgotten it since."""
        try:
            return queue.entry(self._store, entry.id).phase != "running"
        except NotInStore:
            return True
        except StoreError:  # it is asked again
            return False

    async def leave(self) -> None:
        """Let go of all fits; they are made when their entries are started again."""
        for each in (waiting := list(self.fitting.values())):
            each.cancel()
        if waiting:
            await asyncio.wait(waiting)

    async def _connect(self, seed: int) -> None:
        """Have the bench ready; a simulated one is made anew, so that its noise is that of the campaign."""
        if self._bench.laboratory is not None:
            await self._bench.disconnect()
        await self._bench.connect(seed)

    def _note_campaign(self, entry: queue.Entry) -> None:
        """Note which campaign of the database an entry became, once it did."""
        if self.entry is entry and entry.campaign_id is None:
            number = next(number for number, name in self._store.campaigns().items() if name == entry.name)
            queue.begun(self._store, entry.id, number)
            self.entry = queue.entry(self._store, entry.id)
            self.tell_queue()

    def _report(self, progress: Progress) -> None:
        before, self._progress = self._progress, progress
        new_scan = before is None or before.scan_id != progress.scan_id
        if before is not None and not new_scan and progress.done > before.done and progress.geometry is not None:
            point = PointDone(
                scan=progress.scan_id,
                theta_in=progress.geometry.theta_in,
                theta_out=progress.geometry.theta_out,
                done=progress.done,
                failed=progress.failed,
                expected=progress.expected,
            )
            self._say(Told("point", point))
        moment = time.monotonic()
        if new_scan or before is None or before.phase != progress.phase or moment - self._told >= REPORT_EVERY:
            self._told = moment
            running = self.running
            assert running is not None  # it reports
            self._say(Told("progress", running))
        if new_scan or before is None or before.phase != progress.phase:
            self._changed()
            self.tell_queue()

    def tell_queue(self) -> None:
        """Say that the queue has changed."""
        self._say(Told("queue", QueueChanged() if self.entry is None else EntryChanged(entry=self.entry.id)))

    def _note(self, sentence: str) -> None:
        self._say(Told("log", Notice(level="info", message=sentence, moment=now())))

    async def _ask(self, scan: Scan) -> None:
        """Ask for a sample, and return when somebody says that it is mounted."""
        assert self.entry is not None  # it is its campaign that asks
        request, check = mount_request(scan)
        self._mounted = asyncio.get_running_loop().create_future()
        self.prompt = Prompt(
            entry=self.entry.id,
            scan=scan.id,
            sample=scan.name,
            kind=scan.kind,
            request=request,
            check=check,
            since=now(),
        )
        self._say(Told("mount", self.prompt))
        self._changed()
        self.tell_queue()
        try:
            await self._mounted
        finally:
            self.prompt = self._mounted = None
            self._say(Told("mount", PromptGone(entry=self.entry.id, scan=scan.id, request=None)))
            self._changed()
            self.tell_queue()

    async def confirm(self, entry: int, scan: int | None) -> None:
        """Somebody says that the sample is mounted. Raises `Conflict` where that was not asked."""
        prompt, mounted = self.prompt, self._mounted
        if prompt is None or mounted is None or prompt.entry != entry:
            raise Conflict(f"Entry {entry} does not wait for a sample; look at the queue for what it does")
        if scan is not None and scan != prompt.scan:
            raise Conflict(f"Entry {entry} waits for {prompt.sample} (scan {prompt.scan}), not for scan {scan}")
        if not mounted.done():
            mounted.set_result(None)

    @property
    def running(self) -> Running | None:
        """The scan that is measured; None for none."""
        entry, progress = self.entry, self._progress
        if entry is None or progress is None:
            return None
        left = progress.bench_remaining
        return Running(
            entry=entry.id,
            campaign=entry.name,
            scan=progress.scan_id,
            sample=progress.sample,
            kind=progress.kind,
            phase=progress.phase,
            done=progress.done,
            failed=progress.failed,
            expected=progress.expected,
            theta_in=None if progress.geometry is None else progress.geometry.theta_in,
            theta_out=None if progress.geometry is None else progress.geometry.theta_out,
            bench_elapsed=progress.bench_elapsed,
            bench_remaining=Span(seconds=left.seconds, low=left.low, high=left.high),
            remaining=progress.remaining,
            waiting=None if progress.waiting is None else progress.waiting.what,
        )
