"""The one place where the floors are wired together: settings, drivers, instrument, scheduler, fits, files.

The command line is a thin face over these functions.
"""

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import (
    AbstractAsyncContextManager,
    AsyncExitStack,
    asynccontextmanager,
    contextmanager,
    nullcontext,
    suppress,
)
from dataclasses import dataclass
from pathlib import Path

from usb.backend import IBackend

from api.preflight import (
    DETECTOR_STAGE_LIMITS,
    SAMPLE_STAGE_LIMITS,
    check_all,
    check_output,
    panel_certificate,
    with_materials,
)
from api.results.fitting import Fits, fitting
from api.settings import InstrumentSettings
from api.stages import make_stage, not_plugged_in
from api.terminal import ask_to_mount
from drivers.clock import Clock, WallClock
from drivers.errors import DriverError
from drivers.qepro import QEPro, QEProLight
from goniometer.bench.doctor import Bench, Finding, examine, release, visit
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import BenchUnfit, InputError, NotInStore
from goniometer.scans.scheduler import Mount, Report, run_campaign
from goniometer.states import ACTIVE_PHASES
from goniometer.storage import look_up
from goniometer.storage.lineage import lacks_dataset
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from simulators.bench.laboratory import COUNTS_PER_DEGREE, STAGES, Laboratory, simulated_laboratory

SAMPLE_STAGE, DETECTOR_STAGE = "sample stage", "detector stage"


@dataclass(frozen=True)
class Watch:
    """How a run tells what it does; every function must return soon. As it stands, it asks on the terminal only."""

    report: Report = lambda _: None
    """Called with the progress of the scan."""
    note: Callable[[str], None] = lambda _: None
    """Called with a sentence for the operator."""
    mount: Mount = ask_to_mount
    """Asks a person to mount a sample on a real bench and returns when it lies there."""


QUIET = Watch()
"""Tells nothing, and asks on the terminal what only a person can do."""

OpenBench = tuple[Instrument, Mount]
"""What `open_bench` opens."""


def make_bench(settings: InstrumentSettings, clock: Clock, usb_backend: IBackend | None) -> Bench:
    """The drivers of all devices of `settings`, not yet open; a `usb_backend` of None is the system's own."""
    wanted = settings.spectrometer
    spectrometer = QEPro(
        "spectrometer",
        clock,
        serial_number=wanted.serial_number,
        usb_backend=usb_backend,
        cooler_set_point=wanted.cooler_set_point,
        temperature_tolerance=wanted.temperature_tolerance,
        timeout=wanted.timeout,
    )
    return Bench(
        make_stage(SAMPLE_STAGE, settings.stages.sample, SAMPLE_STAGE_LIMITS, clock),
        make_stage(DETECTOR_STAGE, settings.stages.detector, DETECTOR_STAGE_LIMITS, clock),
        spectrometer,
        QEProLight(spectrometer),
        clock,
        set_point=wanted.cooler_set_point,
        tolerance=wanted.temperature_tolerance,
        forbidden=tuple(forbidden.region for forbidden in settings.forbidden),
    )


def simulated_settings(laboratory: Laboratory) -> InstrumentSettings:
    """The instrument file of a simulated laboratory."""
    urls = laboratory.sample_stage_url, laboratory.detector_stage_url
    patience = 5.0  # real seconds: the simulated devices share their processors with everything else
    sample, detector = (
        {"driver": family, "url": url, "timeout": patience}
        | ({"counts_per_degree": COUNTS_PER_DEGREE} if family == "owis" else {})
        for family, url in zip(laboratory.families, urls, strict=True)
    )
    return InstrumentSettings.model_validate({"stages": {"sample": sample, "detector": detector}})


@dataclass(frozen=True)
class _Site:
    """Where a bench stands: in the real world, or in a simulated laboratory."""

    settings: InstrumentSettings
    bench: Bench
    laboratory: Laboratory | None
    """None in the real world."""

    def unplugged(self) -> dict[str, DriverError]:
        """Stages whose serial numbers are not plugged in, by name, and what is there instead."""
        stages = self.settings.stages
        return not_plugged_in({SAMPLE_STAGE: stages.sample, DETECTOR_STAGE: stages.detector})


