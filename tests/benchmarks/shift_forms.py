"""Which form of the shift's slope fits what.

    python -m tests.benchmarks.shift_forms

Truths are slopes of two components whose shares are Gaussian or Fermi functions of the angles, and the paper's cosine;
none is of the form of `two_component_slope`. A row shows what the best fit of each form leaves, as a share of the
slopes' standard deviation, from 24 random starts. Free numbers of a form in brackets.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from analysis.reflectance.directions import in_plane
from analysis.reflectance.models import cosine_slope
from analysis.reflectance.two_component import mixed_slope, two_component_slope
from drivers.arrays import FloatArray
from tests.benchmarks.figures import tell

_GRID = np.meshgrid(np.arange(0.0, 81, 10), np.arange(-80.0, 81, 4), indexing="ij")
_SEEN = np.abs(_GRID[0] + _GRID[1]) >= 5
_IN, _OUT = _GRID[0][_SEEN], _GRID[1][_SEEN]
_DIRECTIONS = in_plane(_IN, _OUT)
_TO_MIRROR, _TO_LAMP = np.abs(_OUT - _IN) / 2, np.abs(_OUT + _IN) / 2


def _lobes(strength: float, single: float, multiple: float) -> FloatArray:
    """Share of multiple reflections of two Gaussian lobes, their widths in degrees."""
    ratio = strength * np.exp(_TO_MIRROR**2 / (2 * single**2) - _TO_LAMP**2 / (2 * multiple**2))
    return np.asarray(ratio / (1 + ratio))


def _fermi(centre: float, width: float) -> FloatArray:
    return np.asarray(1 / (1 + np.exp(-(_TO_MIRROR - centre) / width)))


TRUTHS = {
    "cosine, w 2.3": cosine_slope(_TO_MIRROR, 1.6, 2.3),
    "cosine, w 4.5": cosine_slope(_TO_MIRROR, 0.9, 4.5),
    "step at 12 deg": mixed_slope(_fermi(12, 2), 0.9, -0.4),
    "step at 25 deg": mixed_slope(_fermi(25, 3), 0.9, -0.7),
    "metal, rough": mixed_slope(_lobes(0.15, 20, 90), 1.2, -0.8),
    "metal, smooth": mixed_slope(_lobes(0.02, 7, 90), 0.9, -0.5),
    "cosine by share": mixed_slope(_lobes(0.1, 18, 60), cosine_slope(_TO_MIRROR, 1.3, 3.0), -0.8),
    "SRS-02 grit 60": mixed_slope(_lobes(3, 35, 20), 0.5, -0.8),
    "SRS-02 grit 1000": mixed_slope(_lobes(1, 20, 30), 0.7, -0.4),
    "SRS-02 grit 2500": mixed_slope(_lobes(0.3, 20, 40), 0.6, -0.4),
}

_W, _KAPPA, _LOG_Q, _THRESHOLD = (0.3, 9.0), (-0.5, 3.0), (-6.0, 8.0), (-1.0, 1.0)

Form = tuple[Callable[..., FloatArray], list[tuple[float, float]]]

# all are linear in h and t_y, which are solved for; the others are searched between these bounds
FORMS: dict[str, Form] = {
    "Eq. 5 (3)": (lambda w: cosine_slope(_TO_MIRROR, 1.0, w), [_W]),
    "no threshold (5)": (
        lambda w, kappa, q: two_component_slope(_DIRECTIONS, 1.0, w, 0.0, kappa, np.exp(q)),
        [_W, _KAPPA, _LOG_Q],
    ),
    "no kappa (5)": (
        lambda w, q, threshold: two_component_slope(_DIRECTIONS, 1.0, w, 0.0, 0.0, np.exp(q), threshold),
        [_W, _LOG_Q, _THRESHOLD],
    ),
    "two components (6)": (
        lambda w, kappa, q, threshold: two_component_slope(_DIRECTIONS, 1.0, w, 0.0, kappa, np.exp(q), threshold),
        [_W, _KAPPA, _LOG_Q, _THRESHOLD],
    ),
}


def missed(truth: FloatArray, form: Form, starts: int = 24) -> float:
    """Share of the standard deviation of `truth` that the best fit of `form` leaves."""
    shape, bounds = form
    low, high = np.array(bounds).T
    rng = np.random.default_rng(0)

    def residual(parameters: FloatArray) -> FloatArray:
        columns = np.stack([shape(*parameters), np.ones_like(truth)], axis=1)
        return np.asarray(columns @ np.linalg.lstsq(columns, truth, rcond=1e-10)[0] - truth)

    fits = (least_squares(residual, rng.uniform(low, high), bounds=(low, high), max_nfev=60) for _ in range(starts))
    return float(np.sqrt(2 * min(fit.cost for fit in fits) / truth.size) / truth.std())


def main() -> None:
    """Print the table."""
    print(f"{'slopes':18}" + "".join(f"{name:>20}" for name in FORMS))
    left = []
    for name, truth in TRUTHS.items():
        left.append([missed(truth, form) for form in FORMS.values()])
        print(f"{name:18}" + "".join(f"{each:20.4f}" for each in left[-1]), flush=True)
    for form, shares in zip(FORMS, 100 * np.transpose(left), strict=True):
        tell(f"{form}: what is left of the slopes, median", np.median(shares), f"% (at most {shares.max():.1f} %)")


if __name__ == "__main__":
    main()
