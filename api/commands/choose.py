"""`goniometer choose`: the simplest model that a scene needs."""

from pathlib import Path
from typing import Annotated

import typer

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


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="choose")(choose_command)


def choose_command(
    dataset: DatasetName,
    scene: Annotated[
        Path,
        typer.Option(help="Scene in YAML, or of Mitsuba (.xml) with a BSDF of the id sample.", show_default=False),
    ],
    tolerance: Annotated[float, typer.Option(min=0.01, help="Largest mean dE00 in the scene.")] = 1.0,
    dielectric: Annotated[bool, typer.Option("--dielectric", help="Take the ladder of a dielectric.")] = False,
    rendering: Annotated[
        bool, typer.Option("--render/--no-render", help="Verify the answer by rendering, where Mitsuba is installed.")
    ] = True,
    page: Page = None,
    weights: Annotated[
        Path | None, typer.Option(help="File to write for a campaign's resolution.scene: what the scene asks for.")
    ] = None,
    bsdf: Annotated[
        Path | None, typer.Option(help="File to write for Mitsuba and PBRT: the model, with a scene beside it.")
    ] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """The simplest model whose colours in a scene stay within a tolerance, and why each cheaper one does not do."""
    from analysis.reports.choose import choice_body, summary, verified_lines
    from analysis.scenes.asked import scene_weights
    from analysis.strict_json import strict_json
    from api.results.choose import choice_content, choose_model, first_pass, mitsuba_is_there
    from api.results.derive import write_rung
    from api.written import write_text

    store = existing(database)
    dataset_id = chosen_dataset(store, dataset)
    seen = rendering and mitsuba_is_there()
    found = choose_model(store, dataset_id, scene, tolerance, dielectric=dielectric, rendering=seen)
    sample = store.dataset(dataset_id).sample
    written = None
    if page is not None:
        body = choice_body(found.choice, sample, scene.name, found.rendered)
        written = write_page(page, f"The model that {sample} needs", body).path
    if weights is not None:
        write_text("weights", weights, strict_json(scene_weights(found.choice.asked, scene.name).model_dump()))
    table = None
    if bsdf is not None and found.choice.chosen is not None:
        rung = found.choice.chosen.rung
        about = f"Model {rung.name} of sample {sample}, the simplest for {tolerance:g} dE00 in the scene {scene.name}."
        table = write_rung(bsdf, rung.model, about)[1][0]
    if as_json:
        page_path = None if written is None else str(written)
        weights_path = None if weights is None else str(weights)
        emit(
            {"dataset": dataset_id, "scene": str(scene), "page": page_path, "weights": weights_path}
            | {"bsdf": None if table is None else table.facts | {"path": str(table.path)}}
            | choice_content(found)
        )
        return
    out = stdout()
    for line in summary(found.choice):
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    for line in [] if found.rendered is None else verified_lines(found.rendered):
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)
    if weights is not None:
        told = first_pass(scene_weights(found.choice.asked, scene.name))
        out.print(f"Wrote {weights}; {told}", markup=False, highlight=False, soft_wrap=True)
    if bsdf is not None and table is None:
        out.print(f"No model was chosen, so {bsdf} was not written.", markup=False, highlight=False, soft_wrap=True)
    for line in [] if table is None else (f"Wrote {table.path}", *table.notes):
        out.print(line, markup=False, highlight=False, soft_wrap=True)
