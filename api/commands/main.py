"""The command line: thin faces over `api.service`.

Exit codes: 0 done, 1 the work failed, 2 bad input. Results go to stdout, progress and messages to stderr.
"""

from __future__ import annotations

import io
import logging
import os
import sys
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from analysis.choices import MODELS, Distribution, Engine, Weight
from analysis.errors import AnalysisError
from api.commands.access import register as add_access
from api.commands.arguments import (
    DATABASE,
    AsJson,
    BenchName,
    DatabaseFile,
    DatasetName,
    bench_of,
    chosen_dataset,
    emit,
    existing,
)
from api.commands.characterise import register as add_characterisations
from api.commands.choose import register as add_choose
from api.commands.db import register as add_db
from api.commands.export import register as add_export
from api.commands.export import tell_export
from api.commands.imports import register as add_import
from api.commands.logged import Logged
from api.commands.photos import register as add_photos
from api.commands.quality import register as add_quality
from api.commands.render import register as add_render
from api.commands.serve import register as add_serve
from api.commands.simulate import simulate
from api.commands.stability import register as add_stability
from api.commands.status import register as add_status
from api.commands.tradeoff import register as add_tradeoff
from api.display import duration, progress_display
from api.terminal import Stopped, ask_to_mount, stderr, stdout, wait
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, InputError, OptionError

if TYPE_CHECKING:
    from api.results.outcome import SampleOutcome

app = typer.Typer(
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"max_content_width": 120},
    rich_markup_mode=None,  # rich takes longer than all the rest of --help
)

CampaignFile = Annotated[Path, typer.Argument(help="Campaign file (YAML or JSON).", show_default=False)]
OutputFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder for fits, rendering files and reports.")]
UsageError: Any = typer.BadParameter.__mro__[1]  # typer gives it no public name of its own
OUTPUT = Path("results")


def _tell_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"goniometer {version('goniometer')}")
        raise typer.Exit


@app.callback()
def common(
    context: typer.Context,
    _: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Say which version this is.")
    ] = False,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler, tcp://HOST:PORT, that does heavy work."),
    ] = None,
) -> None:
    """Drives a spectral gonioreflectometer, calibrates what it measures, fits the BRDF and exports it."""
    context.obj = cluster


@app.command()
def demo(
    context: typer.Context,
    output: OutputFolder = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated bench's noise.")] = 1,
    as_json: AsJson = False,
) -> None:
    """The whole job on the simulated bench: scan, calibrate, fit, report and export three samples."""
    from api.commands.demo import demo as run_demo
    from api.results.outcome import STATED
    from api.service import Watch

    with progress_display(stderr()) as (show, note):
        result = wait(run_demo(output, seed, Watch(show, note, ask_to_mount), context.obj))
    if as_json:
        emit(asdict(result) | {"uncertainties": STATED})
        _fail_for(result.failures)
        return
    _show(result.samples)
    stdout().print(
        f"Took {duration(result.seconds)} here; the bench would have needed {duration(result.bench_seconds)}."
    )
    _fail_for(result.failures)


@app.command(name="run", cls=Logged)
def run_command(
    context: typer.Context,
    campaign: CampaignFile,
    database: DatabaseFile = DATABASE,
    output: OutputFolder = OUTPUT,
    instrument: Annotated[
        Path | None, typer.Option(help="Instrument file (TOML); without it the simulated bench is used.")
    ] = None,
    lamp_is_warm: Annotated[
        bool, typer.Option("--lamp-is-warm", help="It has burned long enough; do not wait for it to warm up.")
    ] = False,
    bench: BenchName = None,
    as_json: AsJson = False,
) -> None:
    """Run a campaign, or resume it where it stood."""
    from api.results.outcome import STATED, outcomes
    from api.service import Watch, run
    from api.settings import load_instrument
    from api.written import slug
    from goniometer.campaigns.campaign_file import load_campaign
    from goniometer.storage.store import Store

    wanted = load_campaign(campaign)
    settings = load_instrument(instrument) if instrument else None
    store = Store.open(database, bench_of(bench, settings))
    with progress_display(stderr()) as (show, note):
        folder = output / slug(wanted.name)
        watch = Watch(show, note, ask_to_mount)
        running = run(store, wanted, folder, settings, watch, lamp_is_warm=lamp_is_warm, cluster=context.obj)
        result = wait(running)
    samples = outcomes(store, result.campaign_id, truth=settings is None)
    if as_json:
        emit(
            {
                "campaign": wanted.name,
                "database": store.where,
                "samples": [asdict(sample) for sample in samples],
                "failures": result.failures,
                "uncertainties": STATED,
            }
        )
    else:
        _show(samples)
    _fail_for(result.failures)


