"""What the fast transform gains over summing a height map point by point, and what a speckle-free set of spectra costs.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.waves [sums] [spectra] [sample]

`sums`: the in-plane simulation of the paper's section 5.1, 17 incident and 171 reflected angles and 20 wavelengths on
500 x 500 um at 1 um, against compiled sums over the same map on a sample of the same directions, all on one core.
`spectra`: a converged average over all places of rough Gaussian surfaces of rising slope. `sample`: what
`goniometer simulate waves sample-1` computes, without and with roughness below the wavelength, refined to the pitch it
needs, with its errors and its convergence, in two processes. Times are processor times; that of `sample` is divided by
the two processes, which is the time on two idle cores, and the time that passed stands beside it.
"""

import resource
import sys
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import TypeVar

import numba
import numpy as np

from analysis.reflectance.fresnel import load_conductor
from drivers.arrays import FloatArray
from goniometer.geometry import BLOCKED_HALF_WIDTH
from simulators.choices import Kernel
from simulators.topographies.heights import HeightField
from simulators.waves.convergence import HALF_STEP
from simulators.waves.diffraction import diffraction_integral, seen_through, window
from simulators.waves.sampling import CoarseSampling, refined, sampling
from simulators.waves.scan import Setup, choose_patches
from simulators.waves.simulation import simulate
from simulators.waves.waves import averaged, averaged_brdf, scattering_vectors
from tests.benchmarks.figures import tell

WAVELENGTHS = np.linspace(380.0, 780.0, 20)
INCIDENT, REFLECTED = np.linspace(0.0, 80.0, 17), np.linspace(-85.0, 85.0, 171)

Result = TypeVar("Result")


def fastest(run: Callable[[], Result], times: int = 3) -> tuple[float, Result]:
    """Shortest processor time of a few runs, s, and the result."""
    best, result = np.inf, run()
    for _ in range(times):
        begin = time.process_time()
        result = run()
        best = min(best, time.process_time() - begin)
    return best, result


