"""`goniometer simulate photos`: macro photographs of a topography, as files that `goniometer photos` reads."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from api.commands.arguments import AsJson, emit
from api.commands.simulations import Micro, Pitch, Seed, Size, SurfaceName
from api.terminal import stderr, stdout
from goniometer.errors import InputError

CAMERA_ANGLE, MAGNIFICATION = 45.0, 1.0
"""Of the camera in degrees, and of its lens at its largest."""

MOST_POINTS = 8192**2
"""Of a refined surface; they take some gigabytes and minutes."""


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(name="photos")(photos_command)


def photos_command(
    surface: SurfaceName,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the photographs.", show_default=False)],
    size: Size = 1024,
    pitch: Pitch = 0.5,
    seed: Seed = 1,
    micro: Micro = False,
    f_number: Annotated[float, typer.Option(min=1, max=64, help="Aperture of the lens.")] = 11.0,
    led: Annotated[float, typer.Option(help="Full angle under which the surface sees the LED, degrees.")] = 1.0,
    as_json: AsJson = False,
) -> None:
    """Photograph an aluminium surface at 45 degrees under an LED at -70 to 70 degrees, by wave optics."""
    from rich.progress import Progress

    from analysis.reflectance.fresnel import load_conductor
    from api.written import make_folder
    from simulators.photographs.camera import Sensor, fineness_for, lighting_for, scene
    from simulators.photographs.session import ANGLES, CHECKED, convergence, take_series
    from simulators.topographies.topography import topography
    from simulators.waves.sampling import refined
    from simulators.waves.speckle import Lens

    made = topography(surface, size, pitch, seed, micro=micro)
    lens = Lens(f_number, MAGNIFICATION, CAMERA_ANGLE)
    lights = [lighting_for(made.field, lens, angle, led) for angle in ANGLES]
    times = fineness_for(made.field, lens, lights).times
    if made.field.heights_um.size * times**2 > MOST_POINTS:
        side = int(MOST_POINTS**0.5 / times)
        raise InputError(
            f"{made.name} must be refined {times} times, and then has more points than fit into memory; make it at "
            f"most {side} points wide at this pitch."
        )
    field = refined(made.field, times)
    points = f"{field.heights_um.shape[1]} x {field.heights_um.shape[0]} points"
    stderr().print(f"Computing the waves of {made.name} on {points}", markup=False, highlight=False)
    taken = scene(field, lens, lights, load_conductor())
    make_folder(output)
    sensor = Sensor()
    name = f"{made.name}, micro-roughness" if micro else made.name
    with Progress(console=stderr(), transient=True) as progress:
        task = progress.add_task("Photographing", total=len(ANGLES))
        path, colours = take_series(
            taken, sensor, name, output, seed, lambda count: progress.update(task, completed=count)
        )
    check = convergence(field, taken, [lighting_for(field, lens, angle, led, finer=2) for angle in CHECKED], sensor)
    if as_json:
        emit(
            {
                "series": str(path),
                "surface": made.origin,
                "f_number": f_number,
                "numerical_aperture": lens.numerical_aperture,
                "led": led,
                "refined": round(made.field.pitch_um / field.pitch_um),
                "convergence": asdict(check) | {"reached": check.reached},
                "frames": [
                    {
                        "angle": light.theta_in,
                        "wavelengths": light.wavelengths.size,
                        "rgb": rgb.tolist(),
                        "red_over_blue": float(rgb[0] / rgb[2]),
                    }
                    for light, rgb in zip(lights, colours, strict=True)
                ],
            }
        )
        return
    out = stdout()
    for line in (
        f"Wrote {len(ANGLES)} photographs and the panel's to {output}; look at them with: goniometer photos {path}",
        check.message,
    ):
        out.print(line, markup=False, highlight=False, soft_wrap=True)
