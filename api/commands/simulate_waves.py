"""`goniometer simulate waves`: the in-plane spectral BRDF of a surface by scalar wave optics."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.arguments import DATABASE, AsJson, DatabaseFile, Page, emit, write_page
from api.commands.logged import Logged
from api.commands.simulations import Micro, Seed, SurfaceName, series, store_computed
from api.terminal import stderr, stdout
from goniometer.errors import InputError
from goniometer.geometry import LARGEST_ANGLE
from simulators.choices import FEWEST, SIDE_UM, STEP_UM, Kernel

if TYPE_CHECKING:
    from drivers.arrays import FloatArray
    from simulators.waves.convergence import Convergence
    from simulators.waves.diffraction import Coherence
    from simulators.waves.scan import Setup
    from simulators.waves.simulation import WaveSimulation

APERTURE = 1.0
"""Usual full angle of the detector's aperture, degrees."""

Side = Annotated[
    int | None,
    typer.Option(
        "--size", min=16, max=16384, help=f"Points along each side of a patch, usually as many as make {SIDE_UM:g} um."
    ),
]
Step = Annotated[
    float | None,
    typer.Option("--pitch", min=0.01, help=f"Distance of its points, um, usually {STEP_UM:g}, or 0.1 with --micro."),
]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="waves", cls=Logged)(waves_command)


def waves_command(
    context: typer.Context,
    surface: SurfaceName,
    size: Side = None,
    pitch: Step = None,
    patches: Annotated[
        int, typer.Option(min=FEWEST, max=1000, help="Independent patches: other seeds, or tiles of a measured map.")
    ] = 12,
    seed: Seed = 1,
    micro: Micro = False,
    kernel: Annotated[Kernel, typer.Option(help="How the BRDF follows from the diffracted light.")] = (
        Kernel.HARVEY_SHACK
    ),
    aperture: Annotated[
        float | None, typer.Option(help=f"Full angle of the detector's aperture, degrees, usually {APERTURE:g}.")
    ] = None,
    coherence: Annotated[
        float | None, typer.Option(help="Width s of the coherence window at 600 nm, um, in place of an aperture.")
    ] = None,
    incident: Annotated[str, typer.Option(help="Incident angles, degrees, FIRST:LAST:STEP or A,B,C.")] = "0:80:10",
    outgoing: Annotated[str, typer.Option(help="Reflected angles, degrees, likewise.")] = "-85:85:1",
    wavelengths: Annotated[str, typer.Option(help="Wavelengths, nm, likewise.")] = "400:990:10",
    conductor: Annotated[
        str, typer.Option(help="Metal of the refractive index database, shelf/book/page.")
    ] = "main/Al/Cheng",
    with_multiple: Annotated[
        bool, typer.Option("--with-multiple", help="Add, from rays, the light that is reflected more than once.")
    ] = False,
    multiple_shift: Annotated[
        float | None,
        typer.Option(help="Slope of its wavelength shift, 1/um; otherwise that of the energy balance."),
    ] = None,
    database: DatabaseFile = DATABASE,
    page: Page = None,
    as_json: AsJson = False,
) -> None:
    """Simulate the BRDF of a surface by diffraction, store it as a dataset and say how far it is converged.

    The way back to the lamp, which a detector blocks on a bench, is among the directions.
    """
    from rich.progress import Progress

    from analysis.fits.analyse import analyse
    from analysis.fits.local_fit import LEAST_WAVELENGTHS
    from analysis.reflectance.fresnel import load_conductor
    from api.executor import processes
    from api.results.products import conductor_name
    from api.simulated.wave_page import page_body
    from simulators.computed import computed_dataset
    from simulators.waves.scan import Setup, choose_patches
    from simulators.waves.simulation import simulate

    if multiple_shift is not None and not with_multiple:
        raise InputError("A shift of light that is reflected more than once needs that light: give --with-multiple.")
    metal = load_conductor(*conductor_name(conductor))
    theta_in, theta_out = _directions(series("--incident", incident), series("--outgoing", outgoing))
    nm = series("--wavelengths", wavelengths)
    if nm.size < LEAST_WAVELENGTHS or nm[0] <= 0:
        raise InputError(
            f"--wavelengths {wavelengths} makes no spectrum; give at least {LEAST_WAVELENGTHS}, all above zero."
        )
    if nm[0] < metal.wavelengths[0] or nm[-1] > metal.wavelengths[-1]:
        raise InputError(
            f"The refractive index {metal.name} covers {metal.wavelengths[0]:g} to {metal.wavelengths[-1]:g} nm; "
            f"--wavelengths {wavelengths} leads beyond."
        )
    setup = Setup(theta_in, theta_out, nm, _coherence(aperture, coherence), kernel, metal)
    chosen = choose_patches(surface, size, pitch, seed, patches, micro=micro)
    workers = min(os.cpu_count() or 1, patches)
    with (
        Progress(console=stderr(), transient=True, disable=not stderr().is_terminal) as progress,
        processes(context.obj, workers) as executor,
    ):
        bar = progress.add_task(f"waves on {chosen.name}", total=None)

        def told(done: int, total: int) -> None:
            progress.update(bar, completed=done, total=total)

        found = simulate(chosen, setup, executor, told, seed if with_multiple else None, multiple_shift)
    if not found.sampling.sufficient:
        stderr().print(f"warning: {found.sampling.message}", style="yellow", markup=False, highlight=False)
    dataset_id = store_computed(database, found.computed)
    written = None
    if page is not None:
        analysis = analyse(computed_dataset(found.computed), metal, ("global",))
        written = write_page(page, f"{chosen.name}: what waves make of it", page_body(analysis, setup, found)).path
    if as_json:
        emit(_content(dataset_id, database, found, setup) | {"page": None if written is None else str(written)})
        return
    out = stdout()
    for line in _lines(dataset_id, found):
        out.print(line, markup=False, highlight=False)
    if written is not None:
        out.print(f"Wrote {written}", markup=False, highlight=False)