def directions() -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out [points], degrees."""
    theta_in, theta_out = np.meshgrid(INCIDENT, REFLECTED, indexing="ij")
    return theta_in.ravel(), theta_out.ravel()


def surface(count: int, pitch_um: float, rms_um: float, length_um: float) -> HeightField:
    """A periodic Gaussian surface with autocorrelation exp(-r^2 / length^2)."""
    frequency = 2 * np.pi * np.fft.fftfreq(count, pitch_um)
    filtered = np.exp(-(frequency**2 + frequency[:, None] ** 2) * length_um**2 / 8)
    noise = np.random.default_rng(1).normal(size=(count, count))
    heights = np.fft.ifft2(np.fft.fft2(noise) * filtered).real
    return HeightField(heights * rms_um / heights.std(), pitch_um, periodic=True)


@numba.njit(fastmath=True)
def double_sum(x, h, w, kx, kz):
    """I of each target, in double precision."""
    out = np.empty(kx.size, dtype=np.complex128)
    for t in range(kx.size):
        re, im = 0.0, 0.0
        for j in range(x.size):
            phase = kx[t] * x[j] + kz[t] * h[j]
            re += w[j] * np.cos(phase)
            im += w[j] * np.sin(phase)
        out[t] = complex(re, im)
    return out


@numba.njit(fastmath=True)
def single_sum(x, h, w, kx, kz):
    """The same in single precision, phases reduced to one turn and sine and cosine as polynomials of it, row by row.

    Everything in the inner loop is arithmetic, so the compiler makes vectors of it.
    """
    turn = np.float32(1 / (2 * np.pi))
    out = np.empty(kx.size, dtype=np.complex128)
    for t in range(kx.size):
        along, up = np.float32(kx[t]) * turn, np.float32(kz[t]) * turn
        total_re, total_im = 0.0, 0.0
        for row in range(h.shape[0]):
            re, im = np.float32(0), np.float32(0)
            for j in range(x.size):
                phase = along * x[j] + up * h[row, j]
                quarters = np.float32(4) * (phase - np.floor(phase + np.float32(0.5)))
                # sin and cos of a quarter of pi times `half`, then the angle is doubled twice
                half = quarters * np.float32(np.pi / 8)
                square = half * half
                sine = half * (
                    np.float32(1)
                    + square * (np.float32(-1 / 6) + square * (np.float32(1 / 120) - square / np.float32(5040)))
                )
                cosine = np.float32(1) + square * (
                    np.float32(-0.5) + square * (np.float32(1 / 24) - square * np.float32(1 / 720))
                )
                for _ in range(2):
                    sine, cosine = np.float32(2) * sine * cosine, np.float32(1) - np.float32(2) * sine * sine
                re += w[row, j] * cosine
                im += w[row, j] * sine
            total_re += float(re)
            total_im += float(im)
        out[t] = complex(total_re, total_im)
    return out


def sums() -> None:
    """Prints the table of the sums."""
    field = surface(500, 1.0, 2.0, 20.0)
    kx, kz = (each.ravel() for each in scattering_vectors(*directions(), WAVELENGTHS))
    amplitude = window(field, 80.0)
    took, fast = fastest(lambda: diffraction_integral(field, amplitude, kx, kz), 10)
    x = np.arange(500) - 249.5
    some = np.random.default_rng(2).choice(kx.size, 300, replace=False)
    whole = np.broadcast_to(x, (500, 500)).ravel(), field.heights_um.ravel(), amplitude.ravel()
    single = x.astype(np.float32), field.heights_um.astype(np.float32), amplitude.astype(np.float32)
    print(f"{kx.size} wave vectors, {field.heights_um.size} points; sums on {some.size} of the former, scaled up")
    print(f"{'':26}{'time s':>10}{'ratio':>8}{'largest error':>15}")
    print(f"{'fast transform':26}{took:10.2f}{1:8.0f}", end="")
    exact = double_sum(*whole, kx[some], kz[some])
    print(f"{np.abs(fast[some] - exact).max() / np.abs(exact).max():15.1e}")
    sums_by_hand = ("double precision", double_sum, whole), ("single precision", single_sum, single)
    for name, run, (places, heights, weights) in sums_by_hand:
        took_some, found = fastest(partial(run, places, heights, weights, kx[some], kz[some]), 1)
        scaled = took_some * kx.size / some.size
        error = np.abs(found - exact).max() / np.abs(exact).max()
        print(f"{name:26}{scaled:10.1f}{scaled / took:8.0f}{error:15.1e}")
        aim = ">= 500" if name == "double precision" else ">= 30"
        tell(f"time of sums in {name} over that of the fast transform", scaled / took, f"({took:.2f} s)", aim)
    error = np.abs(fast[some] - exact).max() / np.abs(exact).max()
    tell("largest error of the fast transform", error, aim="<= 1e-6")


def spectra() -> None:
    """Prints the table of the spectra."""
    theta_in, theta_out = directions()
    coherence, aluminium = seen_through(1.0), load_conductor()
    print("\nspectra of 2907 directions and 20 wavelengths, averaged over a map of 500 x 500 um")
    print(f"{'rms um':>7}{'slope rms':>11}{'pitch um':>10}{'average s':>11}{'spectra s':>11}{'half the step':>15}")
    for rms_um in (0.3, 1.0, 2.0):
        coarse = surface(500, 1.0, rms_um, 20.0)
        vectors = scattering_vectors(theta_in, theta_out, WAVELENGTHS)
        times = sampling(coarse, *vectors, float(coherence.size(WAVELENGTHS).min())).times
        found = []
        for finer in (times, 2 * times):
            field = refined(coarse, finer)
            begin = time.process_time()
            mean = averaged(field, theta_in, theta_out, WAVELENGTHS, coherence)
            took = time.process_time() - begin
            took_spectra, computed = fastest(
                partial(averaged_brdf, mean, theta_in, theta_out, WAVELENGTHS, conductor=aluminium), 1
            )
            found.append((took, took_spectra, computed.brdf))
        slope = float(np.diff(coarse.heights_um, axis=1).std())
        lit = found[1][2] > 1e-3
        change = float(np.abs(found[0][2][lit] / found[1][2][lit] - 1).max())
        took, took_spectra, _ = found[0]
        print(
            f"{rms_um:7.1f}{slope:11.3f}{1 / times:10.3f}{took:11.1f}{took_spectra:11.2f}{100 * change:13.3f} %",
            flush=True,
        )
        tell(f"rms {rms_um:g} um: largest change of a spectrum at half the step", 100 * change, "%", "< 1")
    print("'half the step': the largest change of any spectrum above 1e-3 /sr when the pitch is halved")


def sample() -> None:
    """Prints the table of Sample 1."""
    theta_in, theta_out = (each.ravel() for each in np.meshgrid(np.arange(0.0, 81, 10), REFLECTED, indexing="ij"))
    free = np.abs(theta_in + theta_out) >= BLOCKED_HALF_WIDTH
    wavelengths = np.arange(400.0, 991, 10)
    setup = Setup(
        theta_in[free], theta_out[free], wavelengths, seen_through(1.0), Kernel.HARVEY_SHACK, load_conductor()
    )
    print("\nSample 1 in two processes: 1455 directions, 60 wavelengths, 12 patches of 256 um, two of them studied")
    print(f"{'':12}{'pitch um':>9}{'s, idle':>9}{'s passed':>9}{'error f':>9}{'error m':>9}", end="")
    print("   change of f(600 nm): median and 95 of 100, %")
    for name, micro in (("smooth", False), ("40 nm micro", True)):
        begin, spent = time.perf_counter(), _children()
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
            found = simulate(choose_patches("sample-1", None, None, 1, 12, micro=micro), setup, executor)
        passed, spent = time.perf_counter() - begin, _children() - spent
        computed, study = found.computed, found.convergence
        lit = computed.brdf[:, 20] > 1e-3
        error_f = float(np.median((computed.u_level / computed.brdf)[lit, 20]))
        error_m = float(np.median([each.u for each in study.figures if each.what == "m"]))
        print(
            f"{name:12}{found.sampling.pitch_um:9.3f}{spent / 2:9.1f}{passed:9.1f}{100 * error_f:8.1f} %{error_m:9.3f}",
            flush=True,
        )
        because = "the micro-roughness asks for a finer pitch" if micro else ""
        tell(
            f"Sample 1, {name}: all spectra, on two idle cores",
            spent / 2,
            f"s ({passed:.0f} s passed)",
            "< 60",
            because,
        )
        for change, median in study.median.items():
            if median is not None:
                aim = "< 1" if change == HALF_STEP else ""
                tell(f"Sample 1, {name}: median change of f at {change}", 100 * median, "%", aim)
            p95 = study.p95[change]
            shown = "not computed" if median is None or p95 is None else f"{100 * median:10.2g}{100 * p95:10.2g}"
            print(f"{'':57}   {change:20}{shown}")


def _children() -> float:
    """Processor time of all processes that have ended, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    warnings.simplefilter("error", CoarseSampling)
    tables = {"sums": sums, "spectra": spectra, "sample": sample}
    for name in sys.argv[1:] or tables:
        tables[name]()
