"""Materials that are tables: the BRDF of a dataset, simulated or measured, as what lies on the simulated bench.

Within an incident angle ln f is read along theta_out by monotone cubic polynomials (PCHIP); between incident angles by
a cubic polynomial through four of them at the same theta_h = (theta_out - theta_in) / 2, at which a mirror lobe stays
where it is. The plane is turned by half a turn for negative incident angles, (theta_in, theta_out) -> (-theta_in,
-theta_out), as on an isotropic surface.

Tables of Samples 1 and 4 every 2.5 degrees of theta_out are off by less than 0.1 per cent (root mean square) along it.
Between incident angles 10, 5 and 2 degrees apart the errors are 1.3, 0.5 and 0.1 per cent, and 9, 5 and 1 at most,
where the same theta_h lies beyond the last direction of a neighbour; in the lobe 0.8, 0.2 and 0.02 per cent. Of a
mirror, whose lobe needs a direction every 0.1 degrees, nothing should be read there but the lobe. A campaign is best
measured at the incident angles of the table, between which nothing needs to be read. Steps of 10 nm cost 0.03 per cent
of aluminium. All of it is shown by `python -m tests.benchmarks.tabulated`.

Beyond the table its edge is held, up to the horizon and in wavelength. That is invented, so no campaign may ask for
such directions, and no dataset has such wavelengths (`goniometer.campaigns.material_file`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from analysis.reflectance.directions import Aperture, through_aperture
from drivers.arrays import FloatArray
from simulators.errors import UnfitTable

FLOOR = 1e-6
"""1/sr that are added before the logarithm is taken: what is darker is dark."""

_NORMAL = 0.1
"""Incident angles, degrees, that count as the normal: turned by half a turn they would stand beside themselves."""

_EDGE = 0.5
"""Degrees beyond a table that are as good as within it: the errors of stages, and of a measured edge."""

_ACROSS = 4
"""Incident angles through which is read between them."""


@dataclass(frozen=True)
class Row:
    """What a table says of one incident angle."""

    theta_in: float
    """Degrees."""
    theta_out: FloatArray
    """[directions] degrees, ascending."""
    brdf: FloatArray
    """[directions, wavelengths] 1/sr."""

    @cached_property
    def _logarithm(self) -> "scipy.interpolate.PchipInterpolator":
        return scipy.interpolate.PchipInterpolator(self.theta_out, np.log(self.brdf + FLOOR))

    def logarithm(self, theta_out: FloatArray) -> FloatArray:
        """[directions, wavelengths] of f + `FLOOR`; beyond the table that of its edge."""
        return np.asarray(self._logarithm(np.clip(theta_out, self.theta_out[0], self.theta_out[-1])))

    def turned(self) -> "Row":
        """The same after half a turn about the normal."""
        return Row(-self.theta_in, -self.theta_out[::-1], self.brdf[::-1])


@dataclass(frozen=True)
class Tabulated:
    """A material whose BRDF is a table; made by `simulators.materials.tabulated_file.read_tabulated`."""

    name: str
    """Of the sample whose dataset it is."""
    rows: tuple[Row, ...]
    """One for each incident angle, ascending."""
    wavelengths: FloatArray
    """[wavelengths] nm, ascending."""
    aperture: float
    """Full angle over which the values are averages, degrees; 0 for none."""
    filled: int
    """Directions whose values, or some of them, were filled and stand in no dataset."""
    origin: dict[str, Any]
    """Which dataset it is: its SHA-256, and where it comes from."""
    sha256: str
    """Of the file."""
    diameter_mm: float = 50.0
    """Of the disc, mm."""

    @property
    def range_out(self) -> tuple[float, float]:
        """theta_out between which all incident angles have values, degrees."""
        return max(float(row.theta_out[0]) for row in self.rows), min(float(row.theta_out[-1]) for row in self.rows)

    @cached_property
    def around(self) -> tuple[Row, ...]:
        """The rows, with those of negative incident angles, ascending."""
        turned = [row.turned() for row in reversed(self.rows) if row.theta_in > _NORMAL]
        return (*turned, *self.rows)


def check_reach(what: Tabulated, theta_in: Sequence[float], theta_out: tuple[float, float]) -> None:
    """Raise `UnfitTable` where incident angles, or a range of theta_out, both degrees, lie beyond a table."""
    lowest, highest = what.rows[0].theta_in, what.rows[-1].theta_in
    left, right = what.range_out
    for angle in theta_in:
        if not lowest - _EDGE <= angle <= highest + _EDGE:
            raise UnfitTable(
                f'The material "{what.name}" is known at incident angles from {lowest:g} to {highest:g} deg, and not '
                f"at {angle:g} deg; leave that angle out of the campaign."
            )
    if theta_out[0] < left - _EDGE or theta_out[1] > right + _EDGE:
        raise UnfitTable(
            f'The material "{what.name}" is known at theta_out from {left:g} to {right:g} deg, and not up to '
            f"{theta_out[0]:g} and {theta_out[1]:g} deg; set outgoing in the campaign to what is known."
        )


def tabulated_brdf(
    what: Tabulated,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    aperture: Aperture | None = None,
) -> FloatArray:
    """[points, wavelengths] BRDF of a table, 1/sr, in directions [points], degrees, at wavelengths in nm.

    An `aperture` averages over a table that is not itself an average over one, of which nothing can be taken back. Out
    of the plane the surface is taken as isotropic: cos(theta_out) f is read in the plane on both sides of the mirror
    direction, where the half vector has the same tilt, and weighted by how far it leans to either. For Samples 1, 4 and
    8 that is off by at most 0.6 per cent up to 80 degrees. Linear in wavelength between those of the table.
    """
    if aperture is None or what.aperture > 0:
        return _over_wavelengths(what, _read(what, theta_in, theta_out), wavelengths)
    directions = through_aperture(theta_in, theta_out, aperture)
    theta_h = np.degrees(np.arccos(np.clip(directions.cos_m, -1, 1)))
    in_plane = (theta_out[:, None] + aperture.along - theta_in[:, None]) / 2
    forward = (1 + np.clip(in_plane / np.maximum(theta_h, 1e-9), -1, 1)) / 2
    cos_f = np.zeros((*theta_h.shape, what.wavelengths.size))
    for side, share in ((1, forward), (-1, 1 - forward)):
        there = np.clip(theta_in[:, None] + 2 * side * theta_h, *what.range_out)
        read = _read(what, np.repeat(theta_in, theta_h.shape[1]), there.ravel()).reshape(cos_f.shape)
        cos_f += (share * np.cos(np.radians(there)))[..., None] * read
    weights = np.where(directions.cos_o > 0, aperture.weights / np.maximum(directions.cos_o, 1e-9), 0.0)
    return _over_wavelengths(what, np.einsum("pn,pnw->pw", weights, cos_f), wavelengths)


def _read(what: Tabulated, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """[points, wavelengths of the table] 1/sr."""
    rows = what.around
    angles = np.array([row.theta_in for row in rows])
    weights = _lagrange(angles, np.clip(theta_in, angles[0], angles[-1]))
    logarithm = np.zeros((theta_in.size, what.wavelengths.size))
    for row, weight in zip(rows, weights.T, strict=True):
        some = np.flatnonzero(weight)
        if some.size:
            logarithm[some] += weight[some, None] * row.logarithm(theta_out[some] - theta_in[some] + row.theta_in)
    return np.maximum(np.exp(logarithm) - FLOOR, 0.0)


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """[points, nodes] weights of the polynomial through `_ACROSS` nodes around each point; else zero."""
    count = min(_ACROSS, nodes.size)
    first = np.clip(np.searchsorted(nodes, at) - count // 2, 0, nodes.size - count)
    chosen = first[:, None] + np.arange(count)
    near = nodes[chosen]
    factor = np.ones((at.size, count))
    for i in range(count):
        others = np.arange(count) != i
        factor[:, i] = np.prod((at[:, None] - near[:, others]) / (near[:, [i]] - near[:, others]), axis=1)
    weights = np.zeros((at.size, nodes.size))
    np.put_along_axis(weights, chosen, factor, axis=1)
    return weights


def _over_wavelengths(what: Tabulated, brdf: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """`brdf` [points, wavelengths of the table] at other wavelengths, nm."""
    known = what.wavelengths
    if known.size == 1:
        return np.repeat(brdf, wavelengths.size, axis=1)
    at = np.clip(wavelengths, known[0], known[-1])
    right = np.clip(np.searchsorted(known, at), 1, known.size - 1)
    part = (at - known[right - 1]) / (known[right] - known[right - 1])
    return np.asarray(brdf[:, right - 1] * (1 - part) + brdf[:, right] * part)
