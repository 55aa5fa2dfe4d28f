"""What the simulations of the command line have in common: which surface, and where results go."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniometer.errors import InputError
from simulators.choices import PITCH_UM, SIZE

if TYPE_CHECKING:
    from drivers.arrays import FloatArray
    from simulators.computed import Computed

SurfaceName = Annotated[
    str,
    typer.Argument(
        help="A sample, e.g. sample-1, gaussian:RMS:LENGTH or brushed:RMS:ACROSS:ALONG (um), or a topography file.",
        show_default=False,
    ),
]
Size = Annotated[
    int | None,
    typer.Option(min=16, max=16384, help=f"Points along each side of a synthesised surface, usually {SIZE}."),
]
Pitch = Annotated[float | None, typer.Option(min=0.01, help=f"Distance of its points, um, usually {PITCH_UM:g}.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the surface and of all that is random.")]
Micro = Annotated[bool, typer.Option("--micro", help="Put 40 nm of roughness below the wavelength on it.")]


MOST_VALUES = 1000
"""Of one series of angles or wavelengths."""


def series(option: str, text: str) -> FloatArray:
    """Numbers, ascending, of "first:last:step" or "a,b,c"; raises `InputError` for another form."""
    import numpy as np

    try:
        if ":" in text:
            first, last, step = map(float, text.split(":"))
            steps = int((last - first) / step + 1e-9)
            values = first + step * np.arange(steps + 1 if steps < MOST_VALUES else 0)
        else:
            values = np.unique([float(each) for each in text.split(",")])
    except (ValueError, ZeroDivisionError, OverflowError):
        values = np.empty(0)
    if not values.size or not np.isfinite(values).all() or np.any(np.diff(values) <= 0):
        raise InputError(
            f"{option} {text} should read FIRST:LAST:STEP, e.g. 0:80:10, of at most {MOST_VALUES} values, or list "
            f"values, e.g. 0,30."
        )
    return np.asarray(values, dtype=float)


def store_computed(database: Path | str, computed: Computed) -> int:
    """Put a simulated BRDF into a database, as a dataset of no scan, and return its id."""
    from goniometer.storage.store import Store
    from simulators.computed import computed_dataset

    return Store.open(database).add_dataset(None, computed_dataset(computed))
