"""Shares of light by its number of reflections; part of `claims`.

Rays on aluminium at 380 nm, as in the paper's Fig. 11. Directions of the plane of incidence are taken together:
"forward" from 15 degrees before the mirror direction to the horizon, "back" beyond 15 degrees on the lamp's side. A
share is that of the BRDF, averaged over these directions. Errors are from the jackknife over patches and planes of
incidence.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from analysis.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import FloatArray
from simulators.heights import HeightField, complete, roughness
from simulators.rays import virtual_scan
from simulators.synthesis import with_micro_roughness
from tests.benchmarks.claims_waves import craters

NM = np.array([380.0])
INCIDENT = (0.0, 20.0, 40.0, 60.0, 80.0)
APERTURE = 5.0
OUT = np.arange(-85.0, 86.0, 5.0)
RAYS = 200_000
"""Of each patch, plane and incident angle."""
SEEDS = (1, 2)
PITCH_UM, FINE_UM = 0.25, 0.1


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


def shares(fields: Iterable[HeightField], theta_in: float, rays: int = RAYS) -> str:
    """Cells of one incident angle: share of multiple reflections forward and back, and the BRDF back."""
    looks = [
        virtual_scan(field, theta_in, OUT, aluminium, rays, seed, APERTURE, azimuth).brdf[:, :, 0]
        for seed, field in enumerate(fields)
        for azimuth in (0.0, 90.0)
    ]
    parts = {"forward": theta_in - 15 <= OUT, "back": OUT <= -15}
    text = ""
    for where, inside in parts.items():
        if where == "back" and theta_in == 0:
            continue  # there is no back
        by_order = np.array([look[inside].mean(axis=0) for look in looks])
        total = by_order.sum(axis=0)
        if total.sum() == 0:
            text += f"{'no light':>18}"
            continue
        multiple = 1 - total[0] / total.sum()
        left = total - by_order
        without = 1 - left[:, 0] / left.sum(axis=1)
        error = np.sqrt((len(looks) - 1) * without.var())
        text += f"{f'{100 * multiple:.1f} ± {100 * error:.1f}':>18}"
        if where == "back":
            text += f"{f' ({total.sum() / len(looks):.4f})':>9}"
    return text


def row(name: str, fields: Sequence[HeightField], rays: int = RAYS) -> None:
    """Print one surface: its excess of area, then all incident angles."""
    area = 1 + np.mean([roughness(field).sdr for field in fields])
    print(f"{name:32}{area:7.3f}" + "".join(shares(fields, theta_in, rays) for theta_in in INCIDENT), flush=True)


def tables(samples: Sequence[str]) -> None:
    """Print all."""
    print("\nshare of multiple reflections, %, forward and back, and in brackets the whole BRDF back, 1/sr")
    print(
        f"{'surface':32}{'area':>7}"
        + "".join(f"{f'forward {a:g}':>18}" + f"{f'back {a:g}':>27}" * (a > 0) for a in INCIDENT)
    )
    for name in samples:
        smooth = [craters(name, seed, PITCH_UM, 512.0) for seed in SEEDS]
        row(f"{name}, smooth", smooth)
        fine = [craters(name, seed, FINE_UM) for seed in SEEDS]
        row(f"{name}, micro-roughness", [with_micro_roughness(f, 1000 + s) for f, s in zip(fine, SEEDS, strict=True)])
