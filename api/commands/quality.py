"""Commands that ask how good a dataset is: budget, check and calibrate."""

from pathlib import Path
from typing import Annotated

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, DatasetName, chosen_dataset, emit, existing
from api.commands.logged import Logged
from api.terminal import stdout
from goniometer.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(name="budget")(budget)
    app.command(name="check")(check)
    app.command(name="calibrate", cls=Logged)(calibrate)


def budget(
    dataset: DatasetName,
    theta_in: Annotated[
        float | None, typer.Option(min=0, help="Incident angle, degrees; without it the one nearest 45.")
    ] = None,
    theta_out: Annotated[
        float | None, typer.Option(help="Reflected angle, degrees; without it the mirror direction.")
    ] = None,
    wavelength: Annotated[float | None, typer.Option(help="Wavelength, nm; without it 600.")] = None,
    path: Annotated[Path | None, typer.Option("--output", "-o", help="Plot to write, .svg or .html.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """What the uncertainty of a measured value consists of, at the measured direction nearest to the one given."""
    from analysis.wording import words
    from api.results.quality import budget_content, budget_lines, budget_rows, dataset_budget, write_budget

    store = existing(database)
    dataset_id = chosen_dataset(store, dataset)
    read = store.dataset(dataset_id)
    found = dataset_budget(read, theta_in, theta_out, wavelength)
    written = None if path is None else write_budget(read, found, path).path
    if as_json:
        emit(budget_content(dataset_id, found) | {"path": None if written is None else str(written)})
        return
    out = stdout()
    first, *rest = budget_lines(dataset_id, found, words(read).done)
    out.print(first, markup=False, highlight=False)
    out.print(budget_rows(found))
    for line in rest:
        out.print(line, markup=False, highlight=False)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def check(dataset: DatasetName, database: DatabaseFile = DATABASE, as_json: AsJson = False) -> None:
    """Sanity checks of a dataset and its flagged points; fails where a check failed."""
    from api.results.quality import quality, quality_lines

    store = existing(database)
    found = quality(store, chosen_dataset(store, dataset))
    if as_json:
        emit(found)
    else:
        _show(quality_lines(found))
    if not found["passed"]:
        raise typer.Exit(1)


def calibrate(
    dataset: DatasetName,
    certificate: Annotated[
        Path | None, typer.Option(help="CSV file of the reference's certificate; without it that of the campaign.")
    ] = None,
    without: Annotated[list[str] | None, typer.Option(help="Leave out this correction; may be repeated.")] = None,
    also: Annotated[
        list[str] | None, typer.Option("--with", help="Make this correction, too: aperture; may be repeated.")
    ] = None,
    override_name: Annotated[
        str | None, typer.Option(help="Who answers for a certificate that is missing or not valid.")
    ] = None,
    override_reason: Annotated[str | None, typer.Option(help="Why that person does.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Calibrate the raw data of a dataset anew, or of a measured sample that has none; older datasets stay."""
    from api.datasets import make_dataset, recalibrate, uncalibrated_scan
    from api.results.quality import quality, quality_lines, settings_of
    from goniometer.certificates.certificate import Override
    from goniometer.certificates.certificate_file import parse_certificate, read_certificate

    override = None
    if override_name is not None and override_reason is not None:
        override = Override(override_name, override_reason)
    elif override_name is not None or override_reason is not None:
        raise InputError("An override needs both --override-name and --override-reason.")
    settings = settings_of(without or [], also or [])
    store = existing(database)
    text = None
    if certificate is not None:
        text = read_certificate(certificate)
        parse_certificate(text, str(certificate))  # while its name is known
    old: int | None = None
    if (waiting := uncalibrated_scan(store, dataset)) is not None:
        new = make_dataset(store, waiting.id, certificate=text, settings=settings, override=override)
    else:
        old = chosen_dataset(store, dataset)
        new = recalibrate(store, old, text, settings, override)
    made = store.dataset(new)
    found = quality(store, new) | {
        "recalibrated_from": old,
        "certificate": made.lineage["certificate"],
        "corrections": made.lineage["corrections"],
    }
    if as_json:
        emit(found)
        return
    corrections = made.lineage["corrections"]
    assert isinstance(corrections, dict)  # by name, as calibration writes them
    origin = f"scan {store.scan_of(new)}" if old is None else f"dataset {old}"
    told = ", ".join(f"{name} {state}" for name, state in corrections.items())
    first = (
        f"Made dataset {new} from the raw data of {origin}, with the certificate {made.lineage['certificate']}.",
        f"Corrections: {told}",
    )
    _show([*first, *quality_lines(found)[1:]])


def _show(lines: list[str]) -> None:
    out = stdout()
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
