"""The lobes that the interpolation starts from: GGX-like shapes with few parameters, fitted to all incident angles.

They need not be right. A Gaussian process carries what they leave over (`goniometer.interpolation.interpolant`); where
they are and how wide says on which scale a BRDF changes there, which matters more than their shape.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from drivers.arrays import FloatArray

NARROWEST = 0.25
"""Half width of a lobe, degrees of the half vector, below which nothing follows it: the aperture blurs it."""

_LARGEST_TILT = 2.0
"""Degrees by which the surface normal may lean away from the zero of the sample stage."""

_STARTS = (0.004, 0.02, 0.06, 0.15, 0.4)
"""Roughnesses from which the fit begins: from one alone it misses lobes of another width."""

_SCATTER = 0.05
"""Standard deviation of ln(cos f) up to which lobes are expected to describe a point, beside the noise."""

_LEAST_SCATTER = 0.003
"""The same where all points agree with a lobe."""

_FIRST_STEPS, _MOST_STEPS = 6, 25
"""Of the fit, from each of several starts, and from the best of them on."""

_MOST_BUMPS = 3

_BUMP_WIDTHS = (0.3, 1.0, 3.0, 10.0)
"""Half widths from which the fit of a bump begins, degrees."""

_NEAR = 3.0
"""Degrees of the half vector by which a bump's centre may leave the point that gave rise to it."""

_WORTH = 10.0
"""By how much another bump must reduce half the sum of squared, normalised residuals."""

_DOUBT = np.array([1.0, 0.3, 0.7, 1.0, 0.3, 1.0, 0.3])
"""How far the logarithms of height and roughness, the exponent, the logarithm of the constant, the tilt in degrees, and
the logarithms of height and width of the retro-reflection may be from the fit: wide enough that the points decide,
narrow enough that a derivative describes it."""

_DOUBT_OF_BUMP = np.array([0.7, 0.3, 0.3, 0.5])
"""The same of a bump's height, centre (in its widths), width and exponent."""

_LOWEST = np.array([-25.0, np.log(0.002), 1.2, -25.0, -_LARGEST_TILT, -25.0, np.log(2.0)])
_HIGHEST = np.array([25.0, np.log(1.5), 6.0, 5.0, _LARGEST_TILT, 5.0, np.log(15.0)])
_MAIN = _LOWEST.size
_LOWEST_BUMP = np.array([-25.0, -85.0, np.log(NARROWEST), np.log(1.5)])
_HIGHEST_BUMP = np.array([25.0, 85.0, np.log(30.0), np.log(30.0)])


@dataclass(frozen=True)
class Bump:
    """A further lobe anywhere: exp(log_height) (1 + (2^(1/k) - 1) (theta_h - centre)^2 / width^2)^-k, k = exponent."""

    log_height: float
    """Logarithm of its peak, as of the main lobe's, 1/sr."""
    centre: float
    """Half vector angle, degrees from the main lobe's."""
    width: float
    """From its peak to its half, degrees."""
    exponent: float
    """Of its tail: 2 as GGX, 30 as good as a Gaussian."""


