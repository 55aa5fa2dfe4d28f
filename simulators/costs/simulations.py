"""What simulations cost and how right they are: rays by their number, waves by window, area, precision, wavelengths."""

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.tradeoff import Axis, Candidate, Chart, Use, race
from drivers.arrays import FloatArray
from simulators.rays.rays import VirtualScan, virtual_scan
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import (
    PRECISION,
    Coherence,
    diffraction_integral,
    direct_integral,
    seen_through,
    window,
)
from simulators.waves.sampling import CoarseSampling
from simulators.waves.waves import averaged, averaged_brdf, patch_brdf, scattering_vectors

THETA_IN = 40.0
"""Incident angle of all simulations of a chart, degrees."""
RAYS = (1_000, 3_000, 10_000, 30_000, 100_000)
REFERENCE_RAYS = 1_000_000
APERTURE = 4.0
"""Full angle of the virtual detector and of the coherence window, degrees: wide, so that a chart takes a minute."""
PRECISIONS = (1e-2, 1e-4, 1e-6, PRECISION)
SUMMED = 12
"""Directions that are summed point by point; the time for all follows in proportion."""
WINDOWS = (1, 4, 16)
"""Places of the coherence window whose mean is taken."""
NODES = (4, 6, 10, 20)
"""Numbers of wavelengths between which spectra are interpolated."""

_REACH = 4.0
"""Widths s of a window after which nothing is left of it."""

Tell = Callable[[str], None]


