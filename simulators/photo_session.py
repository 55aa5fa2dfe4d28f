"""A session with the simulated camera: a series of photographs on the disk, as a real camera would leave them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.photo_files import write_tiff
from goniometer.photo_series import Series, Shot, series_text
from simulators.camera import Scene, Sensor, photograph, pixel_sizes, scene
from simulators.heights import HeightField
from simulators.speckle import Lighting

ANGLES = np.arange(-70.0, 71.0, 5.0)
"""Of the LED, degrees (section 3.3)."""

PANEL_REFLECTANCE = 0.99
"""Of the Spectralon panel at all wavelengths."""

CHECKED = np.array([-20.0, 30.0])
"""Two of them, backward and forward, at which convergence is shown."""

SERIES = "series.toml"
"""Name of the file that describes the series."""


@dataclass(frozen=True)
class Convergence:
    """How much photographs change under finer lighting."""

    colour: float
    """Largest change of a channel's mean, relative."""
    contrast: float
    """Change of the speckle contrast of all channels together, relative."""

    @property
    def reached(self) -> bool:
        """Whether both are below one per cent."""
        return max(self.colour, self.contrast) < 0.01

    @property
    def message(self) -> str:
        """One sentence for the user."""
        change = (
            f"Twice as many wavelengths and points of the LED change mean colours by {100 * self.colour:.2g} % and the "
            f"speckle contrast by {100 * self.contrast:.2g} %"
        )
        return f"{change}." if self.reached else f"{change}, which is more than 1 %: do not trust them to better."


def take_series(
    taken: Scene, sensor: Sensor, sample: str, folder: Path, seed: int, done: Callable[[int], None]
) -> tuple[Path, FloatArray]:
    """Photograph all angles of `taken` and the panel into `folder`; return the series file and the mean colours.

    The colours [angles, 3] are white-balanced and without noise, relative to a white panel at normal incidence. Each
    frame is exposed as long as it needs; `done` is told how many are finished.
    """
    shots, colours = [], []
    sensitivity = taken.response.sensitivity
    for i, angle in enumerate(taken.lighting.angles):
        values = photograph(taken, sensor, i)
        exposure = sensor.exposure(values, sensitivity)
        name = f"{'minus' if angle < 0 else 'plus'}-{abs(angle):02.0f}.tif"
        write_tiff(folder / name, sensor.counts(values, sensitivity, exposure, seed=seed + 1 + i))
        shots.append(Shot(file=name, angle=float(angle), exposure=exposure))
        colours.append(values.mean(axis=(0, 1)))
        done(i + 1)
    panel = np.full_like(values, PANEL_REFLECTANCE)
    exposure = sensor.exposure(panel, sensitivity)
    write_tiff(folder / "white.tif", sensor.counts(panel, sensitivity, exposure, seed=seed))
    red, green, blue = (
        (round(float(r), 5), round(float(g), 5), round(float(b), 5)) for r, g, b in taken.response.colour_matrix
    )
    series = Series(
        sample=sample,
        camera_angle=taken.lens.theta_out,
        encoding="linear",
        black_level=sensor.black_level,
        pixel_um=pixel_sizes(taken.lens, sensor)[0],
        colour_matrix=(red, green, blue),
        white=Shot(file="white.tif", angle=0.0, exposure=exposure),
        frames=tuple(shots),
    )
    path = folder / SERIES
    path.write_text(series_text(series), encoding="utf-8")
    return path, np.array(colours)


def convergence(field: HeightField, taken: Scene, finer: Lighting, sensor: Sensor) -> Convergence:
    """Of photographs of `field` as `taken`, against the `finer` lighting at some of the same angles."""
    better = scene(field, taken.lens, finer, taken.conductor, taken.kernel)
    colours, contrasts = [], []
    for i, angle in enumerate(finer.angles):
        same = int(np.flatnonzero(taken.lighting.angles == angle)[0])
        one, other = photograph(taken, sensor, same), photograph(better, sensor, i)
        colours.append(np.abs(other.mean(axis=(0, 1)) / one.mean(axis=(0, 1)) - 1).max())
        contrasts.append(abs(_contrast(other) / _contrast(one) - 1))
    return Convergence(float(max(colours)), float(max(contrasts)))


def _contrast(image: FloatArray) -> float:
    together = image.sum(axis=-1)
    return float(together.std() / together.mean())
