"""The tables of a `.bsdf` file for any isotropic reflectance, in the form in which its lobe itself is not tabulated.

The plugin `measured` of Mitsuba 3, and PBRT, compute f cos(theta_o) = spectra(s) ndf(u) / (4 sigma), see
`analysis.bsdf.measured_bsdf`. With sigma = cos(theta_i) / G1(i) of GGX, and for ndf what the reflectance itself has
along its retro direction,

    ndf(theta_m) = 4 sigma(theta_m)^2 (f(theta_m, -theta_m) - base) + 4 base,

what is left for the table is bounded and smooth. For a Cook-Torrance lobe this ndf is D F(0), of whatever distribution
it is, so the steep lobe never has to be interpolated coarsely; `base` is what is alike in all directions, the diffuse
light below a lobe, of which the table then has cos(theta_o). A wide lobe is better left in the table, where it and its
masking bend in opposite ways: ndf is then one number, and sigma that of the widest lobe. A share of the table's nodes
may follow the normals that are visible from theta_i; the others are even in sqrt(theta_m) and phi_m.

Conventions: u_x = sqrt(2 theta_m / pi), phi_m - phi_i = (2 u_y - 1) pi.
"""

from typing import NamedTuple

import numpy as np

from analysis.bsdf.tensor_file import Tensor, encode
from analysis.reflectance.directions import Directions
from analysis.scenes.vertices import Reflectance
from drivers.arrays import FloatArray

LOWEST_COS = 0.02
"""Below the horizon the table continues with its value here: no renderer reads further."""

LOBE_NODES = tuple(2**power + 1 for power in range(6, 14))
"""Sizes of the table ndf; the lobe of a mirror (alpha 0.0045) spans the first 5 % of sqrt(theta_m)."""

_GRAZING = 1.25
_LOWEST_COS_I = 1e-3  # of the last slice: below it sigma is as good as the one at the horizon
_SIGMA_NODES = 129
_WARP_ROWS, _WARP_COLUMNS = 8, 64
_DARKEST_LOBE = 1e-12  # of its brightest; far below all that is seen, and still a number in f32


class Grid(NamedTuple):
    """How many nodes the tables of a file have, and where."""

    incident: int
    """From 0 to 90 degrees, somewhat closer at grazing incidence."""
    table: int
    """Per side of the unit square."""
    share: float
    """Of the nodes of the square that follow the visible normals, 0 to below 1."""
    whole: bool = False
    """Whether the lobe is left in the table."""


USUAL_GRID = Grid(32, 80, 0.0)
"""Good to a per cent or two for the usual models of the ladder; 0.8 MB a wavelength."""


def bsdf_content(reflectance: Reflectance, alpha: float, wavelengths: FloatArray) -> bytes:
    """A `.bsdf` file of any isotropic `reflectance` at `wavelengths`, nm, with the usual grid.

    `alpha` is the roughness of its lobe; 1 for a reflectance that has none.
    """
    lobe = lobe_table(reflectance, alpha, wavelengths, 2049)
    return encode(bsdf_fields(reflectance, alpha, wavelengths, USUAL_GRID, lobe))


def lobe_table(
    reflectance: Reflectance, alpha: float, wavelengths: FloatArray, nodes: int, base: float = 0.0
) -> FloatArray:
    """[nodes] of the table ndf, even in sqrt(theta_m), 1/sr, of the mean over `wavelengths`; `base` in 1/sr."""
    cos_m = np.maximum(np.cos(np.linspace(0, 1, nodes) ** 2 * (np.pi / 2)), LOWEST_COS)
    retro = reflectance(Directions(cos_m, cos_m, cos_m, np.ones(nodes)), wavelengths).mean(axis=1)
    value = 4 * (np.maximum(retro - base, 0.0) * projected_area(np.arccos(cos_m), alpha) ** 2 + base)
    return np.asarray(np.maximum(value, _DARKEST_LOBE * value.max()), dtype="f4").astype(float)


def fine_lobe_table(
    reflectance: Reflectance, alpha: float, wavelengths: FloatArray, base: float, tolerance: float, faintest: float
) -> FloatArray:
    """The smallest `lobe_table` that is linear between its nodes to the relative `tolerance`.

    Where it is below `faintest`, 1/sr, it may err by this much. The largest of `LOBE_NODES` where none is good enough.
    """
    for nodes in LOBE_NODES[:-1]:
        table = lobe_table(reflectance, alpha, wavelengths, nodes, base)
        between = lobe_table(reflectance, alpha, wavelengths, 2 * nodes - 1, base)[1::2]
        if np.max(np.abs(0.5 * (table[1:] + table[:-1]) - between) / np.maximum(between, faintest)) <= tolerance:
            return table
    return lobe_table(reflectance, alpha, wavelengths, LOBE_NODES[-1], base)


