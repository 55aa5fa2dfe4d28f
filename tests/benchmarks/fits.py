"""What the fast engine gains over lmfit, and what scanning for a start gains over going downhill from one.

    python -m tests.benchmarks.fits [local] [global] [shift] [plain] [starts]

Without arguments all five tables are printed. Times are processor times, the shortest of a few runs in this process:
their ratios are to be read; data are drawn from known models with 1 % noise.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import lmfit
import numpy as np

from analysis.choices import Engine
from analysis.fits.brdf_problem import from_search, problem, to_search, weighted_residual
from analysis.fits.brdf_start import find_starts
from analysis.fits.global_fit import W_BOUNDS, global_fit, search_slopes, slope_problem
from analysis.fits.least_squares import SumOfSquares, minimise
from analysis.fits.local_fit import local_exponents, local_fit
from analysis.fits.loew import LoewData, loew_data
from analysis.reflectance.directions import in_plane, round_aperture
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.microfacet import Form, View
from analysis.reflectance.models import normalised_fresnel
from analysis.results import LocalFit
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource
from tests.benchmarks.figures import tell
from tests.measured_lobe import measured_cook_torrance

NOISE = 0.01

Result = TypeVar("Result")


def fastest(run: Callable[[], Result], times: int = 3) -> tuple[float, Result]:
    """Shortest processor time of a few runs, s, and the result."""
    best, result = np.inf, run()
    for _ in range(times):
        begin = time.process_time()
        result = run()
        best = min(best, time.process_time() - begin)
    return best, result


def dataset(
    theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, clean: FloatArray, aperture: float = 1.0
) -> Dataset:
    """`clean` spectra with 1 % noise."""
    u = NOISE * clean + 1e-9
    return Dataset(
        sample="made",
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=wavelengths,
        brdf=clean + u * np.random.default_rng(1).normal(size=clean.shape),
        sources=(ErrorSource("random: counts", "random", u, None, False),),
        flags=np.zeros(theta_in.size, dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.01,
        aperture=aperture,
    )


def directions(step: float) -> tuple[FloatArray, FloatArray]:
    """A scan of 9 incident angles, theta_out every `step` degrees, without the blocked ones."""
    pairs = [(i, o) for i in np.arange(0.0, 81, 10) for o in np.arange(-85.0, 85.1, step) if abs(i + o) >= 5]
    theta_in, theta_out = np.array(pairs).T
    return theta_in, theta_out


def local() -> None:
    """Eq. 2 for all spectra at once, against lmfit spectrum by spectrum."""
    random, points = np.random.default_rng(0), 300
    wavelengths = np.linspace(380, 995, 401)
    theta_in = np.repeat(np.arange(0.0, 90, 30), points // 3)
    n, k = load_conductor().index(np.append(wavelengths, 600.0))
    fresnel = fresnel_conductor(np.cos(np.radians(theta_in))[:, None], n, k)
    slope, exponent = random.uniform(-2, 2, (points, 1)), random.uniform(0.5, 2, (points, 1))
    clean = (1 + slope * (wavelengths - 600) * 1e-3) * (fresnel[:, :-1] / fresnel[:, -1:]) ** exponent
    made = dataset(theta_in, np.linspace(-80, 80, points), wavelengths, clean)
    fast, of_fast = fastest(lambda: local_fit(made), 10)
    alone, _ = fastest(lambda: local_exponents(made), 10)
    plain, _ = fastest(lambda: by_plain_lmfit(made), 2)
    difference = np.abs(of_fast.slope - local_fit(made, engine="lmfit").slope).max()
    print(f"local fit, {points} spectra x {wavelengths.size} wavelengths; lmfit as it comes, spectrum by spectrum")
    tell("local fit: time of lmfit over that of all spectra at once", plain / alone, f"({alone * 1e3:.1f} ms)", ">= 50")
    tell("the same with u(m) by all errors and r2", plain / fast, f"({fast * 1e3:.1f} ms)")
    tell("local fit: largest difference of slopes from lmfit's at its tightest", difference, "1/um", "<= 1e-8")


def by_plain_lmfit(made: Dataset) -> FloatArray:
    """Slopes of all spectra, 1/um, by `lmfit.minimize` with everything as it comes."""
    x = (made.wavelengths - 600.0) * 1e-3
    fresnel = normalised_fresnel(made.theta_in, made.wavelengths, load_conductor())
    slopes = np.empty(made.theta_in.size)
    for i, (values, u, ratio) in enumerate(zip(made.brdf, made.u_counts, fresnel, strict=True)):

        def residual(
            p: lmfit.Parameters, values: FloatArray = values, u: FloatArray = u, ratio: FloatArray = ratio
        ) -> FloatArray:
            model = p["a"].value * (1 + p["m"].value * x) * ratio ** p["p"].value
            return np.asarray((model - values) / u)

        slopes[i] = lmfit.minimize(residual, lmfit.create_params(a=1.0, m=0.0, p=1.0)).params["m"].value
    return slopes


SLOPES = {
    "bench sample 1": (1.6, 2.3, 0.0),
    "bench sample 3": (1.35, 3.0, 0.1),
    "bench sample 5": (0.9, 4.5, -0.1),
    "fast and weak": (0.2, 9.0, 0.3),
    "slow, nearly a parabola": (1.0, 0.6, -0.8),
    "negative": (-1.1, 1.7, 0.5),
    "scattered by 0.3 /um": (1.2, 3.4, 0.1),
    "pure noise": (0.0, 1.0, 0.0),
}


def slopes_of(name: str) -> tuple[Dataset, LocalFit]:
    """A dataset with the slopes of a material, 270 directions x 67 wavelengths, and its local fit."""
    h, w, t_y = SLOPES[name]
    random = np.random.default_rng(2)
    theta_in, theta_out = directions(5.0)
    wavelengths = np.arange(382.0, 998.0, 9.2)
    scatter = {"scattered by 0.3 /um": 0.3, "pure noise": 0.3}.get(name, 0.0)
    slope = (
        h * np.cos(w * np.radians(np.abs(theta_out - theta_in) / 2)) + t_y + scatter * random.normal(size=theta_in.size)
    )
    n, k = load_conductor().index(np.append(wavelengths, 600.0))
    fresnel = fresnel_conductor(np.cos(np.radians(theta_in))[:, None], n, k)
    clean = np.maximum(1 + slope[:, None] * (wavelengths - 600) * 1e-3, 0.05) * fresnel[:, :-1] / fresnel[:, -1:]
    made = dataset(theta_in, theta_out, wavelengths, clean)
    return made, local_fit(made)


def cosine() -> None:
    """The best of 200 random starts of each engine against the grid with its refinement."""
    print("global fit (h, w, t_y), 200 random starts: chi-square over that of the grid, share that reaches the lowest")
    print(f"  {'slopes':26}{'grid':>8}{'fit':>9}{'best of fast':>14}{'share':>7}{'best of lmfit':>15}{'share':>7}")
    best, slowest = 0, 0.0
    for name in SLOPES:
        made, found = slopes_of(name)
        milliseconds, fit = fastest(partial(global_fit, made, found))
        used = found.reliable
        seen = in_plane(made.theta_in[used], made.theta_out[used])
        posed = slope_problem("global", found.slope[used], found.u_slope[used] ** -2, seen)
        random = np.random.default_rng(3)
        starts = np.column_stack(
            [random.uniform(-3, 3, 200), random.uniform(*W_BOUNDS, 200), random.uniform(-2, 2, 200)]
        )
        cells = []
        for engine in ("fast", "lmfit"):
            costs = np.array([minimise(posed, start, np.ones(3, dtype=bool), engine).cost for start in starts])
            cells.append((costs.min() / fit.cost_value, np.mean(costs <= fit.cost_value * (1 + 1e-6))))
        weight = found.u_slope[used] ** -2
        search = partial(search_slopes, "global", found.slope[used], weight, seen, "fast")
        grid, _ = fastest(search)
        print(
            f"  {name:26}{grid * 1e3:5.1f} ms{milliseconds * 1e3:6.0f} ms"
            + "".join(f"{ratio:{width}.9f}{share:7.0%}" for (ratio, share), width in zip(cells, (14, 15), strict=True))
        )
        best += name != "pure noise" and all(ratio >= 1 - 1e-6 for ratio, _ in cells)
        slowest = max(slowest, milliseconds * 1e3)
    sound = len(SLOPES) - 1
    tell("global fit: materials where no random start of either engine ends lower", best, f"of {sound}", f"= {sound}")
    tell("global fit: slowest", slowest, "ms", "<= 20")


USUAL = (0.1, 0.3, 0.5)
"""Roughnesses from which a user would start."""

ALPHAS = (0.003, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.364, 0.6)


def rough(alpha: float, step: float, wavelengths: FloatArray, aperture: float = 1.0) -> LoewData:
    """Cook-Torrance with shift (h = 1.2 1/um, w = 3.4) through an `aperture` in degrees."""
    theta_in, theta_out = directions(step)
    theta_out = np.where(np.abs(theta_out - theta_in) < step / 2, theta_in, theta_out)  # the mirror direction itself
    if aperture == 0:
        rule = round_aperture(0.0, 1, 1)
    else:
        rule = round_aperture(aperture, 16, 40) if alpha < 0.05 else round_aperture(aperture)
    parts = [
        measured_cook_torrance(theta_in[some], theta_out[some], wavelengths, alpha, load_conductor(), rule, 1.2, 3.4)
        for some in np.array_split(np.arange(theta_in.size), 40)
    ]
    return loew_data(dataset(theta_in, theta_out, wavelengths, np.concatenate(parts), aperture))


def shift() -> None:
    """Cold start with scans against one lmfit run from alpha = 0.3, h = 0.5, w = 2."""
    form = Form(load_conductor(), "cosine")
    wavelengths = np.linspace(380, 780, 81)
    print("Cook-Torrance with shift, 81 wavelengths, h = 1.2 1/um, w = 3.4; cold start")
    print(f"  {'alpha':>7}{'points':>7}{'scans + fast':>24}{'one lmfit run':>24}{'time ratio':>12}")
    everything = np.ones(3, dtype=bool)
    ratios, ours_found, theirs_found = [], 0, 0
    for alpha in ALPHAS:
        data = rough(alpha, 0.65, wavelengths)

        def scanned(data: LoewData = data) -> FloatArray:
            starts = find_starts(form, data)
            end = minimise(problem(starts.view, data), to_search(starts.parameters[0]), everything, "fast")
            return from_search(end.parameters)

        view = find_starts(form, data).view

        def plain(data: LoewData = data, view: View = view) -> FloatArray:
            return by_plain_descent(view, data)

        ours, found = fastest(scanned, 2)
        theirs, other = fastest(plain, 2)
        cells = []
        for seconds, parameters in ((ours, found), (theirs, other)):
            good = abs(parameters[0] / alpha - 1) < 0.02
            cells.append(f"{parameters[0]:10.5f} {'found ' if good else 'MISSED'}{seconds * 1e3:5.0f} ms")
        print(f"  {alpha:7g}{data.theta_in.size:7d}{cells[0]:>24}{cells[1]:>24}{ours / theirs:12.2f}")
        ratios.append(ours / theirs)
        ours_found += "found" in cells[0]
        theirs_found += "found" in cells[1]
    count = len(ALPHAS)
    tell("Cook-Torrance with shift, cold start: roughnesses found", ours_found, f"of {count}", f"= {count}")
    tell("the same by one plain lmfit run", theirs_found, f"of {count}")
    tell("time over that of one plain lmfit run, largest", max(ratios), aim="<= 1.5")


def by_plain_descent(view: View, data: LoewData, start: float = 0.3, bounded: bool = True) -> FloatArray:
    """alpha, h and w of one `lmfit.minimize` from alpha = `start`, h = 0.5 1/um and w = 2, with everything as it comes.

    alpha is varied as it is, between 0.001 and 1 or without bounds.
    """

    def residual(p: lmfit.Parameters) -> FloatArray:
        return weighted_residual(view, data, np.array([p[name].value for name in ("alpha", "h", "w")]))[0].ravel()

    wanted = lmfit.Parameters()
    wanted.add("alpha", value=start, **({"min": 1e-3, "max": 1.0} if bounded else {}))
    wanted.add("h", value=0.5)
    wanted.add("w", value=2.0, min=0.0, max=12.0)
    best = lmfit.minimize(residual, wanted, nan_policy="omit").params
    return np.array([abs(best["alpha"].value), best["h"].value, best["w"].value])


def plain() -> None:
    """What one lmfit run misses, by where it starts; the model knows the aperture that the data came through."""
    form, wavelengths = Form(load_conductor(), "cosine"), np.linspace(380, 780, 9)
    print(
        "One lmfit run with alpha as it is, from h = 0.5 1/um, w = 2 and the alpha of the column: alpha where it missed"
    )
    ways = [(aperture, bounded) for aperture in (1.0, 0.0) for bounded in (True, False)]
    headed = [f"{aperture:g} deg{', 0.001 to 1' if bounded else ', unbounded'}" for aperture, bounded in ways]
    print(f"  {'':7}" + "".join(f"{name:>30}" for name in headed))
    print(f"  {'alpha':>7}" + "".join(f"{start:>10g}" for _ in ways for start in USUAL) + f"{'scans':>8}")
    missed = np.zeros((len(ways), len(USUAL)), dtype=int)
    for alpha in ALPHAS:
        cells, scanned = "", True
        for i, (aperture, bounded) in enumerate(ways):
            data = rough(alpha, 0.65, wavelengths, aperture)
            found = find_starts(form, data)
            scanned &= abs(found.parameters[0][0] / alpha - 1) < 0.02
            for j, start in enumerate(USUAL):
                value = by_plain_descent(found.view, data, start, bounded)[0]
                good = abs(value / alpha - 1) < 0.02
                missed[i, j] += not good
                cells += f"{'found' if good else f'{value:.3g}':>10}"
        print(f"  {alpha:7g}{cells}{'found' if scanned else 'MISSED':>8}", flush=True)
    print(f"  {'missed':>7}" + "".join(f"{count:>10}" for count in missed.ravel()) + "\n")
    tell("plain lmfit runs from usual starts that miss the roughness", missed.sum(), f"of {missed.size * len(ALPHAS)}")


def starts() -> None:
    """Share of random starts that reach the lowest cost, by engine, beside the scans."""
    form, count = Form(load_conductor(), "cosine"), 40
    wavelengths = np.linspace(380, 780, 11)
    print(f"Cook-Torrance with shift, {count} random starts (alpha 0.002 to 1, |h| < 3 1/um, w < 12)")
    print(f"  {'alpha':>7}{'scans reach it':>16}{'fast':>8}{'lmfit':>8}")
    alphas, reach = (0.01, 0.05, 0.18, 0.364), 0
    by_engine = []
    for alpha in alphas:
        data = rough(alpha, 4.0, wavelengths)
        found = find_starts(form, data)
        posed, everything = problem(found.view, data), np.ones(3, dtype=bool)
        scanned = minimise(posed, to_search(found.parameters[0]), everything, "fast").cost
        random = np.random.default_rng(4)
        cold = np.column_stack(
            [np.log(0.002) * random.uniform(0, 1, count), random.uniform(-3, 3, count), random.uniform(0, 12, count)]
        )
        ends = {engine: descents(posed, cold, engine) for engine in ("fast", "lmfit")}
        lowest = min(scanned, *(costs.min() for costs in ends.values()))
        shares = [np.mean(costs <= lowest * (1 + 1e-4)) for costs in ends.values()]
        reached = "yes" if scanned <= lowest * (1 + 1e-4) else "NO"
        print(f"  {alpha:7g}{reached:>16}" + "".join(f"{share:8.0%}" for share in shares))
        by_engine.append(shares)
        reach += reached == "yes"
    tell("scans that reach the lowest cost of all random starts", reach, f"of {len(alphas)}", f"= {len(alphas)}")
    for engine, shares in zip(("fast", "lmfit"), np.transpose(by_engine), strict=True):
        span = f"% ({100 * shares.min():.0f} to {100 * shares.max():.0f})"
        tell(f"random starts that reach it, engine {engine}, mean", 100 * shares.mean(), span)


def descents(posed: SumOfSquares, cold: FloatArray, engine: Engine) -> FloatArray:
    """Costs at the ends of all descents."""
    return np.array([minimise(posed, start, np.ones(3, dtype=bool), engine).cost for start in cold])


TABLES = {"local": local, "global": cosine, "shift": shift, "plain": plain, "starts": starts}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or TABLES:
        TABLES[wanted]()