@contextmanager
def _site(
    settings: InstrumentSettings | None,
    seed: int,
    families: tuple[str, str],
    imperfections: Imperfections | None = None,
) -> Iterator[_Site]:
    if settings is not None:
        yield _Site(settings, make_bench(settings, WallClock(), None), None)
        return
    with simulated_laboratory(seed, families, imperfections) as laboratory:
        settings = simulated_settings(laboratory)
        yield _Site(settings, make_bench(settings, laboratory.clock, laboratory.usb_backend), laboratory)


@asynccontextmanager
async def open_instrument(
    settings: InstrumentSettings | None,
    seed: int,
    families: tuple[str, str] = STAGES,
    imperfections: Imperfections | None = None,
) -> AsyncIterator[tuple[Instrument, Laboratory | None]]:
    """The configured bench, opened, homed and examined, or that of the simulated laboratory, which comes with it.

    The same drivers run both; `families` are those of the simulated stages, `imperfections` the errors of the simulated
    bench, drawn from the seed where there are none. Raises `DriverError` where a device does not answer and
    `BenchUnfit` where the doctor finds a fault.
    """
    with _site(settings, seed, families, imperfections) as site:
        bench = site.bench
        instrument = Instrument(
            bench.sample_stage,
            bench.detector_stage,
            bench.spectrometer,
            bench.light,
            bench.clock,
            data=site.settings.bench_data,
            forbidden=bench.forbidden,
            backlash=site.settings.backlash,
            settling=site.settings.settling,
        )
        for error in site.unplugged().values():
            raise error
        async with AsyncExitStack() as on_failure:  # a cancellation is one, too
            on_failure.push_async_callback(release, bench)
            await instrument.open()
            unfit = [finding.line() for finding in await examine(bench, referenced=True) if finding.problems]
            if unfit:
                raise BenchUnfit(unfit)
            on_failure.pop_all()
        try:
            yield instrument, site.laboratory
        finally:
            # the device may be what failed, and the first cause is what counts
            with suppress(DriverError):
                await instrument.safe()
            with suppress(DriverError):
                await instrument.close()


@asynccontextmanager
async def open_bench(
    settings: InstrumentSettings | None,
    seed: int,
    ask: Mount,
    families: tuple[str, str] = STAGES,
    imperfections: Imperfections | None = None,
    *,
    lamp_is_warm: bool = False,
) -> AsyncIterator[OpenBench]:
    """What `open_instrument` opens, and how the sample of a scan gets onto it, unless it lies there already.

    `lamp_is_warm` is the word of an operator; else the lamp counts as cold when the bench is opened.
    """
    async with open_instrument(settings, seed, families, imperfections) as (instrument, laboratory):
        if lamp_is_warm:
            instrument.trust_lamp()
        yield instrument, mounting(ask, laboratory, asks=laboratory is None)


def mounting(ask: Mount, laboratory: Laboratory | None, *, asks: bool = True) -> Mount:
    """How the sample of a scan gets onto an open bench, unless it lies there already.

    A person is asked if `asks`; in a laboratory it is laid there.
    """
    lying: tuple[str, str] | None = None  # None where nobody knows

    async def mount(scan: Scan) -> None:
        nonlocal lying
        wanted = scan.kind, scan.sample
        if wanted != lying:
            lying = None
            if asks:
                await ask(scan)
            if laboratory is not None:
                laboratory.mount(scan.material, spot=int(scan.kind == "spot"))
            lying = wanted
        if laboratory is not None:
            laboratory.bench.begin(scan.repeat or 1)

    return mount


async def diagnose(
    settings: InstrumentSettings | None,
    *,
    home: bool = False,
    families: tuple[str, str] = STAGES,
    tell: Callable[[float, str], None] = lambda *_: None,
) -> list[Finding]:
    """Open and examine each device of the configured bench, or of the simulated one, and close them all.

    Stages that do not know their reference are moved only if `home`; `tell` is told which part is done, 0 to 1, and
    what is done next.
    """
    with _site(settings, 0, families) as site:
        return await visit(site.bench, home=home, absent=site.unplugged(), tell=tell)


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    campaign_id: int
    failures: tuple[str, ...]
    """Why samples that were measured have no fits, as sentences; empty when all have."""


