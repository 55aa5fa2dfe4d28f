"""A session with the simulated camera: a series of photographs on the disk, as a real camera would leave them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.photographs.files import write_tiff
from goniometer.photographs.series import Series, Shot, series_text
from simulators.photographs.camera import Scene, Sensor, photograph, pixel_sizes, response, scene
from simulators.topographies.heights import HeightField
from simulators.waves.speckle import Lighting

ANGLES = tuple(float(angle) for angle in range(-70, 71, 5))
"""Of the LED, degrees (section 3.3)."""

PANEL_REFLECTANCE = 0.99
"""Of the Spectralon panel at all wavelengths."""

CHECKED = (-20.0, 30.0, 45.0)
"""Some of them, backward, forward and in the mirror direction, at which convergence is shown."""

DARK = 1e-7
"""Brightness relative to a white panel below which the camera sees nothing, however long it is open."""

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
    frame is exposed as long as it needs; `done` is told how many are finished. Raises `InputError` where the extra for
    TIFFs is not installed.
    """
    shots, colours = [], []
    camera = response(taken.lights[0].wavelengths)
    sensitivity = camera.sensitivity
    for i, light in enumerate(taken.lights):
        angle = light.theta_in
        values = photograph(taken, sensor, i)
        exposure = sensor.exposure(values, sensitivity)
        name = f"{'minus' if angle < 0 else 'plus'}-{abs(angle):02.0f}.tif"
        write_tiff(folder / name, sensor.counts(values, sensitivity, exposure, seed=seed + 1 + i))
        shots.append(Shot(file=name, angle=angle, exposure=exposure))
        colours.append(values.mean(axis=(0, 1)))
        done(i + 1)
    panel = np.full_like(values, PANEL_REFLECTANCE)
    exposure = sensor.exposure(panel, sensitivity)
    write_tiff(folder / "white.tif", sensor.counts(panel, sensitivity, exposure, seed=seed))
    red, green, blue = (
        (round(float(r), 5), round(float(g), 5), round(float(b), 5)) for r, g, b in camera.colour_matrix
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


def convergence(field: HeightField, taken: Scene, finer: Sequence[Lighting], sensor: Sensor) -> Convergence:
    """Of photographs of `field` as `taken`, against `finer` lights at some of the same angles; the worst of all.

    Photographs that are dark are left out. Raises as `scene`.
    """
    angles = [light.theta_in for light in taken.lights]
    better = scene(field, taken.lens, finer, taken.conductor, taken.kernel)
    colours, contrasts = [], []
    for i, light in enumerate(finer):
        one = photograph(taken, sensor, angles.index(light.theta_in))
        if one.mean() < DARK:
            continue
        other = photograph(better, sensor, i)
        colours.append(np.abs(other.mean(axis=(0, 1)) / one.mean(axis=(0, 1)) - 1).max())
        contrasts.append(abs(_contrast(other) / _contrast(one) - 1))
    return Convergence(float(max(colours, default=0.0)), float(max(contrasts, default=0.0)))


def _contrast(image: FloatArray) -> float:
    together = image.sum(axis=-1)
    return float(together.std() / together.mean())
