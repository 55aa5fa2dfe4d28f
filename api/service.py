"""The one place where the floors are wired together: settings, drivers, instrument, scheduler, fits, files.

The command line is a thin face over these functions.
"""

import multiprocessing
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from analysis.report import RunFacts
from api.derive import Derived, derive, end_with_parent, slug
from api.settings import InstrumentSettings, SpectrometerSettings, StageSettings, make_stage
from drivers.clock import Clock, WallClock
from drivers.qepro import QEPro, QEProLight
from goniometer.calibration import calibrate_scan, certificate_of
from goniometer.campaign import Campaign
from goniometer.dataset import Dataset
from goniometer.errors import NotInStore
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE
from goniometer.instrument import Instrument
from goniometer.plan import plan_spec, uniform_grid_size
from goniometer.records import Scan
from goniometer.scheduler import Mount, Report, run_campaign
from goniometer.store import Store
from simulators.laboratory import simulated_laboratory
from simulators.materials import material

SAMPLE_STAGE_LIMITS = (0.0, LARGEST_ANGLE + 5.0)
DETECTOR_STAGE_LIMITS = (-LARGEST_ANGLE, 2 * LARGEST_ANGLE)
"""Degrees: all that in-plane geometry can ask for, and nothing beyond."""


@dataclass(frozen=True)
class Watch:
    """How a run tells what it does; every function must return soon."""

    report: Report
    """Called with the progress of the scan."""
    note: Callable[[str], None]
    """Called with a sentence for the operator."""
    mount: Mount
    """Asks a person to mount a sample on a real bench and returns when it lies there."""


@asynccontextmanager
async def open_bench(
    settings: InstrumentSettings | None, seed: int, ask: Mount
) -> AsyncIterator[tuple[Instrument, Mount]]:
    """The configured bench, opened and homed, or the simulated one; and how a sample gets onto it.

    The same drivers run both. Raises `DriverError` where a device does not answer.
    """
    with ExitStack() as stack:
        clock: Clock = WallClock()
        backend = None
        mount = ask
        if settings is None:
            laboratory = stack.enter_context(simulated_laboratory(seed))
            settings = InstrumentSettings(
                sample_stage=StageSettings(driver="smc100", url=laboratory.sample_stage_url),
                detector_stage=StageSettings(driver="oriental-az", url=laboratory.detector_stage_url),
                spectrometer=SpectrometerSettings(gain=laboratory.gain),
            )
            clock, backend = laboratory.clock, laboratory.usb_backend

            async def mount(scan: Scan) -> None:
                laboratory.bench.mount(scan.material)

        spectrometer = QEPro(
            "spectrometer", clock, serial_number=settings.spectrometer.serial_number, usb_backend=backend
        )
        instrument = Instrument(
            make_stage("sample stage", settings.sample_stage, SAMPLE_STAGE_LIMITS, clock),
            make_stage("detector stage", settings.detector_stage, DETECTOR_STAGE_LIMITS, clock),
            spectrometer,
            QEProLight(spectrometer),
            clock,
            gain=settings.spectrometer.gain,
            u_angle=settings.u_angle,
            aperture=settings.aperture,
        )
        try:
            await instrument.open()
            yield instrument, mount
        finally:
            await instrument.close()


