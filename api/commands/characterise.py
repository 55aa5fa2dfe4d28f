"""Commands by which the bench measures itself: characterise signature, noise, alignment, repeatability, wavelength."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, bench_of, emit
from api.commands.logged import Logged
from api.terminal import confirm, stderr, stdout, wait

if TYPE_CHECKING:
    from api.characterise import Found
    from goniometer.bench.instrument import Instrument
    from goniometer.certificates.certificate import PanelCertificate
    from goniometer.characterisation.characterise import Mount, Piece

REQUESTS: dict[Piece, tuple[str, str]] = {
    "mirror": ("the mirror is mounted", "Mount the mirror, check that it lies flat against the holder"),
    "spectralon": (
        "the reference panel (Spectralon) is mounted",
        "Mount the reference panel (Spectralon), check that it lies flat against the holder",
    ),
    "mercury-argon": (
        "the mercury-argon lamp shines",
        "Put the mercury-argon lamp in place of the sample, so that the detector sees it, and switch it on",
    ),
    "nothing": ("nothing is mounted", "Take everything off the sample holder"),
}
"""What must be so, and what a person is asked for."""

InstrumentFile = Annotated[
    Path | None, typer.Option("--instrument", help="Instrument file (TOML); without it the simulated bench is used.")
]
FigureFile = Annotated[Path | None, typer.Option("--output", "-o", help="Plot to write, .svg.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the simulated bench.")]
IncidentAngle = Annotated[float, typer.Option(min=5, max=75, help="Incident angle on the mirror, degrees.")]

commands = typer.Typer(
    help="Measure the bench itself and propose what the instrument file should say.", rich_markup_mode=None
)


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.add_typer(commands, name="characterise")


@commands.command(cls=Logged)
def signature(
    theta_in: IncidentAngle = 30.0,
    instrument: InstrumentFile = None,
    database: DatabaseFile = DATABASE,
    output: FigureFile = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Instrument signature: what the bench makes of a mirror, from its peak down to the floor."""
    from goniometer.characterisation.characterise import measure_signature

    _characterise(partial(measure_signature, theta_in=theta_in), instrument, database, output, seed, as_json=as_json)


@commands.command(cls=Logged)
def noise(
    integration_time: Annotated[float, typer.Option(min=0.001, help="Of one exposure, seconds.")] = 1.0,
    scans: Annotated[int, typer.Option(min=3, help="Exposures whose scatter is taken.")] = 20,
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate of the white panel (CSV); without it nominal values serve.")
    ] = None,
    instrument: InstrumentFile = None,
    database: DatabaseFile = DATABASE,
    output: FigureFile = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Noise-equivalent and stray-light-equivalent BRDF over wavelength, for one exposure."""
    from goniometer.certificates.certificate import NOMINAL_SRS99
    from goniometer.certificates.certificate_file import parse_certificate, read_certificate
    from goniometer.characterisation.characterise import measure_noise

    panel: PanelCertificate = NOMINAL_SRS99
    if certificate is not None:
        panel = parse_certificate(read_certificate(certificate), str(certificate))
    measure = partial(measure_noise, certificate=panel, integration_time=integration_time, scans=scans)
    _characterise(measure, instrument, database, output, seed, as_json=as_json)


@commands.command(cls=Logged)
def alignment(
    instrument: InstrumentFile = None,
    database: DatabaseFile = DATABASE,
    output: FigureFile = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Zeros of both stages, from a mirror and from the edges of the blocked sector."""
    from goniometer.characterisation.characterise import measure_alignment

    _characterise(measure_alignment, instrument, database, output, seed, as_json=as_json)


@commands.command(cls=Logged)
def repeatability(
    theta_in: IncidentAngle = 30.0,
    returns: Annotated[int, typer.Option(min=6, max=20, help="How often each stage comes back.")] = 10,
    instrument: InstrumentFile = None,
    database: DatabaseFile = DATABASE,
    output: FigureFile = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """How well both stages come back to the same direction, on the flank of a mirror's peak."""
    from goniometer.characterisation.characterise import measure_repeatability

    measure = partial(measure_repeatability, theta_in=theta_in, returns=returns)
    _characterise(measure, instrument, database, output, seed, as_json=as_json)


@commands.command(cls=Logged)
def wavelength(
    instrument: InstrumentFile = None,
    database: DatabaseFile = DATABASE,
    output: FigureFile = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """The wavelength scale against the known lines of a mercury-argon lamp."""
    from goniometer.characterisation.characterise import measure_wavelengths

    _characterise(measure_wavelengths, instrument, database, output, seed, as_json=as_json)


async def ask_for(piece: Piece) -> None:
    """Ask a person to put something on the sample stage; raises `RunAborted` without a terminal."""
    state, request = REQUESTS[piece]
    await confirm(state, f"{request}, and press Enter.")


def _characterise(
    measure: Callable[[Instrument, Mount], Awaitable[Found]],
    instrument: Path | None,
    database: str,
    output: Path | None,
    seed: int,
    *,
    as_json: bool,
) -> None:
    """Run a measurement, keep its result, tell it, and draw it."""
    from api.characterise import characterise, check_figure, content, instrument_lines, lines, write_figure
    from api.settings import load_instrument
    from goniometer.constants import BenchData
    from goniometer.storage.store import Store

    if output is not None:
        check_figure(output)
    settings = load_instrument(instrument) if instrument else None
    if settings is not None:
        stderr().print("Opening all devices; the measurement takes some minutes.", highlight=False)
    found, proposed = wait(
        characterise(Store.open(database, bench_of(None, settings)), settings, seed, ask_for, measure)
    )
    written = None if output is None else write_figure(found, output).path
    if as_json:
        emit(content(found, proposed) | {"path": None if written is None else str(written)})
        return
    out = stdout()
    stated = BenchData() if settings is None else settings.bench_data
    told = lines(found, stated)
    if proposed:
        told += ["", f"For {instrument or 'the instrument file'}:", *instrument_lines(proposed)]
    if written is not None:
        told.append(f"Wrote {written}")
    for line in told:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
