"""The tables of a `.bsdf` file for any isotropic reflectance, in the form in which the lobe itself is not tabulated.

The plugin `measured` of Mitsuba 3 computes f cos(theta_o) = spectra(s) ndf(u) / (4 sigma), see
`analysis.measured_bsdf`. With ndf = D and sigma = cos(theta_i) / G1(i) of GGX what is left for the table is bounded and
smooth where the reflectance is about such a lobe, so the steep lobe never has to be interpolated coarsely. A share of
the table's nodes may follow the normals that are visible from theta_i; the others are even in sqrt(theta_m) and phi_m.

Conventions: u_x = sqrt(2 theta_m / pi), phi_m - phi_i = (2 u_y - 1) pi.
"""

from collections.abc import Callable

import numpy as np

from analysis.directions import from_vectors
from analysis.distributions import ndf
from analysis.tensor_file import Tensor, encode
from analysis.vertices import Reflectance
from drivers.arrays import FloatArray

LOWEST_COS = 0.02
"""Below the horizon the table continues with its value here: no renderer reads further."""

_INCIDENT_NODES = 32
_TABLE_NODES = 80  # per side of the square; 32 x 80 x 80 f32 values are 0.8 MB a wavelength
_WARP_ROWS, _WARP_COLUMNS = 32, 128
_LOBE_NODES = 2049  # the lobe of a mirror (alpha 0.0045) spans the first 5 % of sqrt(theta_m)

AtNormals = Callable[[float, FloatArray, FloatArray], FloatArray]
"""The table [nodes, wavelengths] at theta_i, radians, normals [nodes, 3] and their cosine to the incident direction."""


def bsdf_content(reflectance: Reflectance, alpha: float, wavelengths: FloatArray) -> bytes:
    """A `.bsdf` file of any isotropic `reflectance` at `wavelengths`, nm, with even nodes.

    `alpha` is the roughness of the lobe that the table leaves out; 1 for a reflectance that has none.
    """

    def at_normals(theta_i: float, normal: FloatArray, cos_d: FloatArray) -> FloatArray:
        incident = unit(np.array(theta_i), np.array(0.0))
        cos_o = np.maximum(2 * cos_d * normal[:, 2] - np.cos(theta_i), LOWEST_COS)
        reflected = 2 * cos_d[:, None] * normal - incident
        level = np.maximum(reflected[:, 2], LOWEST_COS)
        sideways = np.sqrt((1 - level**2) / np.maximum(1 - reflected[:, 2] ** 2, 1e-12))
        raised = np.column_stack([reflected[:, :2] * sideways[:, None], level])
        steep = np.maximum(incident, [-1, -1, LOWEST_COS])
        directions = from_vectors(np.broadcast_to(steep / np.linalg.norm(steep), raised.shape), raised, _UP)
        factor = 4 * cos_o * projected_area(np.array(theta_i), alpha) / ndf(directions.cos_m, alpha)
        return np.asarray(reflectance(directions, wavelengths) * factor[:, None])

    return encode(bsdf_fields(at_normals, alpha, wavelengths, 0.0))


_UP = np.array([0.0, 0.0, 1.0])


def bsdf_fields(at_normals: AtNormals, alpha: float, wavelengths: FloatArray, share: float) -> dict[str, Tensor]:
    """The fields of a file of which a `share` of the nodes follows the visible normals; its description is empty."""
    theta_i = np.linspace(0, np.pi / 2, _INCIDENT_NODES)
    lobe = np.linspace(0, 1, _LOBE_NODES) ** 2 * (np.pi / 2)
    warp = _visible_normals(alpha, theta_i, share) if share else np.ones((_INCIDENT_NODES, 2, 2))
    even = np.linspace(0, 1, _TABLE_NODES)
    nodes = np.stack(np.meshgrid(even, even), axis=-1).reshape(-1, 2)
    spectra = np.empty((_INCIDENT_NODES, wavelengths.size, _TABLE_NODES, _TABLE_NODES))
    luminance = np.empty((_INCIDENT_NODES, _TABLE_NODES, _TABLE_NODES))
    for t, theta in enumerate(theta_i):
        u, density = _warp(warp[t], nodes)
        table, sampling = _at_nodes(at_normals, alpha, float(theta), u)
        spectra[t] = table.T.reshape(spectra.shape[1:])
        # where the table is dark a renderer must still look now and then
        luminance[t] = np.maximum(sampling / density, 1e-3 * np.mean(sampling / density)).reshape(luminance.shape[1:])
    return {
        "description": np.zeros(0, np.uint8),
        "jacobian": np.ones(1, np.uint8),
        "theta_i": theta_i,
        "phi_i": np.zeros(1),
        "wavelengths": wavelengths,
        "ndf": np.tile(ndf(np.cos(lobe), alpha), (2, 1)),
        "sigma": np.tile(projected_area(lobe, alpha), (2, 1)),
        "vndf": warp[None],
        "luminance": luminance[None],
        "spectra": spectra[None],
    }


