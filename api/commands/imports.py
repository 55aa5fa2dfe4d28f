"""The command that imports what was measured elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, emit
from api.commands.logged import Logged
from api.terminal import stdout
from goniometer.choices import Quantity

if TYPE_CHECKING:
    from goniometer.datasets.dataset import Dataset


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="import", cls=Logged)(import_command)


def import_command(
    file: Annotated[
        Path,
        typer.Argument(help="JSON of points, table, raw text of a goniometer, or an HDF5, CSV or Parquet of export."),
    ],
    sample: Annotated[str | None, typer.Option(help="Name of the sample, if not as in the file.")] = None,
    relative_uncertainty: Annotated[
        float | None,
        typer.Option(min=0, help="Combined standard uncertainty of a value, as a part of it, e.g. 0.02."),
    ] = None,
    aperture: Annotated[
        float | None, typer.Option(min=0, max=20, help="Full angle of the detector's aperture, degrees; 0 for a point.")
    ] = None,
    angle_uncertainty: Annotated[
        float | None, typer.Option(min=0, max=10, help="Standard uncertainty of either angle, degrees.")
    ] = None,
    relative_noise: Annotated[
        float | None,
        typer.Option(
            min=1e-12,
            help="Noise of a value against its neighbouring wavelengths; without it, taken from their scatter.",
        ),
    ] = None,
    lowest: Annotated[float, typer.Option(min=0, help="Shortest wavelength to import, nm.")] = 0.0,
    highest: Annotated[float, typer.Option(min=0, help="Longest wavelength to import, nm.")] = float("inf"),
    quantity: Annotated[
        Quantity | None,
        typer.Option(
            help="Table: what the values are; BRDF in 1/sr, that times the cosine of an angle, or pi times the BRDF."
        ),
    ] = None,
    angles: Annotated[Literal["deg", "rad"] | None, typer.Option(help="Table: unit of the angles.")] = None,
    wavelengths: Annotated[Literal["nm", "um"] | None, typer.Option(help="Table: unit of the wavelengths.")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Raw text: scan of the reference panel by the same instrument.")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="Raw text: CSV file of the panel's certificate.")] = None,
    darks: Annotated[Path | None, typer.Option(help="Raw text: spectra without light, in the same format.")] = None,
    dark_subtracted: Annotated[
        bool, typer.Option("--dark-subtracted", help="Raw text: the instrument has subtracted the dark signal.")
    ] = False,
    saturation: Annotated[
        float | None, typer.Option(min=1, help="Raw text: counts from which on a pixel is saturated.")
    ] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Import a BRDF that was measured elsewhere as a dataset of its own; what the file does not say, you state."""
    from api.results.imports import Request, imported_file
    from api.results.quality import quality, quality_lines
    from goniometer.storage.store import Store

    asked = Request(
        path=file,
        sample=sample,
        relative_uncertainty=relative_uncertainty,
        relative_noise=relative_noise,
        aperture=aperture,
        angle_uncertainty=angle_uncertainty,
        lowest=lowest,
        highest=highest,
        quantity=quantity,
        angles=angles,
        wavelengths=wavelengths,
        reference=reference,
        certificate=certificate,
        darks=darks,
        dark_subtracted=dark_subtracted,
        saturation=saturation,
    )
    dataset = imported_file(asked)  # before a database is made for nothing
    store = Store.open(database)
    made = store.add_dataset(None, dataset)
    found = quality(store, made) | {"lineage": dataset.lineage}
    if as_json:
        emit(found)
        return
    out = stdout()
    for line in (_summary(file, made, dataset), *_notes(dataset), *quality_lines(found)[1:]):
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def _summary(file: Path, made: int, dataset: Dataset) -> str:
    import numpy as np

    f = np.where(dataset.brdf == 0, np.nan, np.abs(dataset.brdf))
    relative = "no value differs from zero, so that none has a relative uncertainty"
    if np.isfinite(f).any():
        noise, total = (np.nanmedian(u / f) for u in (dataset.u_counts, dataset.u))
        relative = (
            f"relative standard uncertainty (k = 1, median) {100 * total:.2g} %, of which {100 * noise:.2g} % is noise"
        )
    return (
        f"Imported {file.name} as dataset {made}, {dataset.sample}: {dataset.theta_in.size} points "
        f"at {np.unique(dataset.theta_in).size} incident angles, {dataset.wavelengths.size} wavelengths from "
        f"{dataset.wavelengths[0]:g} to {dataset.wavelengths[-1]:g} nm; {relative}."
    )


def _notes(dataset: Dataset) -> list[Any]:
    """What was done to the file; one that was reloaded is as it was."""
    if "reloaded" in dataset.lineage:
        return [f"It is the {dataset.kind} dataset with the content {dataset.content_hash[:12]}, as it was written."]
    notes = dataset.lineage["notes"]
    assert isinstance(notes, list)  # as it was written
    return notes
