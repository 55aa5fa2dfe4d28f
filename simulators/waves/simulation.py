"""A whole simulation by waves: patches, light that rays reflect more than once, errors, convergence and lineage."""

from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass
from math import degrees, pi, sqrt
from typing import Any

import numpy as np

from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import FloatArray
from simulators.computed import Computed
from simulators.waves.convergence import STUDIED, Convergence, convergence, variants
from simulators.waves.multiple_reflection import (
    Multiple,
    combined,
    kz_reach,
    mean_of,
    multiply_reflected,
    shift_of_multiple,
)
from simulators.waves.sampling import Sampling
from simulators.waves.scan import Make, Patches, Setup, average, fine_enough, seen, spread

Told = Callable[[int, int], None]
"""Is told how many parts of the work are done, and of how many."""


@dataclass(frozen=True)
class MultiplePart:
    """What was added for light that is reflected more than once."""

    theta_in: FloatArray
    """[incident angles] degrees, ascending."""
    again: FloatArray
    """[incident angles, wavelengths] share of the light that meets the surface again, by waves."""
    again_by_rays: FloatArray
    """[incident angles] the same by rays."""
    slope: FloatArray
    """[incident angles] m_2, the slope of its shift, 1/um."""
    derived: bool
    """Whether the slope follows from `again`; else it was given."""
    brdf: FloatArray
    """[points, wavelengths] the part itself, mean over the patches, 1/sr."""
    lost: float
    """Largest share of the rays that left a finite patch through its side."""

    def at_600(self, wavelengths: FloatArray) -> FloatArray:
        """[incident angles] `again` at the one of `wavelengths` that is nearest to 600 nm."""
        return np.asarray(self.again[:, np.argmin(np.abs(wavelengths - LAMBDA_N))])


@dataclass(frozen=True)
class WaveSimulation:
    """The result."""

    computed: Computed
    convergence: Convergence
    sampling: Sampling
    """Of the patch that is sampled worst."""
    multiple: MultiplePart | None


@dataclass(frozen=True)
class _Patch:
    """One patch, computed."""

    brdf: FloatArray
    times: int
    sampling: Sampling
    multiple: Multiple | None


def simulate(
    patches: Patches,
    setup: Setup,
    executor: Executor,
    told: Told = lambda done, total: None,
    multiple_seed: int | None = None,
    multiple_shift: float | None = None,
) -> WaveSimulation:
    """The BRDF of the mean of `patches`, as a dataset-to-be, with its convergence.

    With a `multiple_seed`, light that is reflected more than once is added from rays of this seed, and `multiple_shift`
    is the slope of its shift in 1/um, by default that of `simulators.waves.multiple_reflection`. Raises
    `UnfitTopography`, `InputError` for fewer than four patches or directions at the horizon, `OutOfRange` beyond the
    conductor's table and `FitError` where no spectrum has a slope.
    """
    count = len(patches.make)
    seeds = [None if multiple_seed is None else multiple_seed + i for i in range(count)]
    tasks: list[Future[_Patch]] = [
        executor.submit(_patch, make, smooth, setup, seed, patches.symmetric)
        for make, smooth, seed in zip(patches.make, patches.smooth, seeds, strict=True)
    ]
    studies: list[Future[dict[str, FloatArray | None]]] = [
        executor.submit(_study, make, setup, patches.symmetric) for make in patches.make[:STUDIED]
    ]
    parts: list[Future[Any]] = [*tasks, *studies]
    try:
        for done, part in enumerate(as_completed(parts), start=1):
            part.result()
            told(done, len(parts))
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    found = [task.result() for task in tasks]
    waves = np.stack([patch.brdf for patch in found])
    multiple, brdf = None, waves
    if multiple_seed is not None:
        multiple, brdf = _with_multiple(setup, waves, found, multiple_shift)
    known = spread(brdf, setup.wavelengths)
    worst = max((patch.sampling for patch in found), key=lambda each: each.pitch_um / each.needed_um)
    lineage = _lineage(patches, setup, max(patch.times for patch in found), worst, multiple)
    computed = Computed(
        f"{patches.name} (waves)",
        setup.theta_in,
        setup.theta_out,
        setup.wavelengths,
        known.mean,
        known.u_level,
        known.u_spectral,
        equivalent_aperture(setup.coherence.s_um),
        lineage,
        known.u_tilt,
    )
    studied = convergence(setup, waves, [study.result() for study in studies], computed)
    return WaveSimulation(computed, studied, worst, multiple)


def equivalent_aperture(s_um: float) -> float:
    """Full angle in degrees of the detector that sees as a window `s_um` at 600 nm, see `diffraction.seen_through`.

    >>> from simulators.waves.diffraction import seen_through
    >>> round(equivalent_aperture(seen_through(1.0).s_um), 9)
    1.0
    """
    return 2 * degrees(0.6 / (sqrt(2) * pi * s_um))


def _patch(make: Make, smooth: Make, setup: Setup, seed: int | None, symmetric: bool) -> _Patch:
    fine, times, fineness = fine_enough(make(), setup)
    mean = average(fine, setup, None if seed is None else kz_reach(setup))
    multiple = None if seed is None else multiply_reflected(smooth(), mean, setup, seed)
    return _Patch(seen(mean, setup, symmetric=symmetric), times, fineness, multiple)


def _study(make: Make, setup: Setup, symmetric: bool) -> dict[str, FloatArray | None]:
    field = make()
    _, times, _ = fine_enough(field, setup)
    return variants(field, times, setup, symmetric=symmetric)


def _with_multiple(
    setup: Setup, waves: FloatArray, found: list[_Patch], given: float | None
) -> tuple[MultiplePart, FloatArray]:
    """What is added, and [patches, points, wavelengths] with it.

    Every patch has its own light of higher orders; what leaves after one reflection, and the shift, is that of all.
    """
    each = [patch.multiple for patch in found if patch.multiple is not None]
    mean = mean_of(each)
    angles = np.unique(setup.theta_in)
    slope = shift_of_multiple(mean.again, setup.wavelengths) if given is None else np.full(angles.size, given)
    at_points = slope[np.searchsorted(angles, setup.theta_in)]
    whole = [
        combined(wave, mean.leaves, of_patch.brdf, at_points, setup.wavelengths)
        for wave, of_patch in zip(waves, each, strict=True)
    ]
    added = combined(np.zeros_like(mean.brdf), mean.leaves, mean.brdf, at_points, setup.wavelengths)
    lost = max(patch.lost for patch in each)
    part = MultiplePart(angles, mean.again, mean.again_by_rays, slope, given is None, added, lost)
    return part, np.stack(whole)


def _lineage(
    patches: Patches, setup: Setup, times: int, worst: Sampling, multiple: MultiplePart | None
) -> dict[str, object]:
    """How it was made."""
    found: dict[str, object] = {
        "simulated": f"waves on {patches.name}",
        "surface": patches.origin,
        "patches": len(patches.make),
        "kernel": setup.kernel.value,
        "conductor": None if setup.conductor is None else setup.conductor.name,
        "coherence_um_at_600_nm": setup.coherence.s_um,
        "refined": times,
        "sampling": worst.message,
    }
    if multiple is None:
        return found | {"multiple_reflection": "none"}
    how = "of the energy balance" if multiple.derived else "as given"
    return found | {
        "multiple_reflection": f"by rays, with a shift whose slope is {how}",
        "multiple_shift_per_um": multiple.slope.tolist(),
    }
