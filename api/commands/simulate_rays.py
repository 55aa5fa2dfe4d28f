"""`goniometer simulate rays`: a surface on the virtual gonioreflectometer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, Page, emit, write_page
from api.commands.logged import Logged
from api.commands.simulations import Micro, Pitch, Seed, Size, SurfaceName, series, store_computed
from api.terminal import stderr, stdout
from goniometer.errors import InputError

if TYPE_CHECKING:
    from analysis.reflectance.fresnel import Conductor
    from drivers.arrays import FloatArray
    from simulators.rays.decomposition import Change
    from simulators.rays.scan import Goniometer, RayScan
    from simulators.topographies.topography import Topography

_PATCHES = 4
"""Of a surface that is synthesised, unless said otherwise."""

_APART = 1000
"""Between the seeds of patches: each may use some that follow its own."""

_CHECKED = 3
"""Incident angles at which the pitch is doubled to see what it does."""


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="rays", cls=Logged)(rays_command)


def rays_command(
    context: typer.Context,
    surface: SurfaceName,
    size: Size = None,
    pitch: Pitch = None,
    seed: Seed = 1,
    micro: Micro = False,
    patches: Annotated[
        int | None,
        typer.Option(
            min=1, help=f"Synthesised patches, usually {_PATCHES}; a measured map is one.", show_default=False
        ),
    ] = None,
    rays: Annotated[int, typer.Option(min=1000, help="Rays for each incident angle.")] = 4_000_000,
    aperture: Annotated[float, typer.Option(min=0.1, max=10, help="Full angle of the detector, degrees.")] = 1.0,
    azimuth: Annotated[
        float,
        typer.Option(min=-360, max=360, help="Plane of incidence, degrees from x towards y; strokes run along x."),
    ] = 0.0,
    incident: Annotated[str, typer.Option(help="Incident angles in degrees, FIRST:LAST:STEP or A,B,C.")] = "0:80:10",
    outgoing: Annotated[str, typer.Option(help="Detector angles, likewise; positive is forward.")] = "-85:85:1",
    conductor: Annotated[
        str, typer.Option(help="Metal of the refractive index database, shelf/book/page.")
    ] = "main/Al/Cheng",
    database: DatabaseFile = DATABASE,
    page: Page = None,
    as_json: AsJson = False,
) -> None:
    """Trace rays over a surface: in-plane BRDF by geometric optics, decomposed by the number of reflections."""
    from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
    from api.results.products import conductor_name
    from api.simulated.ray_page import chapters
    from api.simulated.ray_results import computed, decomposition, lines, warnings
    from goniometer.storage.database import shown_place
    from simulators.rays.decomposition import CONVERGED
    from simulators.rays.scan import Goniometer
    from simulators.topographies.heights import roughness
    from simulators.topographies.topography import topography

    metal = load_conductor(*conductor_name(conductor))
    wavelengths = _covered(metal)
    theta_in, theta_out = series("--incident", incident), series("--outgoing", outgoing)
    n, k = metal.index(wavelengths)
    asked = Goniometer(
        theta_in,
        theta_out,
        wavelengths,
        partial(fresnel_conductor, n=n, k=k),
        0,
        rays,
        seed,
        aperture,
        azimuth,
    )
    made = _patches(
        surface, patches, lambda number: topography(surface, size, pitch, seed + _APART * number, micro=micro)
    )
    first = made[0]
    rough = roughness(first.field)
    scan, changes = _measured(made, asked, context.obj)
    minded = warnings(scan, changes, rough, first, micro=micro)
    name = f"{first.name} with micro-roughness" if micro else first.name
    dataset = store_computed(database, computed(f"{name} (rays)", scan, made, metal, minded))
    written = None
    if page is not None:
        body = chapters(scan, changes, minded, rough, len(made), periodic=first.field.periodic)
        written = write_page(page, f"Rays on {name}", body).path
    for warning in minded:
        stderr().print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    if as_json:
        emit(
            {
                "dataset": dataset,
                "sample": f"{name} (rays)",
                "database": shown_place(database),
                "surface": first.origin,
                "patches": len(made),
                "roughness": asdict(rough),
                "decomposition": decomposition(scan),
                "convergence": [asdict(change) | {"converged": change.largest < CONVERGED} for change in changes],
                "warnings": minded,
                "page": None if written is None else str(written),
            }
        )
        return
    out = stdout()
    for line in lines(scan, changes):
        out.print(line, markup=False, highlight=False)
    out.print(f"{name} (rays): dataset {dataset} in {shown_place(database)}", markup=False, highlight=False)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def _covered(metal: Conductor) -> FloatArray:
    """The wavelengths that the table of a conductor has."""
    import numpy as np

    wanted = np.arange(380.0, 991.0, 10.0)
    found = wanted[(metal.wavelengths[0] <= wanted) & (metal.wavelengths[-1] >= wanted)]
    if found.size < 2:
        raise InputError(
            f"The table of {metal.name} covers {metal.wavelengths[0]:g} to {metal.wavelengths[-1]:g} nm, but rays are "
            f"traced for {wanted[0]:g} to {wanted[-1]:g} nm; name another conductor."
        )
    return np.asarray(found)


def _patches(name: str, wanted: int | None, make: Callable[[int], Topography]) -> list[Topography]:
    """As many patches as are wanted; a measured map, which has no seed, is one patch and no more."""
    first = make(0)
    if "seed" not in first.origin:
        if wanted is not None:
            raise InputError(f"The map in {name} is one patch and not {wanted}; leave out --patches.")
        return [first]
    return [first, *(make(number) for number in range(1, wanted or _PATCHES))]


def _measured(made: list[Topography], asked: Goniometer, cluster: str | None) -> tuple[RayScan, tuple[Change, ...]]:
    """The scan, and what its figures would change with more of everything."""
    from api.executor import threads
    from api.simulated.ray_page import chosen
    from simulators.rays.decomposition import coarser, convergence
    from simulators.rays.rays import terrain
    from simulators.rays.scan import ray_scan

    fields = [each.field for each in made]
    fewer = replace(asked, theta_in=asked.theta_in[chosen(asked.theta_in.size, _CHECKED)])
    coarse = [terrain(coarser(field)) for field in fields]
    stderr().print(
        f"Tracing {asked.rays:,} rays for each of {asked.theta_in.size} incident angles, and for "
        f"{fewer.theta_in.size} of them at twice the pitch ...",
        markup=False,
        highlight=False,
    )
    whole = asked.theta_in.size + fewer.theta_in.size
    with threads(cluster) as executor, _shown() as show:
        scan = ray_scan(
            [terrain(field) for field in fields],
            asked,
            executor,
            lambda share: show(share * asked.theta_in.size / whole),
        )
        check = ray_scan(
            coarse, fewer, executor, lambda share: show((asked.theta_in.size + share * fewer.theta_in.size) / whole)
        )
    return scan, convergence(scan, check)


@contextmanager
def _shown() -> Iterator[Callable[[float], None]]:
    """A bar on stderr, if that is a terminal, that follows a share."""
    from rich.progress import Progress

    with Progress(console=stderr(), transient=True, disable=not stderr().is_terminal) as bars:
        task = bars.add_task("Tracing", total=1.0)
        yield lambda share: bars.update(task, completed=share)
