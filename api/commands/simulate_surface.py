"""`goniometer simulate surface`: topographies, their roughness, and what they look like."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.arguments import AsJson, Page, emit, write_page
from api.commands.simulations import Micro, Pitch, Seed, Size
from api.terminal import stdout
from goniometer.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from api.simulated.surface_facts import Described

SurfaceNames = Annotated[
    list[str],
    typer.Argument(
        help="Samples, e.g. sample-1, gaussian:RMS:LENGTH or brushed:RMS:ACROSS:ALONG (um), or topography files.",
        show_default=False,
    ),
]
MapFile = Annotated[
    Path | None, typer.Option("--output", "-o", help="NumPy archive (.npz) to write the height map to.")
]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="surface")(surface_command)


def surface_command(
    surfaces: SurfaceNames,
    size: Size = None,
    pitch: Pitch = None,
    seed: Seed = 1,
    micro: Micro = False,
    output: MapFile = None,
    page: Page = None,
    as_json: AsJson = False,
) -> None:
    """Make or read surfaces and tell their roughness after ISO 25178, with the paper's beside it."""
    from api.simulated.surface_facts import described, how_made, remark
    from api.simulated.surface_page import one_surface, several_surfaces, title
    from api.written import make_folder, write_file
    from simulators.topographies.topography import topography
    from simulators.topographies.topography_file import write_topography

    if output is not None and (len(surfaces) > 1 or output.suffix.lower() != ".npz"):
        raise InputError(f"{output} cannot hold what is asked for; name one surface, and a file that ends in .npz.")
    found = [described(topography(surface, size, pitch, seed, micro=micro)) for surface in surfaces]
    written = []
    if output is not None:
        make_folder(output.resolve().parent)
        written.append(write_file("map", output, lambda part: write_topography(part, found[0].surface.field)).path)
    if page is not None:
        body = one_surface(found[0]) if len(found) == 1 else several_surfaces(found)
        written.append(write_page(page, title(found), body).path)
    if as_json:
        emit({"surfaces": [_content(one) for one in found], "written": [str(path) for path in written]})
        return
    out = stdout()
    for one in found:
        out.print(_table(one))
        for line in [*how_made(one.surface), remark(one)]:
            out.print(line, markup=False, highlight=False)
        out.print()
    for path in written:
        out.print(f"Wrote {path}", markup=False, highlight=False)


def _content(found: Described) -> dict[str, Any]:
    """For JSON."""
    return {
        "name": found.surface.name,
        "surface": found.surface.origin,
        "parameters": {key: asdict(row) for key, row in found.parameters.items()},
        "area_ratio": 1 + found.parameters["sdr"].value,
    }


def _table(found: Described) -> Table:
    from rich.table import Table

    from api.simulated.surface_facts import shown

    table = Table(title=found.surface.name, title_justify="left", box=None, pad_edge=False)
    for heading in ("", "value", "paper", "2 x pitch", "± (patch)", "meaning"):
        table.add_column(heading, justify="left" if heading in ("", "meaning") else "right")
    for row in found.parameters.values():
        table.add_row(
            row.symbol,
            shown(row.value, row.unit),
            "" if row.paper is None else shown(row.paper, row.unit),
            f"{100 * row.at_twice_the_pitch:+.1f} %",
            f"{100 * row.relative_error:.1f} %",
            row.meaning,
        )
    return table
