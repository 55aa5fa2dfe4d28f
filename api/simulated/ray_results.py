"""What a scan with rays is told as: a dataset, an object for JSON, lines for a person, and what to mind."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from analysis.reflectance.fresnel import Conductor
from simulators.computed import Computed
from simulators.rays.decomposition import CONVERGED, Change, halves, shares
from simulators.rays.scan import WINDOWS, RayScan
from simulators.topographies.heights import Roughness
from simulators.topographies.topography import Topography

_LARGEST_ERROR, _LARGEST_LOSS = 0.1, 0.01
"""Relative standard error of the usual direction, and share of rays lost through sides, that a user hears of."""

_APART = 2.0
"""Autocorrelation lengths that a window should measure to be a sample of its own."""


def warnings(
    scan: RayScan, changes: tuple[Change, ...], rough: Roughness, first: Topography, *, micro: bool
) -> list[str]:
    """What a user should know who samples too coarsely, a line each."""
    told = []
    coarse = [change for change in changes if abs(change.pitch) >= max(CONVERGED, 2 * change.u_pitch)]
    if coarse:
        worst = max(coarse, key=lambda change: abs(change.pitch))
        told.append(
            f"The pitch of {first.field.pitch_um:g} µm is too coarse for {len(coarse)} of {len(changes)} published "
            f"figures: twice the pitch changes them by up to {100 * abs(worst.pitch):.2g} % ({worst.figure}, at an "
            f"incident angle of {worst.theta_in:g}°); halve it."
        )
    lit = scan.brdf.mean(axis=-1) > 0
    level = np.median((scan.u_level.mean(axis=-1) / np.where(lit, scan.brdf.mean(axis=-1), np.nan))[lit])
    if level > _LARGEST_ERROR:
        told.append(
            f"Half of the lit directions are known no better than {100 * level:.0f} % (standard error); trace "
            f"{int(np.ceil((level / _LARGEST_ERROR) ** 2))} times as many rays for {100 * _LARGEST_ERROR:.0f} %, or "
            f"widen the aperture."
        )
    side = min(first.field.heights_um.shape) * first.field.pitch_um / WINDOWS
    if not side >= _APART * rough.sal_um:
        told.append(
            f"Windows of {side:.3g} µm, of which errors are told, are smaller than {_APART:g} autocorrelation lengths "
            f"of {rough.sal_um:.3g} µm: errors are too small; make the patch larger."
        )
    lost = scan.ends[:, 1].max() / scan.traced
    if lost > _LARGEST_LOSS:
        told.append(
            f"Up to {100 * lost:.1f} % of the rays left through the sides of the patch, and the BRDF is low by about "
            f"as much; measure a larger area, or leave out grazing angles."
        )
    if micro:
        told.append("Rays know no wavelength: what they do on roughness finer than light is not physical.")
    return told


def computed(sample: str, scan: RayScan, made: list[Topography], metal: Conductor, warnings: list[str]) -> Computed:
    """The scan as a dataset."""
    asked = scan.asked
    theta_in, theta_out = (each.ravel() for each in np.meshgrid(asked.theta_in, asked.theta_out, indexing="ij"))
    brdf, u_level, u_spectral = (each.reshape(theta_in.size, -1) for each in (scan.brdf, scan.u_level, scan.u_spectral))
    lineage: dict[str, object] = {
        "simulated": f"rays on {made[0].name}",
        "surface": made[0].origin,
        "patches": len(made),
        "rays_per_incident_angle": scan.traced,
        "seed": asked.seed,
        "azimuth_deg": asked.azimuth,
        "conductor": metal.name,
        "light_by_reflections": _balances(scan),
        "warnings": warnings,
    }
    return Computed(sample, theta_in, theta_out, asked.wavelengths, brdf, u_level, u_spectral, asked.aperture, lineage)


def _balances(scan: RayScan) -> list[dict[str, Any]]:
    """Where the energy went, for each incident angle: shares of the light that falls in, and counts of rays."""
    light = scan.light[..., scan.asked.decomposed_at].mean(axis=(0, 1)).sum(axis=-1)
    return [
        {
            "theta_in_deg": float(theta_in),
            "wavelength_nm": float(scan.asked.wavelengths[scan.asked.decomposed_at]),
            "escaped_by_reflections": light[i].tolist(),
            "absorbed": float(scan.ends[i, 0] / scan.traced - light[i].sum()),
            "lost": float(scan.ends[i, 1] / scan.traced),
            "stopped": float(scan.ends[i, 2] / scan.traced),
            "rays": dict(zip(("escaped", "lost", "stopped"), scan.ends[i].tolist(), strict=True))
            | {"traced": scan.traced, "escaped_by_reflections": scan.escaped[i].tolist()},
        }
        for i, theta_in in enumerate(scan.asked.theta_in)
    ]


def decomposition(scan: RayScan) -> dict[str, Any]:
    """For JSON: energy, shares as Fig. 11 has them, and the BRDF by the number of reflections."""
    found, over = shares(scan), halves(scan)
    parts = scan.by_order.mean(axis=1)
    u = parts.std(axis=0, ddof=1) / len(parts) ** 0.5
    return {
        "wavelength_nm": float(scan.asked.wavelengths[scan.asked.decomposed_at]),
        "orders": ["1", "2", "3", "4 or more"],
        "energy": _balances(scan),
        "theta_in_deg": scan.asked.theta_in.tolist(),
        "shares": {
            "theta_out_deg": found.theta_out.tolist(),
            "share": found.share.tolist(),
            "u_share": found.u_share.tolist(),
        },
        "halves": {
            "axes": ["theta_in", "once, more often", "back, forward"],
            "share": over.share.tolist(),
            "u_share": over.u_share.tolist(),
        },
        "brdf": {
            "theta_out_deg": scan.asked.theta_out.tolist(),
            "per_sr": parts.mean(axis=0).tolist(),
            "u_per_sr": u.tolist(),
        },
    }


def lines(scan: RayScan, changes: tuple[Change, ...]) -> Iterator[str]:
    """What a person reads."""
    nm = scan.asked.wavelengths[scan.asked.decomposed_at]
    over = 100 * halves(scan).share
    yield f"Of the light that leaves at {nm:g} nm, reflected once forward / back, more often forward / back, per cent:"
    for theta_in, share in zip(scan.asked.theta_in, over, strict=True):
        once, more = share
        yield f"  θ in {theta_in:>3g}°: {once[1]:6.2f} / {once[0]:5.2f}, {more[1]:6.3f} / {more[0]:6.3f}"
    lost, stopped = scan.ends[:, 1].sum(), scan.ends[:, 2].sum()
    yield f"All {scan.ends.sum():,} rays are accounted for: {lost:,} lost through a side, {stopped:,} stopped."
    done = sum(change.largest < CONVERGED for change in changes)
    yield f"{done} of {len(changes)} published figures are converged to 1 % (rays, area, pitch doubled)."