@dataclass(frozen=True)
class Lobe:
    """A lobe around the mirror direction, a constant, a retro-reflection, and perhaps bumps.

    f = D G / (4 cos_i cos_o) + exp(log_floor) + exp(log_retro) (1 + (2^(1/4) - 1) theta_d^2 / retro_width^2)^-4.

    D = exp(log_height) (1 + tan^2(theta_h) / alpha^2)^-gamma / cos^4(theta_h) + bumps, which is GGX for gamma = 2
    (Walter et al. 2007, Eq. 33; with a free exponent: Ribardiere et al. 2017). G is Smith's masking of GGX
    (Walter et al. 2007, Eq. 34) for both directions.
    """

    log_height: float
    """Logarithm of the peak of D, 1/sr."""
    alpha: float
    """Roughness, the tangent of an angle."""
    gamma: float
    """Exponent of the tail."""
    log_floor: float
    """Logarithm of a constant BRDF, 1/sr."""
    tilt: float
    """Angle of the half vector at which D has its peak, degrees: the surface normal as the stages see it."""
    bumps: tuple[Bump, ...] = ()
    log_retro: float = -25.0
    """Logarithm of the peak of the retro-reflection, 1/sr."""
    retro_width: float = 8.0
    """Its angle theta_d = (theta_out + theta_in) / 2 from its peak to its half, degrees."""

    @property
    def half_width(self) -> float:
        """Half vector angle from the peak of D to its half, degrees."""
        return float(np.degrees(np.arctan(self.alpha * np.sqrt(2 ** (1 / self.gamma) - 1))))

    def cosine_brdf(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """cos(theta_in) f, any one shape, of signed in-plane angles in degrees."""
        return _cosine_brdf(self._parameters(), theta_in, theta_out)

    def doubt(self, theta_in: FloatArray, theta_out: FloatArray, offset: float) -> FloatArray:
        """[points, parameters] change of ln(offset + cos f) when one parameter is off by what it may be off."""
        parameters = self._parameters()
        steps = np.concatenate([_DOUBT, *[_DOUBT_OF_BUMP * [1, bump.width, 1, 1] for bump in self.bumps]])
        level = offset + _cosine_brdf(parameters, theta_in, theta_out)
        changes = []
        for i, step in enumerate(steps):
            moved = parameters.copy()
            moved[i] += 0.01 * step
            changes.append((_cosine_brdf(moved, theta_in, theta_out) / level + offset / level - 1) / 0.01)
        return np.stack(changes, axis=1)

    def _parameters(self) -> FloatArray:
        parameters = [self.log_height, np.log(self.alpha), self.gamma, self.log_floor, self.tilt]
        parameters += [self.log_retro, np.log(self.retro_width)]
        for bump in self.bumps:
            parameters += [bump.log_height, bump.centre, np.log(bump.width), np.log(bump.exponent)]
        return np.array(parameters)


def _cosine_brdf(parameters: FloatArray, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    log_height, log_alpha, gamma, log_floor, tilt, log_retro, log_retro_width = parameters[:_MAIN]
    alpha2 = np.exp(2 * log_alpha)
    cos_in = np.cos(np.radians(theta_in))
    half = (theta_out - theta_in) / 2 - tilt
    radians = np.radians(half)
    D = np.exp(log_height) * (1 + np.tan(radians) ** 2 / alpha2) ** -gamma / np.cos(radians) ** 4
    for height, centre, log_width, log_exponent in parameters[_MAIN:].reshape(-1, 4):
        exponent = np.exp(log_exponent)
        away = ((half - centre) / np.exp(log_width)) ** 2
        D = D + np.exp(height) * (1 + (2 ** (1 / exponent) - 1) * away) ** -exponent
    away = ((theta_out + theta_in) / 2 / np.exp(log_retro_width)) ** 2
    diffuse = np.exp(log_floor) + np.exp(log_retro) * (1 + (2**0.25 - 1) * away) ** -4.0
    return np.asarray(D * _per_height(theta_in, theta_out, alpha2) + diffuse * cos_in)


def _slopes(parameters: FloatArray, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """[points, parameters] derivatives of `_cosine_brdf`."""
    log_height, log_alpha, gamma, log_floor, tilt, log_retro, log_retro_width = parameters[:_MAIN]
    alpha2 = np.exp(2 * log_alpha)
    cos_in, cos_out = np.cos(np.radians(theta_in)), np.cos(np.radians(theta_out))
    half = (theta_out - theta_in) / 2 - tilt
    tangent = np.tan(np.radians(half))
    q = tangent**2 / alpha2
    D = np.exp(log_height) * (1 + q) ** -gamma * (1 + tangent**2) ** 2
    by_tilt = np.radians(D * (2 * gamma * tangent * (1 + tangent**2) / (alpha2 * (1 + q)) - 4 * tangent))
    total, of_bumps = D, []
    for height, centre, log_width, log_exponent in parameters[_MAIN:].reshape(-1, 4):
        width, exponent = np.exp(log_width), np.exp(log_exponent)
        power = 2 ** (1 / exponent)
        away = ((half - centre) / width) ** 2
        tail = 1 + (power - 1) * away
        bump = np.exp(height) * tail**-exponent
        by_away = -exponent * (power - 1) * bump / tail
        by_centre = -2 * (half - centre) / width**2 * by_away
        by_exponent = bump * (power * np.log(2) * away / tail - exponent * np.log(tail))
        of_bumps += [bump, by_centre, -2 * away * by_away, by_exponent]
        by_tilt = by_tilt + by_centre
        total = total + bump
    per_height = _per_height(theta_in, theta_out, alpha2)
    masked = np.zeros_like(total)
    for cosine in (cos_in, cos_out):
        beyond = alpha2 * (1 / cosine**2 - 1)
        root = np.sqrt(1 + beyond)
        masked = masked - beyond / (root * (1 + root))
    away = ((theta_out + theta_in) / 2 / np.exp(log_retro_width)) ** 2
    tail = 1 + (2**0.25 - 1) * away
    retro = np.exp(log_retro) * tail**-4.0 * cos_in
    main = [D, 2 * gamma * D * q / (1 + q) + total * masked, -D * np.log1p(q)]
    columns = [per_height * each for each in main]
    columns += [np.exp(log_floor) * cos_in, per_height * by_tilt, retro, 8 * retro * (1 - 1 / tail)]
    return np.stack([*columns, *(per_height * each for each in of_bumps)], axis=1)


def _per_height(theta_in: FloatArray, theta_out: FloatArray, alpha2: float) -> FloatArray:
    """cos(theta_in) f for D = 1."""
    cos_in, cos_out = np.cos(np.radians(theta_in)), np.cos(np.radians(theta_out))
    return np.asarray(_smith(cos_in, alpha2) * _smith(cos_out, alpha2) / (4 * cos_out))


def _smith(cosine: FloatArray, alpha2: float) -> FloatArray:
    return np.asarray(2 / (1 + np.sqrt(1 + alpha2 * (1 / cosine**2 - 1))))


def fit_lobe(
    theta_in: FloatArray,
    theta_out: FloatArray,
    latent: FloatArray,
    noise: FloatArray,
    offset: float,
    begin: Lobe | None = None,
) -> Lobe:
    """The lobes that describe most points, of all incident angles at once, [points] each; angles in degrees.

    `latent` is ln(offset + cos(theta_in) f), `noise` its standard uncertainty. Points that the main lobe cannot
    describe count little (soft L1 loss), so a second lobe does not spoil the first; then a bump is put where the
    brightest of them is, as long as that explains much. Each time a few steps are taken from several starts, and the
    best of them is followed to its end; from lobes to `begin` with, where somebody has them, there is one start.
    """

    def fitted(starts: list[FloatArray], scatter: float, fixed: int = 0) -> tuple[FloatArray, float]:
        """The best parameters and their cost, the first `fixed` parameters, the same in all starts, as they are."""
        scale = np.hypot(noise, scatter)
        bumps = (starts[0].size - _MAIN) // 4
        low = np.concatenate([_LOWEST, *[_LOWEST_BUMP] * bumps])
        high = np.concatenate([_HIGHEST, *[_HIGHEST_BUMP] * bumps])
        within = np.clip(starts, low, high)
        kept = within[0, :fixed]
        if fixed:
            low[-3], high[-3] = within[0, -3] - _NEAR, within[0, -3] + _NEAR

        def residuals(free: FloatArray) -> FloatArray:
            model = _cosine_brdf(np.concatenate([kept, free]), theta_in, theta_out)
            return np.asarray((np.log(offset + model) - latent) / scale)

        def slopes(free: FloatArray) -> FloatArray:
            every = np.concatenate([kept, free])
            level = (offset + _cosine_brdf(every, theta_in, theta_out)) * scale
            return np.asarray(_slopes(every, theta_in, theta_out)[:, fixed:] / level[:, None])

        def followed(free: FloatArray, steps: int) -> Any:
            limits = low[fixed:], high[fixed:]
            return scipy.optimize.least_squares(residuals, free, slopes, bounds=limits, loss="soft_l1", max_nfev=steps)

        ways = [start[fixed:] for start in within]
        if len(ways) > 1:
            ways = [min((followed(way, _FIRST_STEPS) for way in ways), key=lambda found: found.cost).x]
        found = followed(ways[0], _MOST_STEPS)
        return np.concatenate([kept, found.x]), float(found.cost)

    if begin is None:
        near = np.argmin(np.abs(theta_out - theta_in))
        height = latent[near] + np.log(4 * np.cos(np.radians(theta_out[near])))
        floor = float(np.quantile(latent, 0.2))
        others = 2.0, floor, 0.0, floor - 1.5, np.log(6.0)
        starts = [np.array([height, np.log(alpha), *others]) for alpha in _STARTS]
    else:
        starts = [begin._parameters()]
    best, _ = fitted(starts, _SCATTER)
    while best.size < _MAIN + 4 * _MOST_BUMPS:
        above = latent - np.log(offset + _cosine_brdf(best, theta_in, theta_out))
        scatter = float(np.clip(1.48 * np.median(np.abs(above)), _LEAST_SCATTER, _SCATTER))
        top = int(np.argmax(above / np.hypot(noise, scatter)))
        if latent.size < best.size + 6 or above[top] <= 0:
            break
        missing = np.exp(latent[top]) * (1 - np.exp(-above[top]))
        missing /= _per_height(theta_in[top], theta_out[top], float(np.exp(2 * best[1])))
        centre = (theta_out[top] - theta_in[top]) / 2 - best[4]
        starts = [np.array([*best, np.log(missing), centre, np.log(width), np.log(4.0)]) for width in _BUMP_WIDTHS]
        _, before = fitted([best], scatter)
        alone, _ = fitted(starts, scatter, fixed=best.size)
        better, cost = fitted([alone], scatter)
        if before - cost < _WORTH:
            break
        best = better
    bumps = tuple(
        Bump(float(height), float(centre), float(np.exp(width)), float(np.exp(exponent)))
        for height, centre, width, exponent in best[_MAIN:].reshape(-1, 4)
    )
    return Lobe(
        log_height=float(best[0]),
        alpha=float(np.exp(best[1])),
        gamma=float(best[2]),
        log_floor=float(best[3]),
        tilt=float(best[4]),
        bumps=bumps,
        log_retro=float(best[5]),
        retro_width=float(np.exp(best[6])),
    )
