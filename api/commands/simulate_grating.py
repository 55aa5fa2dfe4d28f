"""`goniometer simulate grating`: what many gratings of different spacing do to a spectrum (paper, section 5.2)."""

from pathlib import Path
from typing import Annotated

import typer

from api.commands.arguments import AsJson, Page, emit, write_page
from api.commands.logged import Logged
from api.commands.simulations import store_computed
from api.terminal import stdout
from simulators.choices import Spread

SMALLEST_UM, LARGEST_UM = 0.2, 30.0
"""Usual spacings. The paper names none. Finer ones than half the shortest wavelength have no first order anywhere; with
the largest between 22 and 40 um the first two bins see its end, as in the paper."""


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="grating", cls=Logged)(grating_command)


def grating_command(
    incident: Annotated[float, typer.Option(min=0, max=85, help="Incident angle of the figures, degrees.")] = 0.0,
    smallest_period: Annotated[float, typer.Option(help="Smallest spacing, um.")] = SMALLEST_UM,
    largest_period: Annotated[float, typer.Option(help="Largest spacing, um.")] = LARGEST_UM,
    even_in: Annotated[
        Spread, typer.Option(help="In what the spacings are spread evenly, for figure and dataset.")
    ] = Spread.SPACING,
    database: Annotated[
        Path | None, typer.Option("--database", "-d", help="SQLite database to store the BRDF in, as a dataset.")
    ] = None,
    page: Page = None,
    as_json: AsJson = False,
) -> None:
    """Spectra of many gratings, binned over the diffraction angle, and how far they are linear in the wavelength."""
    from api.simulated.gratings import binned, body, computed, content, table, told

    found = {spread: binned(incident, spread, smallest_period, largest_period) for spread in Spread}
    dataset = None
    if database is not None:
        dataset = store_computed(database, computed(even_in, smallest_period, largest_period))
    written = None
    if page is not None:
        chapters = body(found, incident, smallest_period, largest_period, even_in)
        written = write_page(page, "Gratings of many spacings", chapters).path
    if as_json:
        emit(content(found, incident, smallest_period, largest_period, even_in, dataset, written))
        return
    out = stdout()
    out.print(table(found))
    for line in told(found, incident, smallest_period, largest_period):
        out.print(line, markup=False, highlight=False)
    if dataset is not None:
        out.print(f"Stored in {database} as dataset {dataset}, gratings", markup=False, highlight=False)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)
