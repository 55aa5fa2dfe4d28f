"""Reads a `.bsdf` file and evaluates it as a renderer does, so that a written file can be judged.

A NumPy account of what Mitsuba 3's plugin `measured` computes in the isotropic case, kept apart from the
writer on purpose: it shares the container and nothing else. With the half vector m, u = (sqrt(2 theta_m / pi),
(phi_m - phi_i + pi) / (2 pi)) lies in the unit square; the table `vndf` is a density there whose cumulative
distribution maps u to s; `spectra` are looked up at s and multiplied by ndf(u) / (4 sigma). All tables are
bilinear on even nodes and linear between their values of theta_i and of wavelength.
Source: Dupuy and Jakob, ACM TOG 37, 6 (2018), sections 4 and 5.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.bsdf.tensor_file import decode
from drivers.arrays import FloatArray

Indices = NDArray[np.intp]


class _Between(NamedTuple):
    """Position between two nodes of a table."""

    below: Indices
    fraction: FloatArray


@dataclass(frozen=True)
class MeasuredBsdf:
    """The tables of an isotropic file; unit square tables have phi_m first and theta_m last."""

    description: str
    theta_i: FloatArray
    """[T] radians."""
    wavelengths: FloatArray
    """[L] nanometres."""
    ndf: FloatArray
    """[rows, columns]"""
    sigma: FloatArray
    """[rows, columns]"""
    vndf: FloatArray
    """[T, H, W], each slice with unit integral."""
    luminance: FloatArray
    """[T, R, R], each slice with unit integral."""
    spectra: FloatArray
    """[T, L, R, R]"""


def read_bsdf(content: bytes) -> MeasuredBsdf:
    """The tables of a file given as bytes; raises `InputError` where it is no tensor file."""
    fields = decode(content)
    tables = {name: fields[name].astype(float) for name in fields if name not in ("description", "jacobian")}
    return MeasuredBsdf(
        fields["description"].tobytes().decode(),
        tables["theta_i"],
        tables["wavelengths"],
        tables["ndf"],
        tables["sigma"],
        _unit_integral(tables["vndf"][0]),
        _unit_integral(tables["luminance"][0]),
        tables["spectra"][0],
    )


def evaluate(bsdf: MeasuredBsdf, incident: FloatArray, reflected: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """BRDF times cos(theta_o), [directions, wavelengths], 1/sr, for unit vectors [directions, 3] above the surface."""
    theta_i, u, _ = _half_vector(incident, reflected)
    slices = _locate(theta_i, bsdf.theta_i)
    s = _warp_back(bsdf.vndf, slices, u)
    row, column = _on_unit(s[:, 1], bsdf.spectra.shape[2]), _on_unit(s[:, 0], bsdf.spectra.shape[3])
    colour = _locate(np.clip(wavelengths, bsdf.wavelengths[0], bsdf.wavelengths[-1]), bsdf.wavelengths)
    at_nodes = _blend(bsdf.spectra, slices, row, column)
    spectrum = at_nodes[:, colour.below] * (1 - colour.fraction) + at_nodes[:, colour.below + 1] * colour.fraction
    u_i = np.stack([np.sqrt(theta_i * (2 / np.pi)), np.full_like(theta_i, 0.5)], axis=-1)
    factor = _bilinear(bsdf.ndf, u) / (4 * _bilinear(bsdf.sigma, u_i))
    return np.asarray(spectrum * factor[:, None])


def sampling_density(bsdf: MeasuredBsdf, incident: FloatArray, reflected: FloatArray) -> FloatArray:
    """Probability density, [directions], 1/sr, with which the renderer's sampling picks `reflected`."""
    theta_i, u, cos_d = _half_vector(incident, reflected)
    slices = _locate(theta_i, bsdf.theta_i)
    s = _warp_back(bsdf.vndf, slices, u)
    vndf = _blend(bsdf.vndf, slices, _on_unit(u[:, 1], bsdf.vndf.shape[1]), _on_unit(u[:, 0], bsdf.vndf.shape[2]))
    size = bsdf.luminance.shape[1]
    luminance = _blend(bsdf.luminance, slices, _on_unit(s[:, 1], size), _on_unit(s[:, 0], size))
    area = 2 * np.pi**2 * u[:, 0] * np.sin(u[:, 0] ** 2 * np.pi / 2)
    return np.asarray(vndf * luminance / (np.maximum(area, 1e-6) * 4 * cos_d))


