"""Shares of light by its number of reflections; part of `claims`.

Rays on aluminium at 380 nm, as in the paper's Fig. 11. Directions of the plane of incidence are taken together:
"forward" from 15 degrees before the mirror direction to the horizon, "back" beyond 15 degrees on the lamp's side. A
share is that of the BRDF, averaged over these directions. Errors are from the jackknife over patches and planes of
incidence.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import BoolArray, FloatArray
from simulators.rays.rays import virtual_scan
from simulators.topographies.heights import HeightField, complete, roughness
from simulators.topographies.synthesis import with_micro_roughness
from simulators.waves.sampling import refined
from tests.benchmarks.claims_waves import craters

NM = np.array([380.0])
INCIDENT = (0.0, 20.0, 40.0, 60.0, 80.0)
APERTURE = 5.0
OUT = np.arange(-85.0, 86.0, 5.0)
RAYS = 200_000
"""Of each patch, plane and incident angle."""
SEEDS = (2, 3)
PITCH_UM, FINE_UM = 0.5, 0.1
"""Of smooth craters, and of those with micro-roughness."""
CONES = ((0.01, 1.5), (0.01, 3.0), (0.002, 6.0), (0.01, 6.0), (0.05, 6.0), (0.01, -6.0), (0.05, -6.0))
"""Share of the area and height, um, of cones of `RADIUS_UM`; the last are pits."""
RADIUS_UM = 1.5


def aluminium(cosine: FloatArray) -> FloatArray:
    """[..., 1]"""
    return fresnel_conductor(cosine, *load_conductor().index(NM))


def cones(field: HeightField, seed: int, share: float, radius_um: float, height_um: float) -> HeightField:
    """`field` with cones of this height on `share` of its area at random; a negative height makes pits."""
    heights = complete(field).copy()
    size, reach = heights.shape[0], radius_um / field.pitch_um
    count = round(share * heights.size / (np.pi * reach**2))
    for y, x in np.random.default_rng(seed).random((count, 2)) * size:
        rows, columns = (np.arange(int(np.ceil(c - reach)), int(c + reach) + 1) for c in (y, x))
        away = np.hypot((rows - y)[:, None], columns - x) / reach
        inside = np.ix_(rows % size, columns % size)
        heights[inside] += height_um * np.maximum(1 - away, 0)
    return replace(field, heights_um=heights)


def scanned(fields: Sequence[HeightField], theta_in: float) -> FloatArray:
    """[looks, points, orders] BRDF of each patch in both planes of incidence, 1/sr."""
    looks = [
        virtual_scan(field, theta_in, OUT, aluminium, RAYS, seed, APERTURE, azimuth).brdf[:, :, 0]
        for seed, field in enumerate(fields)
        for azimuth in (0.0, 90.0)
    ]
    return np.stack(looks)


def share(looks: FloatArray, inside: BoolArray) -> str:
    """Cell of the share of multiple reflections in the directions `inside`, %, and its standard error."""
    by_order = looks[:, inside].mean(axis=1)
    total = by_order.sum(axis=0)
    if total.sum() == 0:
        return f"{'no light':>12}"
    left = total - by_order
    without = 1 - left[:, 0] / left.sum(axis=1)
    error = np.sqrt((len(looks) - 1) * without.var())
    return f"{f'{100 * (1 - total[0] / total.sum()):.1f} ± {100 * error:.1f}':>12}"


def row(name: str, fields: Sequence[HeightField]) -> FloatArray:
    """Print one surface: its area, then all incident angles. Returns the BRDF at 60 degrees, see `scanned`."""
    print(f"{name:34}{1 + np.mean([roughness(field).sdr for field in fields]):7.3f}", end="")
    for theta_in in INCIDENT:
        looks = scanned(fields, theta_in)
        back = OUT <= -15
        print(share(looks, theta_in - 15 <= OUT), end="")
        if theta_in > 0:
            print(f"{share(looks, back)} ({looks[:, back].sum(axis=2).mean():.4f})", end="")
        if theta_in == 60:
            oblique = looks
    print(flush=True)
    return oblique


def tables(samples: Sequence[str]) -> None:
    """Print all."""
    print("\nshare of multiple reflections, %, forward and back, and in brackets the whole BRDF back, 1/sr")
    print(f"{'surface':34}{'area':>7}", end="")
    print("".join(f"{f'forward {angle:g}':>12}" + f"{f'back {angle:g}':>21}" * (angle > 0) for angle in INCIDENT))
    oblique, rough = {}, []
    for name in samples:
        oblique[f"{name}, smooth"] = row(f"{name}, smooth", [craters(name, seed, PITCH_UM, 512.0) for seed in SEEDS])
        fine = [with_micro_roughness(craters(name, seed, FINE_UM), 1000 + seed) for seed in SEEDS]
        oblique[f"{name}, micro-roughness"] = row(f"{name}, micro-roughness", fine)
        rough = rough or fine
    finer = [refined(craters("sample-1", seed, PITCH_UM, 512.0), 2) for seed in SEEDS]
    for part, height_um in CONES:
        name = f"sample-1, {'cones' if height_um > 0 else 'pits'} {abs(height_um):g} um, {100 * part:g} %"
        oblique[name] = row(name, [cones(field, 1, part, RADIUS_UM, height_um) for field in finer])
    row("sample-1, smooth, half the pitch", finer)
    row("sample-1, micro, half the pitch", [refined(field, 2) for field in rough])
    wide = np.arange(-80.0, 81.0, 20.0)
    print("\nthe same at an incident angle of 60 degrees, over theta_out, 20 degrees each")
    print(f"{'surface':34}" + "".join(f"{middle:>12g}" for middle in wide))
    for name, looks in oblique.items():
        print(f"{name:34}" + "".join(share(looks, np.abs(middle - OUT) <= 10) for middle in wide))
