"""Slopes of spectra by wave optics, over surfaces that differ in one thing at a time; part of `claims`.

Spectra are means over all places of the window on a periodic patch, over both planes of incidence along its sides, over
light from either side, and over seeds. To each, a straight line with a free scale is fitted, a (1 + m (lambda - 600)),
without Fresnel's reflectance, which all kernels only multiply: m is what diffraction does. Errors are from the
jackknife over seeds and planes of incidence. Directions darker than `DARK` are left out.
"""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import FloatArray
from simulators.choices import Kernel
from simulators.materials.materials import SAMPLES
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import sandblasted_sample, with_micro_roughness
from simulators.waves.diffraction import Coherence, seen_through
from simulators.waves.sampling import CoarseSampling
from simulators.waves.waves import Averaged, averaged, averaged_brdf, obliquity, scattering_vectors
from tests.benchmarks.claims_elements import mean_squares

NM = np.linspace(380.0, 780.0, 20)
INCIDENT, REFLECTED = np.array([0.0, 20.0, 40.0, 60.0]), np.arange(-80.0, 81.0, 2.0)
IN, OUT = (each.ravel() for each in np.meshgrid(INCIDENT, REFLECTED, indexing="ij"))
TILT = (OUT - IN) / 2
"""[directions] theta_m, degrees; positive from the mirror direction towards the horizon ahead, negative towards the
lamp."""
DARK = 1e-4
"""BRDF at 600 nm below which a direction is called dark, 1/sr."""

BANDS = {
    "ahead 25-40": (25.0, 40.0),
    "ahead 10-20": (10.0, 20.0),
    "mirror 0-5": (-5.0, 5.0),
    "back 10-20": (-20.0, -10.0),
    "back 25-40": (-40.0, -25.0),
    "back 45-70": (-70.0, -45.0),
}
"""Of theta_m, degrees."""

PATCH_UM = 256.0
PITCH_UM = 0.1
WINDOW = seen_through(1.0)
FIXED = Coherence(WINDOW.s_um, grows=False)
APART_UM = 51.2
"""Distance of the windows through which a map of Gaussian elements is seen."""


@dataclass(frozen=True)
class Slopes:
    """What the spectra of several looks at one kind of surface say; directions last."""

    brdf: FloatArray
    """[directions] at 600 nm, of a perfect mirror's material, 1/sr."""
    slope: FloatArray
    """[directions] 1/um."""
    without: FloatArray
    """[looks, directions] the slope without one of them, 1/um."""
    bent: FloatArray
    """[directions] rms departure of a spectrum from its line, as a share of it."""

    def band(self, tilts: tuple[float, float], theta_in: float | None = None) -> tuple[float, float, float]:
        """Mean slope of the directions between `tilts` that are not dark, its standard error, and their share."""
        inside = (tilts[0] <= TILT) & (tilts[1] >= TILT) & np.isfinite(self.brdf)
        if theta_in is not None:
            inside &= theta_in == IN
        if not inside.any():
            return float("nan"), float("nan"), float("nan")
        lit = inside & (self.brdf > DARK)
        if not lit.any():
            return float("nan"), float("nan"), 0.0
        looks = len(self.without)
        left = self.without[:, lit].mean(axis=1)
        error = np.sqrt((looks - 1) * left.var())
        return float(self.slope[lit].mean()), float(error), float(lit.sum() / inside.sum())


def line(spectra: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Level at 600 nm, slope in 1/um and relative rms residual [...] of `spectra` [..., nm]; NaN where dark."""
    columns = np.stack([np.ones_like(NM), (NM - 600) / 1000], axis=1)
    level, rise = np.moveaxis(spectra @ np.linalg.pinv(columns).T, -1, 0)
    residual = spectra - np.stack([level, rise], axis=-1) @ columns.T
    lit = np.where(level == 0, np.nan, level)
    return level, rise / lit, np.sqrt((residual**2).mean(axis=-1)) / np.abs(lit)


def slopes(looks: FloatArray) -> Slopes:
    """Of `looks` [looks, directions, wavelengths]."""
    total = looks.sum(axis=0)
    level, slope, bent = line(total)
    return Slopes(level / len(looks), slope, np.stack([line(total - look)[1] for look in looks]), bent)


def spectra(surface: Averaged, kernel: Kernel = Kernel.HARVEY_SHACK) -> FloatArray:
    """[directions, wavelengths] mean of light from either side."""
    there, mirrored = (averaged_brdf(surface, side * IN, side * OUT, NM, kernel).brdf for side in (1, -1))
    return (there + mirrored) / 2


def planes(field: HeightField, coherence: Coherence = WINDOW) -> list[Averaged]:
    """`field` seen along x and along y; the window is never smaller than `WINDOW`, so that it may be exchanged."""
    across = replace(field, heights_um=np.ascontiguousarray(field.heights_um.T))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CoarseSampling)  # coarse maps are what is looked at
        return [averaged(each, IN, OUT, NM, coherence) for each in (field, across)]


def looked_at(fields: Iterable[HeightField], coherence: Coherence = WINDOW) -> Slopes:
    """Slopes from all `fields`, each seen in both planes."""
    return slopes(np.stack([spectra(plane) for field in fields for plane in planes(field, coherence)]))


def craters(sample: str, seed: int, pitch_um: float = PITCH_UM, patch_um: float = PATCH_UM) -> HeightField:
    """A smooth sandblasted patch."""
    return sandblasted_sample(SAMPLES[sample], round(patch_um / pitch_um), pitch_um, seed).field


def rough(smooth: HeightField, seed: int, rms_um: float = 0.04, correlation_um: float = 0.2) -> HeightField:
    """`smooth` with micro-roughness on it."""
    return with_micro_roughness(smooth, 1000 + seed, rms_um, correlation_um)


def by_elements(fields: Iterable[HeightField]) -> Slopes:
    """Slopes from coarse `fields` read as Gaussian elements, at every other direction of 0 and 40 degrees incidence."""
    some = np.flatnonzero((OUT % 4 == 0) & np.isin(IN, (0.0, 40.0)))
    kx, kz = (each[some].ravel() for each in scattering_vectors(IN, OUT, NM))
    factor = obliquity(Kernel.HARVEY_SHACK, IN, OUT)[some, None] / (1e-3 * NM) ** 2
    looks = []
    for field in fields:
        square = mean_squares(field, WINDOW.s_um, APART_UM, kx, kz)
        looks.append(np.full((IN.size, NM.size), np.nan))
        looks[-1][some] = square.reshape(some.size, NM.size) * factor
    return slopes(np.stack(looks))