def bsdf_fields(
    reflectance: Reflectance, alpha: float, wavelengths: FloatArray, grid: Grid, lobe: FloatArray
) -> dict[str, Tensor]:
    """The fields of a file with `lobe` as of `lobe_table`; its description is empty."""
    taken, width = (np.full(2, 4.0), 1.0) if grid.whole else (lobe, alpha)
    theta_i = (1 - np.linspace(1, 0, grid.incident) ** _GRAZING) * (np.pi / 2)
    warp = _visible_normals(lobe, theta_i, grid.share) if grid.share else np.ones((grid.incident, 2, 2))
    even = np.linspace(0, 1, grid.table)
    rows = (grid.table + 1) // 2  # the others are their mirror image
    nodes = np.stack(np.meshgrid(even, even[:rows]), axis=-1).reshape(-1, 2)
    spectra = np.empty((grid.incident, wavelengths.size, rows, grid.table))
    luminance = np.empty((grid.incident, rows, grid.table))
    for t, theta in enumerate(theta_i):
        u, density = _warp(warp[t], even, rows) if grid.share else (nodes, np.ones(len(nodes)))
        table, sampling = _at_nodes(reflectance, width, wavelengths, taken, float(theta), u)
        spectra[t] = table.T.reshape(spectra.shape[1:])
        # where the table is dark a renderer must still look now and then
        luminance[t] = np.maximum(sampling / density, 1e-3 * np.mean(sampling / density)).reshape(luminance.shape[1:])
    spectra, luminance = (
        np.concatenate([half, half[..., grid.table - rows - 1 :: -1, :]], axis=-2) for half in (spectra, luminance)
    )
    return {
        "description": np.zeros(0, np.uint8),
        "jacobian": np.ones(1, np.uint8),
        "theta_i": theta_i,
        "phi_i": np.zeros(1),
        "wavelengths": wavelengths,
        "ndf": np.tile(taken, (2, 1)),
        "sigma": np.tile(projected_area(np.linspace(0, 1, _SIGMA_NODES) ** 2 * (np.pi / 2), width), (2, 1)),
        "vndf": warp[None],
        "luminance": luminance[None],
        "spectra": spectra[None],
    }


def size_of(grid: Grid, wavelengths: int, lobe: int) -> int:
    """Bytes of the tables of a file."""
    warp = _WARP_ROWS * _WARP_COLUMNS if grid.share else 4
    ends = 2 if grid.whole else lobe
    return 4 * (grid.incident * (grid.table**2 * (wavelengths + 1) + warp) + 2 * (ends + _SIGMA_NODES))