@app.command()
def doctor(
    instrument: Annotated[
        Path | None, typer.Option(help="Instrument file (TOML); without it the simulated bench is examined.")
    ] = None,
    home: Annotated[
        bool, typer.Option("--home", help="Home stages that do not know their reference; look before they turn.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check every device: open it, read it, turn it a degree, and say in one line each what is wrong."""
    from api.service import diagnose
    from api.settings import load_instrument

    if instrument:
        stderr().print("Opening all devices; a warm spectrometer takes minutes to cool down.", highlight=False)
    findings = wait(diagnose(load_instrument(instrument) if instrument else None, home=home))
    fit = not any(finding.problems for finding in findings)
    if as_json:
        emit({"fit": fit, "findings": [asdict(finding) for finding in findings]})
    else:
        out = stdout()
        for finding in findings:
            style = "red" if finding.problems else None
            out.print(finding.line(), style=style, markup=False, highlight=False, soft_wrap=True)
    if not fit:
        raise typer.Exit(1)


def _fail_for(failures: tuple[str, ...]) -> None:
    """End with exit code 1 where some sample has no fits, once everything else has been shown."""
    if failures:
        _fail(" ".join(failures), 1)


def _show(samples: list[SampleOutcome]) -> None:
    from api.results.outcome import remarks, table

    out = stdout()
    out.print(table(samples))
    for line in remarks(samples):
        out.print(line, markup=False, highlight=False)


@app.command()
def plan(
    campaign: CampaignFile,
    instrument: Annotated[
        Path | None, typer.Option(help="Instrument file (TOML), for how its stages move, and how far.")
    ] = None,
    path: Annotated[Path | None, typer.Option("--output", "-o", help="Drawing to write, .svg.")] = None,
    database: Annotated[
        str | None,
        typer.Option(
            "--database", "-d", metavar="FILE|URL", help="Where it would be kept, for what was begun there already."
        ),
    ] = None,
    bench: BenchName = None,
    as_json: AsJson = False,
) -> None:
    """Preview a campaign: points, blocked range, travel and time, and what would be refused. Nothing moves."""
    from api.preflight import preflight
    from api.preview import drawing, preview
    from api.settings import load_instrument
    from api.written import write_text
    from goniometer.campaigns.campaign_file import load_campaign
    from goniometer.plans.plan_spec import ORDINARY
    from goniometer.scans.duration import DEAD_TIME

    if bench is not None and database is None:
        raise OptionError(
            "{bench} has no use without {database}; name the database or leave it out.", "bench", "database"
        )
    if path is not None and path.suffix != ".svg":
        raise InputError(f'A plan cannot be drawn to "{path}"; end its name in .svg.')
    wanted = load_campaign(campaign)
    settings = None if instrument is None else load_instrument(instrument)
    store = None if database is None else existing(database, bench_of(bench, settings))
    findings = preflight(store, wanted, settings)
    motion = ORDINARY if settings is None else settings.motion
    found = preview(wanted, motion, DEAD_TIME if settings is None else settings.spectrometer.dead_time)
    written = None if path is None else write_text("svg", path, drawing(wanted, motion)).path
    if as_json:
        emit(asdict(found) | {"findings": findings, "path": None if written is None else str(written)})
    else:
        out = stdout()
        for line in found.lines():
            out.print(line, markup=False, highlight=False)
        if written is not None:
            out.print(f"Wrote {written}", markup=False, highlight=False)
    for finding in findings:
        _refuse(finding)
    if findings:
        raise typer.Exit(2)


add_status(app)


@app.command(cls=Logged)
def fit(
    context: typer.Context,
    dataset: Annotated[list[str], typer.Argument(help="Numbers of datasets, or names of samples.", show_default=False)],
    model: Annotated[
        str | None, typer.Option(help=f"Only this model: {', '.join(MODELS)}.", show_default=False)
    ] = None,
    engine: Annotated[
        Engine, typer.Option(help="fast: own derivatives; lmfit: the library, with derivatives by differences.")
    ] = "fast",
    distribution: Annotated[Distribution, typer.Option(help="Distribution of the microfacets' normals.")] = "ggx",
    weight: Annotated[
        Weight, typer.Option(help="How the cost weighs its terms: all alike, by sin(theta_in), or by their noise.")
    ] = "none",
    conductor: Annotated[
        str, typer.Option(help="Metal of the refractive index database, shelf/book/page.")
    ] = "main/Al/Cheng",
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Fit datasets again and store the fits beside the earlier ones; several are fitted at once."""
    from api.executor import processes
    from api.results.products import HowToFit, fit_datasets, fit_lines

    store = existing(database)
    how = HowToFit(engine, distribution, weight, conductor)
    wanted = list(dict.fromkeys(chosen_dataset(store, each) for each in dataset))
    alone = len(wanted) == 1 and context.obj is None
    with nullcontext(None) if alone else processes(context.obj, min(os.cpu_count() or 1, len(wanted))) as executor:
        found = []
        for each in fit_datasets(store, wanted, model, how, executor):
            found.append(each)
            if not as_json:
                for line in fit_lines(each):
                    stdout().print(line, markup=False, highlight=False)
    if as_json:
        emit(found[0] if len(found) == 1 else {"datasets": found})


add_access(app)
add_characterisations(app)
add_choose(app)
add_db(app)
add_export(app)
add_import(app)
add_photos(app)
add_quality(app)
add_render(app)
add_serve(app)
add_stability(app)
add_tradeoff(app)
app.add_typer(simulate, name="simulate")


@app.command(cls=Logged)
def report(
    dataset: DatasetName,
    path: Annotated[Path | None, typer.Option("--output", "-o", help="HTML file to write.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Write the report of a dataset: one self-contained HTML file with all figures."""
    from api.results.products import report_dataset

    store = existing(database)
    tell_export(report_dataset(store, chosen_dataset(store, dataset), path), as_json=as_json)


class _Warnings(logging.Handler):
    """Shows what drivers and scans warn of on stderr, a line each, above the progress where there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        stderr().print(
            f"{record.levelname.lower()}: {record.getMessage()}",
            style="yellow",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


def main() -> NoReturn:
    """Entry point of `goniometer`: runs a command and turns typed errors into one line and an exit code."""
    for floor in ("drivers", "goniometer"):
        logging.getLogger(floor).addHandler(_Warnings(logging.WARNING))
    # Python gives None for what whoever started it has closed
    sys.stdout, sys.stderr = (each or open(os.devnull, "w") for each in (sys.stdout, sys.stderr))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # not every terminal has a Greek letter
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="goniometer", standalone_mode=False)
        sys.stdout.flush()
    except UsageError as error:
        command = error.ctx.command_path if error.ctx else "goniometer"
        _fail(f"{error.format_message().rstrip('.')}; see {command} --help", 2)
    except (GoniometerError, AnalysisError) as error:
        _fail(str(error), error.exit_code)
    except DriverError as error:
        _fail(str(error), 1)
    except OSError as error:
        _fail(f"{error.filename or 'The output'}: {error.strerror or error}; make room, or name another place.", 1)
    except Stopped:
        code = 143
    if code in {130, 143}:  # typer turns Ctrl-C into the first, SIGTERM and SIGHUP come as the second
        _fail("Stopped; run the same command again to go on where it stood.", code)
    sys.exit(code or 0)


def _refuse(message: str) -> None:
    stderr().print(f"goniometer: {message}", style="bold red", markup=False, highlight=False, soft_wrap=True)


def _fail(message: str, code: int) -> NoReturn:
    _refuse(message)
    sys.exit(code)