def _half_vector(incident: FloatArray, reflected: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta_i in radians, the half vector's place [directions, 2] in the unit square, and incident . half."""
    half = incident + reflected
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    theta_m, theta_i = _elevation(half), _elevation(incident)
    phi = np.arctan2(half[:, 1], half[:, 0]) - np.arctan2(incident[:, 1], incident[:, 0])
    turn = (phi + np.pi) / (2 * np.pi)
    u = np.stack([np.sqrt(theta_m * (2 / np.pi)), turn - np.floor(turn)], axis=-1)
    return theta_i, u, np.asarray(np.sum(incident * half, axis=-1))


def _elevation(vector: FloatArray) -> FloatArray:
    """Angle to the normal, radians; unlike an arc cosine exact near the normal."""
    return np.asarray(2 * np.arcsin(np.clip(0.5 * np.linalg.norm(vector - [0, 0, 1], axis=-1), 0, 1)))


def _locate(value: FloatArray, nodes: FloatArray) -> _Between:
    """Between which of the ascending `nodes` each value lies."""
    below = np.clip(np.searchsorted(nodes, value, side="right") - 1, 0, len(nodes) - 2)
    return _Between(below, (value - nodes[below]) / (nodes[below + 1] - nodes[below]))


def _on_unit(value: FloatArray, size: int) -> _Between:
    """The same on `size` even nodes from 0 to 1."""
    place = np.clip(value, 0, 1) * (size - 1)
    below = np.minimum(place.astype(np.intp), size - 2)
    return _Between(below, place - below)


def _bilinear(table: FloatArray, u: FloatArray) -> FloatArray:
    """Value of a table [rows, columns] at `u` [directions, 2]."""
    row, column = _on_unit(u[:, 1], table.shape[0]), _on_unit(u[:, 0], table.shape[1])
    lower, upper = (
        table[row.below + step, column.below] * (1 - column.fraction)
        + table[row.below + step, column.below + 1] * column.fraction
        for step in (0, 1)
    )
    return np.asarray(lower * (1 - row.fraction) + upper * row.fraction)


def _blend(table: FloatArray, slices: _Between, row: _Between, column: _Between) -> FloatArray:
    """Trilinear value [directions, ...] of a table [T, ..., rows, columns]."""
    total: FloatArray | float = 0.0
    for t in (0, 1):
        for r in (0, 1):
            for c in (0, 1):
                weight = (
                    (slices.fraction if t else 1 - slices.fraction)
                    * (row.fraction if r else 1 - row.fraction)
                    * (column.fraction if c else 1 - column.fraction)
                )
                value = table[slices.below + t, ..., row.below + r, column.below + c]
                total = total + value * weight.reshape(-1, *[1] * (value.ndim - 1))
    return np.asarray(total)


def _cumulative(values: FloatArray) -> FloatArray:
    """Trapezoid integral from 0 to each even node of [0, 1], along the last axis."""
    steps = 0.5 * (values[..., 1:] + values[..., :-1]) / (values.shape[-1] - 1)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def _unit_integral(table: FloatArray) -> FloatArray:
    """Each slice [rows, columns] of a bilinear table divided by its integral over the unit square."""
    return np.asarray(table / _cumulative(_cumulative(table)[..., -1])[..., -1][:, None, None])


def _warp_back(density: FloatArray, slices: _Between, u: FloatArray) -> FloatArray:
    """Cumulative distribution s [directions, 2] of a density [T, rows, columns] at `u`: rows first, then columns."""
    rows, columns = density.shape[1:]
    row, column = _on_unit(u[:, 1], rows), _on_unit(u[:, 0], columns)
    along = _cumulative(density)
    marginal = along[..., -1]
    up = _cumulative(marginal)

    def between_slices(table: FloatArray, *index: Indices) -> FloatArray:
        low, high = table[slices.below, *index], table[slices.below + 1, *index]
        return np.asarray(low * (1 - slices.fraction) + high * slices.fraction)

    def partial(low: FloatArray, high: FloatArray, fraction: FloatArray, size: int) -> FloatArray:
        return np.asarray((fraction * low + 0.5 * fraction**2 * (high - low)) / (size - 1))

    m_low, m_high = between_slices(marginal, row.below), between_slices(marginal, row.below + 1)
    s_y = between_slices(up, row.below) + partial(m_low, m_high, row.fraction, rows)
    part = []
    for r in (0, 1):
        p_low = between_slices(density, row.below + r, column.below)
        p_high = between_slices(density, row.below + r, column.below + 1)
        start = between_slices(along, row.below + r, column.below)
        part.append(start + partial(p_low, p_high, column.fraction, columns))
    s_x = (part[0] * (1 - row.fraction) + part[1] * row.fraction) / (m_low * (1 - row.fraction) + m_high * row.fraction)
    return np.stack([s_x, s_y], axis=-1)