def _at_nodes(
    reflectance: Reflectance,
    alpha: float,
    wavelengths: FloatArray,
    lobe: FloatArray,
    theta_i: float,
    u: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The table [nodes, wavelengths] and the wanted sampling density [nodes] over `u` [nodes, 2]."""
    theta_m = u[:, 0] ** 2 * (np.pi / 2)
    normal = unit(theta_m, (2 * u[:, 1] - 1) * np.pi)
    incident = unit(np.array([theta_i]), np.array([0.0]))
    cos_d = normal @ incident[0]
    mirrored = 2 * cos_d[:, None] * normal - incident
    reflected, incident = _above_horizon(mirrored), _above_horizon(incident, _LOWEST_COS_I)
    twice = np.sqrt(2 + 2 * (reflected @ incident[0]))  # length of the sum of both
    cos_i = np.broadcast_to(incident[0, 2], twice.shape)
    directions = Directions(cos_i, reflected[:, 2], (cos_i + reflected[:, 2]) / twice, twice / 2)
    # by the normal of the pair that is evaluated, which below the horizon is another one
    place = np.sqrt(np.arccos(np.clip(directions.cos_m, 0, 1)) * (2 / np.pi))
    factor = 4 * reflected[:, 2] * projected_area(np.arccos(incident[:, 2]), alpha) / _on_even_nodes(lobe, place)
    table = reflectance(directions, wavelengths) * factor[:, None]
    # samples below the horizon are lost; let their share fade out over the width of a few cells
    fading = np.clip(1 + mirrored[:, 2] / 0.15, 0, 1)
    facing = _on_even_nodes(lobe, u[:, 0]) * np.maximum(cos_d, 0) * u[:, 0] * np.sin(theta_m)
    return table, facing * table.mean(axis=1) * fading


def _on_even_nodes(table: FloatArray, place: FloatArray) -> FloatArray:
    return np.interp(place, np.linspace(0, 1, table.size), table)


def _above_horizon(vectors: FloatArray, lowest: float = LOWEST_COS) -> FloatArray:
    """Unit vectors [n, 3], the lowest of them raised at their azimuth."""
    level = np.maximum(vectors[:, 2], lowest)
    sideways = np.sqrt((1 - level**2) / np.maximum(1 - vectors[:, 2] ** 2, 1e-12))
    return np.column_stack([vectors[:, :2] * sideways[:, None], level])


def _visible_normals(lobe: FloatArray, theta_i: FloatArray, share: float) -> FloatArray:
    """[T, rows, columns] density in the unit square of which `share` follows the visible normals (Walter et al.)."""
    u_y, u_x = np.meshgrid(np.linspace(0, 1, _WARP_ROWS), np.linspace(0, 1, _WARP_COLUMNS), indexing="ij")
    theta_m = u_x**2 * (np.pi / 2)
    normal = unit(theta_m, (2 * u_y - 1) * np.pi)
    facing = np.stack([normal @ unit(theta, np.array(0.0)) for theta in theta_i])
    density = _on_even_nodes(lobe, u_x) * np.maximum(facing, 0) * u_x * np.sin(theta_m)
    mean = np.trapezoid(np.trapezoid(density, u_x[0], axis=-1), u_y[:, 0], axis=-1)
    # rounded as the file rounds, because the nodes of the table have to follow the warp that is read back
    return np.asarray(1 - share + share * density / mean[:, None, None], dtype="f4").astype(float)


def _warp(density: FloatArray, even: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Where samples on a grid fall under a bilinear density [rows, columns] of the unit square, and its value there.

    The samples are all pairs of `even` [n] from 0 to 1 and its first `count`, the former the faster one; found are
    u [n * count, 2] and the value [n * count]. The second coordinate is inverted through the marginal over rows first,
    then the first within the row.
    """
    rows = density.shape[0]
    along = _running_integral(density)
    up = _running_integral(along[:, -1])
    y = _invert(up[None], along[None, :, -1], even[:count])[0]
    row = np.minimum((y * (rows - 1)).astype(int), rows - 2)
    part = (y * (rows - 1) - row)[:, None]
    inside = density[row] * (1 - part) + density[row + 1] * part
    x = _invert(along[row] * (1 - part) + along[row + 1] * part, inside, even)
    place = x * (density.shape[1] - 1)
    column = np.minimum(place.astype(int), density.shape[1] - 2)
    each = np.arange(count)[:, None]
    value = inside[each, column] * (column + 1 - place) + inside[each, column + 1] * (place - column)
    return np.stack([x.ravel(), np.repeat(y, even.size)], axis=-1), np.asarray(value.ravel() / up[-1])


def _running_integral(values: FloatArray) -> FloatArray:
    """Integral from 0 to every even node of [0, 1] of a piecewise linear function, last axis."""
    steps = (values[..., 1:] + values[..., :-1]) / (2 * (values.shape[-1] - 1))
    return np.asarray(np.pad(np.cumsum(steps, axis=-1), [(0, 0)] * (values.ndim - 1) + [(1, 0)]))


def _invert(integral: FloatArray, density: FloatArray, share: FloatArray) -> FloatArray:
    """[m, n] where each running integral [m, nodes] of a piecewise linear density reaches `share` [n] of its total."""
    count, nodes = integral.shape
    # one ascending list of all of them: each is moved to where the one before it ends
    start = np.arange(count)[:, None]
    listed = (integral / integral[:, -1:] + start).ravel()
    cell = np.clip(np.searchsorted(listed, share + start, side="right") - 1 - start * nodes, 0, nodes - 2)
    low, high = density[start, cell], density[start, cell + 1]
    rest = np.maximum(share * integral[:, -1:] - integral[start, cell], 0.0) * (nodes - 1)
    # root of low x + (high - low) x^2 / 2 = rest, in the form that survives high = low
    root = 2 * rest / (low + np.sqrt(np.maximum(low**2 + 2 * (high - low) * rest, 0)))
    return np.asarray((cell + np.clip(root, 0, 1)) / (nodes - 1))


def projected_area(theta: FloatArray, alpha: float) -> FloatArray:
    """cos(theta) / G1(theta) of GGX, in a form that stays finite at the horizon (`theta` in radians)."""
    return np.asarray(0.5 * (np.cos(theta) + np.hypot(np.cos(theta), alpha * np.sin(theta))))


def unit(theta: FloatArray, phi: FloatArray) -> FloatArray:
    """[..., 3] unit vectors; angles in radians."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
