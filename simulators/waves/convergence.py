"""Whether a simulation by waves is converged: its published figures with the step, the window and the patches changed.

Some patches are computed again at half and at twice the step, from a topography of which every second point is
forgotten, and through a window twice as wide. All changes are those of the mean over these same patches.
"""

from dataclasses import dataclass, replace
from math import isnan

import numpy as np

from analysis.fits.local_fit import local_fit
from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import FloatArray
from goniometer.uncertainty import combined
from simulators.computed import PRECISION, Computed, computed_dataset
from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField, every_second
from simulators.waves.sampling import refined
from simulators.waves.scan import DARK, MOST_POINTS, Setup, average, seen

STUDIED = 2
"""Patches that are computed again."""

CONVERGED = 0.01
"""Relative change of a reflectance below which it counts as converged."""

CONVERGED_SLOPE = 0.05
"""The same of a slope, 1/um: 200 nm from where the shift is one, it changes a spectrum by one part in a hundred."""

LEAST_PART = 1e-3
"""Directions darker than this part of a Lambertian surface's 1 / pi are left out of the summary."""

_INCIDENT = (0.0, 40.0, 80.0)
_OFF_MIRROR = (0.0, -20.0, -40.0, -80.0)
"""Where the published figures stand, degrees: incident angles, and directions from the mirror direction."""

HALF_STEP, TWICE_STEP, COARSER, WINDOW = "half the step", "twice the step", "every second height", "twice the window"
PATCHES = "half the patches"


@dataclass(frozen=True)
class Figure:
    """One published figure and what becomes of it."""

    theta_in: float
    """Degrees."""
    theta_out: float
    """Degrees, signed."""
    what: str
    """"f" at the wavelength nearest to 600 nm, 1/sr, or "m", 1/um."""
    value: float
    u: float
    """Standard error from the spread of the patches."""
    changes: dict[str, float | None]
    """By what was changed: relative change of f, change of m in 1/um; None where that could not be computed."""

    def converged(self, change: str) -> bool | None:
        """Whether `change` leaves the figure as it is."""
        found = self.changes[change]
        return (
            None if found is None or isnan(found) else abs(found) < (CONVERGED if self.what == "f" else CONVERGED_SLOPE)
        )


@dataclass(frozen=True)
class Convergence:
    """What the published figures do."""

    figures: tuple[Figure, ...]
    median: dict[str, float | None]
    """Median relative change of f(600 nm) over all directions brighter than `LEAST_PART` / pi."""
    p95: dict[str, float | None]
    """Below which 95 of 100 such directions change."""
    patches: int
    """How many were computed again."""


def variants(field: HeightField, times: int, setup: Setup, *, symmetric: bool) -> dict[str, FloatArray | None]:
    """BRDF [points, wavelengths] of a patch that was refined `times`, computed anew with each change; 1/sr.

    None where the patch has too many points or is too small for that. Raises `UnfitTopography` where heights are
    missing, and otherwise as `averaged_brdf`.
    """
    wider = replace(setup, coherence=replace(setup.coherence, s_um=2 * setup.coherence.s_um))
    finest = 2 * times

    def at(made: HeightField, how: Setup = setup) -> FloatArray | None:
        try:
            return seen(average(made, how), how, symmetric=symmetric)
        except UnfitTopography:  # of a map that is not periodic the window leaves nothing
            return None

    fine = refined(field, times)
    small = field.heights_um.size * finest**2 <= MOST_POINTS
    return {
        HALF_STEP: at(refined(field, finest)) if small else None,
        TWICE_STEP: at(every_second(fine)),
        COARSER: at(refined(every_second(field), finest)),
        WINDOW: at(fine, wider),
    }


def convergence(
    setup: Setup, brdf: FloatArray, studied: list[dict[str, FloatArray | None]], result: Computed
) -> Convergence:
    """Of the mean of `brdf` [patches, points, wavelengths], of which the first few were `studied`.

    `result` is what is published of them. Raises as `analysis.fits.local_fit.local_fit`.
    """
    part = brdf[: len(studied)].mean(axis=0)
    pairs: dict[str, tuple[FloatArray, FloatArray] | None] = {}
    for name in studied[0]:
        known = [values for values in (patch[name] for patch in studied) if values is not None]
        pairs[name] = (part, np.mean(known, axis=0)) if len(known) == len(studied) else None
    pairs[PATCHES] = brdf.mean(axis=0), brdf[::2].mean(axis=0)
    points = _published(setup)
    middle = int(np.argmin(np.abs(setup.wavelengths - LAMBDA_N)))
    local = local_fit(computed_dataset(result), setup.conductor, fresnel=setup.conductor is not None)
    of_f, of_m, median, p95 = {}, {}, {}, {}
    lit = result.brdf[:, middle] > LEAST_PART / np.pi
    for name, pair in pairs.items():
        relative = None if pair is None else _relative(pair[1][:, middle], pair[0][:, middle])
        of_f[name] = None if relative is None else relative[points]
        of_m[name] = None if pair is None else _slopes(setup, pair[1], points) - _slopes(setup, pair[0], points)
        some = None if relative is None or not lit.any() else np.abs(relative[lit])
        median[name], p95[name] = (None if some is None else float(np.quantile(some, q)) for q in (0.5, 0.95))
    u = combined(computed_dataset(result).sources, result.brdf.shape)
    figures = []
    for number, point in enumerate(points):
        where = float(setup.theta_in[point]), float(setup.theta_out[point])
        for what, value, error, changes in (
            ("f", result.brdf[point, middle], u[point, middle], of_f),
            ("m", local.slope[point], local.u_slope[point], of_m),
        ):
            each = {name: None if found is None else float(found[number]) for name, found in changes.items()}
            figures.append(Figure(*where, what, float(value), float(error), each))
    return Convergence(tuple(figures), median, p95, len(studied))


def _published(setup: Setup) -> list[int]:
    """Points nearest to the published directions, each once."""
    found = []
    for angle in _INCIDENT:
        theta_in = setup.theta_in[np.argmin(np.abs(setup.theta_in - angle))]
        here = np.flatnonzero(setup.theta_in == theta_in)
        found += [int(here[np.argmin(np.abs(setup.theta_out[here] - theta_in - off))]) for off in _OFF_MIRROR]
    return list(dict.fromkeys(found))


def _relative(new: FloatArray, old: FloatArray) -> FloatArray:
    """[points] relative change; NaN where there was no light."""
    return np.where(old > 0, new / np.where(old > 0, old, 1.0) - 1, np.nan)


def _slopes(setup: Setup, brdf: FloatArray, points: list[int]) -> FloatArray:
    """[points] m of some spectra, 1/um, all wavelengths of equal relative weight."""
    some = brdf[points]
    none = np.zeros_like(some)
    alike = Computed(
        "",
        setup.theta_in[points],
        setup.theta_out[points],
        setup.wavelengths,
        some,
        none,
        np.maximum(PRECISION * some, DARK),
        0.0,
        {},
    )
    return local_fit(computed_dataset(alike), setup.conductor, fresnel=setup.conductor is not None).slope