def _directions(incident: FloatArray, outgoing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out [points], degrees; no detector blocks a simulation."""
    import numpy as np

    if incident[0] < 0 or incident[-1] > LARGEST_ANGLE or np.abs(outgoing).max() > LARGEST_ANGLE:
        raise InputError(
            f"Incident angles lie between 0 and {LARGEST_ANGLE:g} degrees, reflected ones between "
            f"{-LARGEST_ANGLE:g} and {LARGEST_ANGLE:g}."
        )
    theta_in, theta_out = (each.ravel() for each in np.meshgrid(incident, outgoing, indexing="ij"))
    return theta_in, theta_out


def _coherence(aperture: float | None, s_um: float | None) -> Coherence:
    from simulators.waves.diffraction import Coherence, seen_through

    if s_um is not None:
        if aperture is not None:
            raise InputError("An aperture and a coherence window say the same; give one of them.")
        return Coherence(s_um)
    wanted = APERTURE if aperture is None else aperture
    if not 0 < wanted < 90:
        raise InputError(f"An aperture of {wanted:g} degrees sees nothing; give one above 0 and below 90 degrees.")
    return seen_through(wanted)


def _content(dataset_id: int, database: str, found: WaveSimulation, setup: Setup) -> dict[str, Any]:
    """The result as JSON."""
    from goniometer.storage.database import shown_place
    from simulators.waves.simulation import equivalent_aperture

    return {
        "dataset": dataset_id,
        "sample": found.computed.sample,
        "database": shown_place(database),
        "lineage": found.computed.lineage,
        "aperture_deg": equivalent_aperture(setup.coherence.s_um),
        "sampling": asdict(found.sampling) | {"sufficient": found.sampling.sufficient},
        "convergence": _convergence(found.convergence),
        "multiple": None
        if found.multiple is None
        else {
            "theta_in": found.multiple.theta_in.tolist(),
            "meets_again_at_600_nm": found.multiple.at_600(setup.wavelengths).tolist(),
            "meets_again_by_rays": found.multiple.again_by_rays.tolist(),
            "slope_per_um": found.multiple.slope.tolist(),
            "slope_derived": found.multiple.derived,
            "rays_lost": found.multiple.lost,
        },
    }


def _convergence(found: Convergence) -> dict[str, Any]:
    """With a verdict beside every change."""
    figures = [
        asdict(each) | {"converged": {name: each.converged(name) for name in each.changes}} for each in found.figures
    ]
    return asdict(found) | {"figures": figures}


def _lines(dataset_id: int, found: WaveSimulation) -> list[str]:
    """The result for a person."""
    import numpy as np

    from simulators.computed import computed_dataset
    from simulators.waves.convergence import CONVERGED

    computed = found.computed
    middle = int(np.argmin(np.abs(computed.wavelengths - 600)))
    dataset = computed_dataset(computed)
    lit = computed.brdf[:, middle] > 0
    error = float(np.median(dataset.u[lit, middle] / computed.brdf[lit, middle]))
    lines = [
        f"Dataset {dataset_id}, {computed.sample}: {computed.theta_in.size} directions, {computed.wavelengths.size} "
        f"wavelengths from {computed.wavelengths[0]:g} to {computed.wavelengths[-1]:g} nm.",
        found.sampling.message,
        f"f(600 nm) has a standard error of {100 * error:.2g} % in the median, from the spread of "
        f"{computed.lineage['patches']} patches.",
    ]
    for name, median in found.convergence.median.items():
        p95 = found.convergence.p95[name]
        if median is None or p95 is None:
            lines.append(f"{name}: not known, the patch is too large or too small for that.")
            continue
        word = "converged" if p95 < CONVERGED else "converged in most directions" if median < CONVERGED else "not yet"
        lines.append(f"{name}: f(600 nm) changes by {100 * median:.2g} % (95 of 100 below {100 * p95:.2g} %): {word}")
    if found.multiple is not None:
        slopes = ", ".join(f"{value:.2f}" for value in found.multiple.slope)
        lines.append(f"Light that is reflected more often has shifts of {slopes} 1/µm, by incident angle.")
    return lines
