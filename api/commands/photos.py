"""`goniometer photos`: what macro photographs under light from many angles say of a surface."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.arguments import AsJson, emit
from api.commands.logged import Logged
from api.terminal import stdout

if TYPE_CHECKING:
    from rich.table import Table

    from analysis.photo_statistics import PhotoStatistics
    from goniometer.photographs.photos import PhotoSeries


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="photos", cls=Logged)(photos)


def photos(
    series: Annotated[
        list[Path], typer.Argument(help="Files that describe series, see docs/photos.toml.", show_default=False)
    ],
    path: Annotated[Path | None, typer.Option("--page", help="HTML page with pictures and charts to write.")] = None,
    inset: Annotated[
        float, typer.Option(help="Side of the square in the centre that counts, over the shorter side.")
    ] = 0.5,
    as_json: AsJson = False,
) -> None:
    """Mean colours, redness and speckle of macro photographs under light from many angles."""
    from analysis.photo_statistics import photo_statistics
    from analysis.reports.photographs import photo_page, photo_remarks
    from api.written import make_folder, write_text
    from goniometer.photographs.photos import read_series

    read = [read_series(file, inset) for file in series]
    found = [photo_statistics(one) for one in read]
    written = None
    if path is not None:
        make_folder(path.resolve().parent)
        written = write_text("page", path, photo_page(read, found)).path
    if as_json:
        told = [_content(*one) for one in zip(series, read, found, strict=True)]
        emit({"series": told, "path": None if written is None else str(written)})
        return
    out = stdout()
    for one, statistics in zip(read, found, strict=True):
        out.print(_rows(one, statistics))
        for line in photo_remarks(one, statistics):
            out.print(line, markup=False, highlight=False)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def _content(file: Path, series: PhotoSeries, found: list[PhotoStatistics]) -> dict[str, Any]:
    from analysis.reports.photographs import photo_remarks

    return {
        "file": str(file),
        "sample": series.sample,
        "camera_angle": series.camera_angle,
        "gains": series.gains,
        "panel_unevenness": series.unevenness,
        "colour_matrix": None if series.colour_matrix is None else series.colour_matrix.tolist(),
        "remarks": photo_remarks(series, found),
        "photos": [
            asdict(s)
            | {name: getattr(s, name).tolist() for name in ("rgb", "srgb", "contrast_rgb")}
            | {"exposure": photo.exposure}
            for photo, s in zip(series.photos, found, strict=True)
        ],
    }


def _rows(series: PhotoSeries, found: list[PhotoStatistics]) -> Table:
    from rich.table import Table

    from goniometer.datasets.budget import COVERAGE_FACTOR

    rows = Table(title=f"{series.sample}, camera at {series.camera_angle:g}°", title_justify="left")
    for head in ("light", "over panel", "red over blue", "dE00 from neutral", "contrast", "saturated"):
        rows.add_column(head, justify="right")
    for s in found:
        rows.add_row(
            f"{s.angle:g}°",
            f"{s.luminance:.3g}",
            f"{s.red_over_blue:.3f} ± {COVERAGE_FACTOR * s.u_red_over_blue:.3f}",
            f"{s.delta_e:.1f}",
            f"{s.contrast:.2f}",
            f"{100 * s.saturated:.2g} %" if s.saturated else "",
        )
    return rows
