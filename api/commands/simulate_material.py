"""`goniometer simulate material`: a dataset as what lies on the simulated bench."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, DatasetName, chosen_dataset, emit, existing
from api.commands.logged import Logged
from api.terminal import stdout
from goniometer.campaigns.material_file import MaterialFile
from goniometer.errors import InputError

if TYPE_CHECKING:
    from simulators.materials.tabulated import Tabulated


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="material", cls=Logged)(material_command)


def material_command(
    dataset: DatasetName,
    path: Annotated[Path | None, typer.Option("--output", "-o", help="File to write, .npz.")] = None,
    database: DatabaseFile = DATABASE,
    as_json: AsJson = False,
) -> None:
    """Write the BRDF of any dataset as a material that a campaign can lay on the simulated bench."""
    from api.results.derive import write_material
    from api.written import slug
    from simulators.materials.tabulated_file import read_tabulated

    store = existing(database)
    dataset_id = chosen_dataset(store, dataset)
    read = store.dataset(dataset_id)
    target = path or Path(f"{slug(read.sample)}.npz")
    if target.suffix != ".npz":
        raise InputError(f'A material is not written to "{target}"; end its name in .npz.')
    export = write_material(target, read)
    store.add_export(dataset_id, export.path, export.file_format, export.sha256)
    made = read_tabulated(export.path)
    if as_json:
        emit({"dataset": dataset_id, "path": str(export.path), "sha256": export.sha256, **_content(made)})
        return
    out = stdout()
    for line in _lines(made, export.path):
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def _content(made: Tabulated) -> dict[str, object]:
    return {
        "sample": made.name,
        "theta_in_deg": [row.theta_in for row in made.rows],
        "theta_out_range_deg": list(made.range_out),
        "directions": sum(row.theta_out.size for row in made.rows),
        "filled_directions": made.filled,
        "wavelengths_nm": made.wavelengths.tolist(),
        "aperture_deg": made.aperture,
        "origin": made.origin,
    }


def _lines(made: Tabulated, path: Path) -> list[str]:
    directions = sum(row.theta_out.size for row in made.rows)
    angles = ", ".join(f"{row.theta_in:.3g}" for row in made.rows)
    filled = f"{made.filled} of them filled by what stands around them" if made.filled else "none of them filled"
    aperture = f"averages over an aperture of {made.aperture:g}°" if made.aperture else "values without aperture"
    left, right = made.range_out
    return [
        f"Wrote {path}",
        f"{made.name}: {directions} directions, {filled}; {aperture}; {made.wavelengths.size} wavelengths from "
        f"{made.wavelengths[0]:g} to {made.wavelengths[-1]:g} nm",
        f"Measure it at the incident angles {angles}°, where nothing is read in between, and θ out from {left:g}° to "
        f"{right:g}°".replace("-", "−"),
        f"In a campaign beside it: material: {MaterialFile(Path(path.name))}",
    ]