async def run(
    store: Store,
    campaign: Campaign,
    output: Path,
    settings: InstrumentSettings | None = None,
    watch: Watch = QUIET,
    *,
    bench: OpenBench | None = None,
    lamp_is_warm: bool = False,
    cluster: str | None = None,
) -> RunResult:
    """Run or resume `campaign`, fit every finished scan and write its files into a folder a scan below `output`.

    `settings` of None are those of the simulated bench. A `bench` that is open, and was opened with the same settings,
    is used and left open, so that its lamp stays warm from one campaign to the next; without one the bench is opened
    for this run, and `lamp_is_warm` is the word of an operator who has seen it burn. Fits run in a process of their
    own, or on the Dask scheduler `cluster`, while the next sample is measured; a sample that cannot be calibrated or
    fitted does not stop the others. Raises `StoreBusy`, and what `api.cluster.connected` and `run_campaign` raise.
    """
    with store.exclusive():
        async with fitting(store, output, cluster) as fits:
            opened = (
                nullcontext(bench)
                if bench is not None
                else open_bench(settings, campaign.seed, watch.mount, lamp_is_warm=lamp_is_warm)
            )
            campaign_id = await measure(store, campaign, fits, settings, opened, watch.report)
            await fits.kept(watch.note)
    return RunResult(campaign_id, tuple(fits.failures))


async def measure(
    store: Store,
    campaign: Campaign,
    fits: Fits,
    settings: InstrumentSettings | None,
    bench: AbstractAsyncContextManager[OpenBench],
    report: Report,
) -> int:
    """Measure what is not measured yet of `campaign`, and start all fits that it lacks; returns its id.

    For who holds `store.exclusive()`. The `bench` is opened only where something is to be measured. Raises `StoreFull`
    where the results could not be written, and what `run_campaign` raises.
    """
    certificate = panel_certificate(campaign, settings)
    check_all(store, campaign, certificate, settings)
    if settings is None:
        campaign = with_materials(campaign)
    # a campaign that has begun must not have changed since; a new one is written once the bench answers
    known = campaign.name in store.campaigns().values()
    campaign_id = store.add_campaign(campaign, certificate) if known else None
    if campaign_id is None or any(scan.outcome != "completed" for scan in store.scans(campaign_id)):
        check_output(fits.output)  # a night's results must have a place
        async with bench as (instrument, mount):
            campaign_id = await run_campaign(store, campaign, instrument, mount, report, fits.begin, certificate)
    else:
        for scan in store.scans(campaign_id):
            if lacks_dataset(store, scan):
                fits.begin(scan)
    fits.catch_up(campaign_id)
    return campaign_id


def active_scan(store: Store, bench: str | None = None) -> Scan:
    """The scan that is being run, on this bench if one is named.

    Raises `NotInStore` where nothing runs, and `InputError` where several do and no bench is named.
    """
    found = {
        look_up.campaign_row(store, scan.campaign_id).bench: scan
        for scan in look_up.scans_in_phases(store, ACTIVE_PHASES)
    }
    active = {each: scan for each, scan in found.items() if bench in {None, each} and store.in_use(each)}
    if not active:
        benches = {store.bench, *store.benches().values()} if bench is None else {bench}
        used = ", ".join(sorted(each for each in benches if store.in_use(each)))
        if used:
            raise NotInStore(
                f"No scan is under way just now on {used}, which is in use by a service that measures nothing, or by a "
                f"run that is between two scans or makes its fits; if it is between two, try again in a moment."
            )
        raise NotInStore("Nothing is running on this database; start a campaign with: goniometer run CAMPAIGN.")
    if len(active) > 1:
        raise InputError(f"Something is running on the benches {', '.join(sorted(active))}; name one with --bench")
    return next(iter(active.values()))
