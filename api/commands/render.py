"""`goniometer render`: what the shift changes of the look of a material."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.choices import Through
from api.commands.arguments import (
    DATABASE,
    AsJson,
    DatabaseFile,
    DatasetName,
    Page,
    chosen_dataset,
    emit,
    existing,
    write_page,
)
from api.terminal import stdout

if TYPE_CHECKING:
    from api.results.render import RenderedDataset


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="render")(render_command)


def render_command(
    dataset: DatasetName,
    dielectric: Annotated[bool, typer.Option("--dielectric", help="Take the models of a dielectric.")] = False,
    through: Annotated[
        Through | None,
        typer.Option(
            help="plugin: the exact model; bsdf: a table of it, faster where no vectorised variant of Mitsuba works. "
            "Usually whichever is fast.",
            show_default=False,
        ),
    ] = None,
    pixels: Annotated[int, typer.Option(min=16, max=2048, help="Of a side of the pictures.")] = 256,
    samples: Annotated[int, typer.Option(min=1, help="Of a pixel, twice.")] = 64,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the pictures, usually render-SAMPLE.")
    ] = None,
    page: Page = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Render Cook-Torrance without and with shift side by side, and compare their colours and render times."""
    from analysis.choices import MODEL_NAMES
    from analysis.mitsuba.vase_render import SEEDS
    from analysis.reports.render import comparison_body, comparison_lines, time_line
    from api.results.render import render_dataset
    from api.written import slug

    store = existing(database)
    dataset_id = chosen_dataset(store, dataset)
    folder = output or Path(f"render-{slug(store.dataset(dataset_id).sample)}")
    found = render_dataset(
        store, dataset_id, folder, dielectric=dielectric, through=through, pixels=pixels, samples=samples
    )
    names = (MODEL_NAMES[found.models[0]], MODEL_NAMES[found.models[1]])
    lines = [
        *comparison_lines(found.comparison, names),
        time_line(found.pictures.seconds, names),
        f"Rendered with {len(SEEDS)} x {samples} samples of a pixel in the variant {found.variant.name}, by the "
        f"plugin {'ggx_shift' if found.through == 'plugin' else 'measured'}.",
    ]
    written = None
    if page is not None:
        seconds, notes = found.pictures.seconds, list(found.notes)
        body = comparison_body(found.comparison, seconds, names, found.sample, lines, notes, found.trusted)
        written = write_page(page, f"What the shift changes of {found.sample}", body).path
    if as_json:
        emit({"dataset": dataset_id, "page": None if written is None else str(written)} | _content(found, samples))
        return
    out = stdout()
    for line in [*lines, *found.notes]:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    for path in [*(file.path for file in found.files), *([] if written is None else [written])]:
        out.print(f"Wrote {path}", markup=False, highlight=False)


def _content(found: RenderedDataset, samples: int) -> dict[str, object]:
    from analysis.mitsuba.vase_render import SEEDS

    comparison = found.comparison
    return {
        "sample": found.sample,
        "models": list(found.models),
        "dE00": {"mean": comparison.mean, "u_mean": comparison.u_mean, "p95": comparison.p95},
        "compared_pixels": int(comparison.covered.sum()),
        "clipped_share": comparison.clipped,
        "dark_share": comparison.dark,
        "pixels": len(comparison.covered),
        "samples": samples * len(SEEDS),
        "seconds": {model: found.pictures.seconds[:, i].tolist() for i, model in enumerate(found.models)},
        "variant": found.variant.name,
        "through": found.through,
        "trusted": found.trusted,
        "notes": list(found.notes),
        "files": [str(file.path) for file in found.files],
    }
