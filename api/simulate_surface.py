"""`goniometer simulate surface`: a topography and its roughness."""

from dataclasses import asdict

import typer
from rich.console import Console

from api.arguments import AsJson, emit
from api.simulations import Micro, Pitch, Seed, Size, SurfaceName
from simulators.heights import roughness
from simulators.topography import topography


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="surface")(surface_command)


def surface_command(
    surface: SurfaceName,
    size: Size = None,
    pitch: Pitch = None,
    seed: Seed = 1,
    micro: Micro = False,
    as_json: AsJson = False,
) -> None:
    """Make a surface and tell its roughness after ISO 25178."""
    made = topography(surface, size, pitch, seed, micro=micro)
    found = roughness(made.field)
    if as_json:
        emit({"surface": made.origin, "roughness": asdict(found)})
        return
    out = Console()
    out.print(
        f"{made.name}: Sq {found.sq_um:.4g} µm, Sdq {found.sdq:.4g}, Sdr {100 * found.sdr:.3g} %, "
        f"Sal {found.sal_um:.3g} µm",
        markup=False,
        highlight=False,
    )
