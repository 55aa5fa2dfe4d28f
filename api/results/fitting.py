"""Fits and files of what a campaign has measured, made in a process of their own while the bench goes on."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path

from analysis.errors import AnalysisError
from analysis.reports.report import RunFacts
from api.datasets import make_dataset, too_noisy
from api.errors import ClusterError
from api.executor import processes
from api.results.derive import REPORT, Derived, derive, write_derived
from api.written import Export, slug
from goniometer.errors import CalibrationError, CertificateError, GoniometerError, StoreFull
from goniometer.geometry import BLOCKED_HALF_WIDTH
from goniometer.plans.plan_spec import plan_spec, uniform_grid_size
from goniometer.storage.lineage import own_datasets
from goniometer.storage.records import Scan
from goniometer.storage.store import Store

log = logging.getLogger(__name__)


class Fits:
    """The fits of a campaign; `fitting` makes one."""

    def __init__(self, store: Store, output: Path, executor: Executor, writer: Executor, calibrator: Executor) -> None:
        self.failures: list[str] = []
        """Why samples that were measured have no fits, as sentences."""
        self.broken = False
        """Whether one of these is a fault that lies neither in the data nor in the disk."""
        self.output = output
        """Below which a scan has a folder of its own."""
        self._store = store
        self._executor = executor
        self._writer = writer
        self._calibrator = calibrator
        self._waiting: dict[int, Future[tuple[Derived, tuple[Export, ...]]]] = {}

    def begin(self, scan: Scan) -> None:
        """Calibrate a scan that is complete, and start its fits; one that cannot be calibrated is a failure.

        Raises what the database raises; a fault of the program is a failure of this scan, too, and ends nothing else.
        """
        calibrated = self._calibrator.submit(make_dataset, self._store, scan.id)
        fault = calibrated.exception()
        if fault is None:
            self._start(calibrated.result(), scan)
        elif isinstance(fault, GoniometerError) and not isinstance(fault, CalibrationError | CertificateError):
            raise fault
        else:
            self.failures.append(f"{scan.name}: {self._told(fault, 'calibrating it')}")

    def catch_up(self, campaign_id: int) -> None:
        """Start the fits that scans of a campaign lack, whatever kept them from being made."""
        for scan in self._store.scans(campaign_id):
            missing = _underived_dataset(self._store, scan, self.output)
            if missing is not None and missing not in self._waiting:
                self._start(missing, scan)

    async def kept(self, note: Callable[[str], None]) -> None:
        """Write all fits into the database as they come; `note` is told what it waits for.

        What goes wrong with one sample is a failure, and does not keep the others from their fits.
        """
        for dataset_id, future in self._waiting.items():
            measured = self._store.dataset(dataset_id).sample
            if not future.done():
                note(f"Fitting {measured}")
            ended = asyncio.wrap_future(future)
            try:
                await asyncio.wait({ended})
            finally:
                ended.cancel()  # what nobody waits for any more tells nobody how it ended
            fault = ended.exception()
            try:
                if fault is None:
                    keep(self._store, dataset_id, *ended.result())
            except StoreFull as error:
                fault = error
            if fault is not None:
                self.failures.append(f"{measured}: {self._told(fault, 'making its fits')}")

    def _start(self, dataset_id: int, scan: Scan) -> None:
        fitted = self._executor.submit(derive, self._store.dataset(dataset_id), run_facts(self._store, scan))
        folder = (self.output / slug(scan.name)).resolve()
        self._waiting[dataset_id] = self._writer.submit(_written, fitted, folder)

    def _told(self, fault: BaseException, doing: str) -> str:
        """What a person is told of a fault that was met while `doing` something."""
        if isinstance(fault, AnalysisError | CalibrationError | CertificateError | StoreFull | ClusterError):
            return str(fault)
        self.broken = True
        if isinstance(fault, BrokenProcessPool):
            return "the process that fits it was ended from outside; run the campaign again."
        log.error("A fault of the program was met while %s", doing, exc_info=fault)
        return f"{doing} met a fault of the program ({type(fault).__name__}: {fault}); the log says where."


@asynccontextmanager
async def fitting(store: Store, output: Path, cluster: str | None) -> AsyncIterator[Fits]:
    """The fits of a campaign whose files go into a folder a scan below `output`.

    They are made in a process of their own, or on the Dask scheduler `cluster`. What has not been fitted and written
    when something goes wrong, or when the task that waits for it is cancelled, is made in the next run. Raises what
    `api.cluster.connected` raises.
    """
    with ExitStack() as held:
        writer, calibrator = (held.enter_context(ThreadPoolExecutor(1)) for _ in range(2))
        executor = await asyncio.to_thread(held.enter_context, processes(cluster, 1))
        # a scan may be under way, and a process takes time to end
        try:
            yield Fits(store, output, executor, writer, calibrator)
        except BaseException as error:
            await asyncio.to_thread(held.pop_all().__exit__, type(error), error, error.__traceback__)
            raise
        await asyncio.to_thread(held.pop_all().close)


def keep(store: Store, dataset_id: int, derived: Derived, exports: tuple[Export, ...]) -> None:
    """Write fits and exports into the database; the report comes last and marks the set as complete."""
    for model, text in derived.fits.items():
        store.add_fit(dataset_id, model, text)
    for export in exports:
        store.add_export(dataset_id, export.path, export.file_format, export.sha256)


def _written(fitted: "Future[Derived]", folder: Path) -> tuple[Derived, tuple[Export, ...]]:
    """What comes of a fit, once it is there, and its files in `folder`."""
    derived = fitted.result()
    return derived, write_derived(derived, folder)


def _underived_dataset(store: Store, scan: Scan, output: Path) -> int | None:
    """The newest dataset of a scan if its fits, or one of the files that belong to it in `output`, are missing.

    Those that somebody made anew from another one do not count: the files are those of the campaign.
    """
    dataset_id = max(own_datasets(store, scan.id), default=None)
    if dataset_id is None:
        return None
    folder = (output / slug(scan.name)).resolve()
    files = [Path(export.text) for export in store.exports(dataset_id) if Path(export.text).parent == folder]
    fitted = any(fit.kind == "analysis" for fit in store.fits(dataset_id))
    # the report is written last
    whole = fitted and folder / REPORT in files and all(file.exists() for file in files)
    return None if whole else dataset_id


def run_facts(store: Store, scan: Scan) -> RunFacts:
    """What a report says about the run of a scan."""
    campaign = store.campaign(scan.campaign_id)
    spec = plan_spec(campaign)
    points = store.points(scan.id)
    blocked = sum(
        sum(abs(t + out) < BLOCKED_HALF_WIDTH for out in range(round(spec.lowest), round(spec.highest) + 1))
        for t in spec.theta_in
    )
    return RunFacts(
        uniform_points=uniform_grid_size(spec),
        bench_time=sum(point.seconds for point in points),
        blocked_points=blocked,
        failed_points=sum(point.status == "failed" for point in points),
        too_noisy=too_noisy(store, scan),
        files=(),
    )