def simulation_charts(name: str, field: HeightField, rounds: int, tell: Tell) -> list[Chart]:
    """Charts for the surface `name`, as it is sampled: whether its pitch is fine enough is not asked here.

    Raises `UnfitTopography` where heights are missing.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CoarseSampling)
        return [
            _ray_chart(name, field, rounds, tell),
            _sum_chart(name, field, rounds, tell),
            _wave_chart(name, field, rounds, tell),
        ]


def _ray_chart(name: str, field: HeightField, rounds: int, tell: Tell) -> Chart:
    theta_out = np.arange(-80.0, 81.0, 4.0)
    metal = load_conductor()
    index = metal.index(np.array([600.0]))

    def scan(count: int, number: int) -> VirtualScan:
        return virtual_scan(
            field, THETA_IN, theta_out, lambda c: fresnel_conductor(c, *index), count, seed=number, aperture=APERTURE
        )

    tell("rays: reference")
    right = scan(REFERENCE_RAYS, 10_000).brdf.sum(axis=1)

    def error(result: VirtualScan) -> float:
        return _logarithmic(result.brdf.sum(axis=1), right)

    candidates = [
        Candidate(
            f"{count:,}".replace(",", " "),
            f"{count} rays",
            "rays",
            partial(scan, count),
            use=_command(f"rays {name} --rays {count} --incident {THETA_IN:g} --aperture {APERTURE:g}"),
        )
        for count in RAYS
    ]
    return Chart(
        "simulation-rays",
        "Ray simulation: time against error",
        f"{name}, {_extent(field)}, one incident angle, {theta_out.size} directions, aperture {APERTURE:g}°. Error: "
        f"against {REFERENCE_RAYS} other rays, root mean square.",
        Axis("time", "s"),
        Axis("rms error of ln(1 + cos f)", ""),
        tuple(timed.choice(error) for timed in race(candidates, rounds, tell)),
    )


def _sum_chart(name: str, field: HeightField, rounds: int, tell: Tell) -> Chart:
    theta_out, wavelengths = np.arange(-80.0, 81.0, 4.0), np.array([450.0, 550.0, 650.0])
    kx, kz = scattering_vectors(np.full_like(theta_out, THETA_IN), theta_out, wavelengths)
    amplitude = window(field, seen_through(APERTURE).s_um)
    tell("waves: direct sum")
    some = np.linspace(0, kx.size - 1, SUMMED).astype(int)
    right = np.abs(direct_integral(field, amplitude, kx.ravel()[some], kz.ravel()[some])) ** 2

    def fast(precision: float, _: int) -> FloatArray:
        integral = diffraction_integral(field, amplitude, kx.ravel(), kz.ravel(), precision=precision)
        return np.asarray(np.abs(integral[some]) ** 2)

    def slow(_: int) -> FloatArray:
        # single precision in the phase, as a graphics card would take it
        single = np.float32
        phase = kx.ravel()[some].astype(single)[:, None] * _places(field).astype(single) + kz.ravel()[some].astype(
            single
        )[:, None] * field.heights_um.ravel().astype(single)
        terms = amplitude.ravel().astype(single) * single(field.pitch_um**2)
        return np.asarray((np.abs(np.exp(1j * phase) @ terms) ** 2).astype(float))

    candidates = [
        Candidate(
            f"{precision:.0e}", f"non-uniform transform at {precision:.0e}", "fast transform", partial(fast, precision)
        )
        for precision in PRECISIONS
    ]
    candidates.append(
        Candidate(
            "single precision",
            f"summed point by point in single precision, timed on {SUMMED} of {kx.size} directions",
            "direct sum",
            slow,
            share=SUMMED / kx.size,
        )
    )
    return Chart(
        "simulation-sums",
        "Diffraction of one patch: time against error of the sum",
        f"{name}, {_extent(field)}, {theta_out.size} directions, {wavelengths.size} wavelengths. Error: root mean "
        f"square difference of |I|² from the sum in double precision, over its root mean square.",
        Axis("time", "s"),
        Axis("relative error of |I|²", ""),
        tuple(timed.choice(lambda result: _relative(result, right)) for timed in race(candidates, rounds, tell)),
    )


def _places(field: HeightField) -> FloatArray:
    """x of all points from the middle, um."""
    ny, nx = field.heights_um.shape
    return np.broadcast_to((np.arange(nx) - (nx - 1) / 2) * field.pitch_um, (ny, nx)).ravel()


def _wave_chart(name: str, field: HeightField, rounds: int, tell: Tell) -> Chart:
    theta_out, wavelengths = np.arange(-80.0, 81.0, 4.0), np.linspace(420.0, 780.0, 37)
    theta_in = np.full_like(theta_out, THETA_IN)
    coherence = seen_through(APERTURE)
    pitch, size = field.pitch_um, min(field.heights_um.shape)
    pieces = {
        points: HeightField(field.heights_um[:points, :points], pitch, periodic=False)
        for points in (size // 8, size // 4, size // 2)
        if points * pitch > 2 * _REACH * float(coherence.size(wavelengths).max())
    }

    def everywhere(piece: HeightField, _: int) -> FloatArray:
        surface = averaged(piece, theta_in, theta_out, wavelengths, coherence)
        return averaged_brdf(surface, theta_in, theta_out, wavelengths).brdf

    def places(count: int, number: int) -> FloatArray:
        random = np.random.default_rng([count, number])
        centres = (0.1 + 0.8 * random.random((count, 2))) * size * pitch
        seen = [_seen(field, theta_in, theta_out, wavelengths, coherence, centre) for centre in centres]
        return np.asarray(np.mean(seen, axis=0))

    def interpolated(nodes: int, _: int) -> FloatArray:
        some = np.linspace(wavelengths[0], wavelengths[-1], nodes)
        surface = averaged(field, theta_in, theta_out, some, coherence)
        brdf = averaged_brdf(surface, theta_in, theta_out, some).brdf
        return np.asarray(scipy.interpolate.CubicSpline(some, brdf, axis=1)(wavelengths))

    tell("waves: reference")
    right = everywhere(field, 0)
    candidates = [
        Candidate(
            f"{points * pitch:.0f} µm",
            f"mean over all places of {points * pitch:.0f} µm square",
            "all places",
            partial(everywhere, piece),
            use=_command(
                f"waves {name} --size {points} --pitch {pitch:g} --incident {THETA_IN:g} --aperture {APERTURE:g}"
            ),
        )
        for points, piece in pieces.items()
    ]
    candidates += [
        Candidate(f"{count}", f"mean over {count} random places of the window", "single places", partial(places, count))
        for count in WINDOWS
    ]
    candidates += [
        Candidate(
            f"{nodes} λ",
            f"mean over all places of {size * pitch:.0f} µm square at {nodes} wavelengths, splines between them",
            "all places, fewer wavelengths",
            partial(interpolated, nodes),
            use=_command(
                f"waves {name} --size {size} --pitch {pitch:g} --incident {THETA_IN:g} --aperture {APERTURE:g} "
                f"--wavelengths {','.join(f'{w:g}' for w in np.linspace(wavelengths[0], wavelengths[-1], nodes))}"
            ),
        )
        for nodes in NODES
    ]
    return Chart(
        "simulation-waves",
        "Diffraction without speckle: time against error",
        f"{name}, pitch {pitch:g} µm, one incident angle, {theta_out.size} directions, {wavelengths.size} wavelengths, "
        f"window as of an aperture of {APERTURE:g}°. Error: root mean square, against the mean over all places of "
        f"{size * pitch:.0f} µm square; what a larger piece would change is not in it.",
        Axis("time", "s"),
        Axis("rms error of ln(1 + cos f)", ""),
        tuple(timed.choice(lambda result: _logarithmic(result, right)) for timed in race(candidates, rounds, tell)),
    )


def _seen(
    field: HeightField,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    coherence: Coherence,
    centre: FloatArray,
) -> FloatArray:
    """What one window sees at `centre` (x, y), um, of the piece of `field` that it reaches."""
    reach = int(np.ceil(_REACH * float(coherence.size(wavelengths).max()) / field.pitch_um))
    x, y = (int(place / field.pitch_um) for place in centre)
    heights = field.heights_um[max(y - reach, 0) : y + reach, max(x - reach, 0) : x + reach]
    return patch_brdf(
        HeightField(heights, field.pitch_um, periodic=False), theta_in, theta_out, wavelengths, coherence
    ).brdf


def _command(rest: str) -> Use:
    return Use("text", {"text": f"goniometer simulate {rest}"}, "It takes the directions and patches of the command.")


def _logarithmic(value: FloatArray, right: FloatArray) -> float:
    """Root mean square error of ln(1 + cos(theta_in) f), which a coherent spike does not rule."""
    cosine = np.cos(np.radians(THETA_IN))
    # a spline between few wavelengths may dip below zero
    return float(np.sqrt(np.mean((np.log1p(cosine * np.maximum(value, 0.0)) - np.log1p(cosine * right)) ** 2)))


def _relative(value: FloatArray, right: FloatArray) -> float:
    return float(np.sqrt(np.mean((value - right) ** 2) / np.mean(right**2)))


def _extent(field: HeightField) -> str:
    ny, nx = field.heights_um.shape
    return f"{nx} × {ny} points of {field.pitch_um:g} µm"