async def run(store: Store, campaign: Campaign, output: Path, settings: InstrumentSettings | None, watch: Watch) -> int:
    """Run or resume `campaign`, fit every finished scan and write its files below `output`; returns its id.

    Fits run in a process of their own while the next sample is measured. Raises what `run_campaign` raises, and
    `AnalysisError` where a dataset cannot be fitted.
    """
    certificate_of(campaign)  # a bad certificate is found before anything moves
    if settings is None:
        for sample in campaign.samples:
            material(sample.material)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=end_with_parent) as executor:
        waiting: dict[int, Future[Derived]] = {}

        def finished(scan: Scan) -> None:
            dataset = calibrate_scan(store, scan.id)
            dataset_id = store.add_dataset(scan.id, dataset)
            waiting[dataset_id] = start_derivation(executor, store, scan, dataset, output)

        # a campaign that has begun must not have changed since; a new one is written once the bench answers
        campaign_id = store.add_campaign(campaign) if campaign.name in store.campaigns().values() else None
        if campaign_id is None or not _measured(store, campaign_id):
            async with open_bench(settings, campaign.seed, watch.mount) as (instrument, mount):
                campaign_id = await run_campaign(store, campaign, instrument, mount, watch.report, finished)
        for scan in store.scans(campaign_id):
            missing = _underived_dataset(store, scan)
            if missing is not None and missing not in waiting:
                waiting[missing] = start_derivation(executor, store, scan, store.dataset(missing), output)
        for dataset_id, future in waiting.items():
            if not future.done():
                watch.note(f"Fitting {store.dataset(dataset_id).sample}")
            keep(store, dataset_id, future.result())
    return campaign_id


def _measured(store: Store, campaign_id: int) -> bool:
    """Whether nothing of a campaign is left to measure or to calibrate."""
    return all(
        scan.outcome == "completed" and (scan.kind == "reference" or bool(store.datasets(scan.id)))
        for scan in store.scans(campaign_id)
    )


def _underived_dataset(store: Store, scan: Scan) -> int | None:
    """The newest dataset of a scan if its fits, or one of its files, are missing."""
    dataset_id = max(store.datasets(scan.id), default=None)
    if dataset_id is None:
        return None
    exports = store.exports(dataset_id)
    whole = any(export.kind == "report" for export in exports) and all(Path(e.text).exists() for e in exports)
    return None if whole else dataset_id


def start_derivation(executor: Executor, store: Store, scan: Scan, dataset: Dataset, output: Path) -> "Future[Derived]":
    """Start fitting `dataset` and writing its files."""
    return executor.submit(derive, dataset, run_facts(store, scan), output / slug(scan.sample))


def keep(store: Store, dataset_id: int, derived: Derived) -> None:
    """Write fits and exports into the database; the report comes last and marks the set as complete."""
    for model, text in derived.fits.items():
        store.add_fit(dataset_id, model, text)
    for export in derived.exports:
        store.add_export(dataset_id, export.path, export.file_format, export.sha256)


def run_facts(store: Store, scan: Scan) -> RunFacts:
    """What a report says about the run of a scan."""
    campaign = store.campaign(scan.campaign_id)
    spec = plan_spec(campaign)
    points = store.points(scan.id)
    certificate = certificate_of(campaign)
    blocked = sum(
        sum(abs(t + out) < BLOCKED_HALF_WIDTH for out in range(round(spec.lowest), round(spec.highest) + 1))
        for t in spec.theta_in
    )
    return RunFacts(
        uniform_points=uniform_grid_size(spec),
        bench_time=sum(point.seconds for point in points),
        certificate=certificate.serial_number,
        blocked_points=blocked,
        failed_points=sum(point.status == "failed" for point in points),
        files=(),
    )


def find_dataset(store: Store, name: str) -> int:
    """Id of the dataset `name`: a number, or the name of a sample, of which the newest is taken.

    Raises `NotInStore` with the names that there are.
    """
    datasets = {dataset_id: store.scan(scan_id).sample for dataset_id, scan_id in store.datasets().items()}
    if name.isdigit() and int(name) in datasets:
        return int(name)
    found = [dataset_id for dataset_id, sample in datasets.items() if sample.lower() == name.lower()]
    if not found:
        known = ", ".join(f'{dataset_id} ("{sample}")' for dataset_id, sample in datasets.items()) or "none yet"
        raise NotInStore(f'There is no dataset "{name}"; there are: {known}.')
    return max(found)


def active_scan(store: Store) -> Scan:
    """The scan that is being run; raises `NotInStore` where nothing runs."""
    for scan in store.scans():
        if scan.phase in {"running", "pausing", "paused", "aborting"}:
            return scan
    raise NotInStore("Nothing is running on this database; start a campaign with: goniometer run CAMPAIGN.")