def _at_nodes(at_normals: AtNormals, alpha: float, theta_i: float, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The table [nodes, wavelengths] and the wanted sampling density [nodes] over `u` [nodes, 2]."""
    theta_m = u[:, 0] ** 2 * (np.pi / 2)
    normal = unit(theta_m, (2 * u[:, 1] - 1) * np.pi)
    cos_d = normal @ unit(np.array(theta_i), np.array(0.0))
    cos_o = 2 * cos_d * normal[:, 2] - np.cos(theta_i)
    table = at_normals(theta_i, normal, cos_d)
    # samples below the horizon are lost; let their share fade out over the width of a few cells
    above = np.clip(1 + cos_o / 0.15, 0, 1)
    facing = ndf(normal[:, 2], alpha) * np.maximum(cos_d, 0) * u[:, 0] * np.sin(theta_m)
    return table, facing * table.mean(axis=1) * above


def _visible_normals(alpha: float, theta_i: FloatArray, share: float) -> FloatArray:
    """[T, rows, columns] density in the unit square of which `share` follows the visible normals (Walter et al.)."""
    u_y, u_x = np.meshgrid(np.linspace(0, 1, _WARP_ROWS), np.linspace(0, 1, _WARP_COLUMNS), indexing="ij")
    theta_m = u_x**2 * (np.pi / 2)
    normal = unit(theta_m, (2 * u_y - 1) * np.pi)
    facing = np.stack([normal @ unit(theta, np.array(0.0)) for theta in theta_i])
    density = ndf(normal[..., 2], alpha) * np.maximum(facing, 0) * u_x * np.sin(theta_m)
    mean = np.trapezoid(np.trapezoid(density, u_x[0], axis=-1), u_y[:, 0], axis=-1)
    # rounded as the file rounds, because the nodes of the table have to follow the warp that is read back
    return np.asarray(1 - share + share * density / mean[:, None, None], dtype="f4").astype(float)


def _warp(density: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where samples `s` [n, 2] of the unit square fall under a bilinear density [rows, columns], and its value there.

    Column s[:, 1] is inverted through the marginal over rows first, then s[:, 0] within the row.
    """
    rows, columns = density.shape
    along = _running_integral(density)
    up = _running_integral(along[:, -1])
    y = _invert(np.broadcast_to(up, (len(s), rows)), np.broadcast_to(along[:, -1], (len(s), rows)), s[:, 1])
    row = np.minimum((y * (rows - 1)).astype(int), rows - 2)
    part = (y * (rows - 1) - row)[:, None]
    inside = density[row] * (1 - part) + density[row + 1] * part
    x = _invert(along[row] * (1 - part) + along[row + 1] * part, inside, s[:, 0])
    column = np.minimum((x * (columns - 1)).astype(int), columns - 2)
    rest = x * (columns - 1) - column
    each = np.arange(len(s))
    value = inside[each, column] * (1 - rest) + inside[each, column + 1] * rest
    return np.stack([x, y], axis=-1), np.asarray(value / up[-1])


def _running_integral(values: FloatArray) -> FloatArray:
    """Integral from 0 to every even node of [0, 1] of a piecewise linear function, last axis."""
    steps = (values[..., 1:] + values[..., :-1]) / (2 * (values.shape[-1] - 1))
    return np.asarray(np.pad(np.cumsum(steps, axis=-1), [(0, 0)] * (values.ndim - 1) + [(1, 0)]))


def _invert(integral: FloatArray, density: FloatArray, share: FloatArray) -> FloatArray:
    """[n] where the running integral [n, nodes] of a piecewise linear density reaches `share` of its total."""
    nodes = integral.shape[-1]
    wanted = share * integral[:, -1]
    cell = np.clip(np.sum(integral <= wanted[:, None], axis=-1) - 1, 0, nodes - 2)
    each = np.arange(len(share))
    low, high = density[each, cell], density[each, cell + 1]
    rest = (wanted - integral[each, cell]) * (nodes - 1)
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
