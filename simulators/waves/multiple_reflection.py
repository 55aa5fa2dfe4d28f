"""Light that is reflected more than once, from rays, added to what waves say of light that is reflected once.

    f = f_wave V + f_2 (1 + m_2 (lambda - 600 nm))

f_wave is the diffracted BRDF, in which all light leaves after one reflection. V(theta_in, theta_out) is the share of
the light going to theta_out after its first reflection that does leave, found with rays. f_2 is the BRDF of rays that
were reflected twice or more often. Both come from a surface without roughness below the wavelength, where there are no
rays.

What is assumed: diffraction at the first reflection changes how much light of each wavelength meets the surface again,
and nothing more. Light of short and of long waves that meets it again goes the same ways thereafter, so that all higher
orders have one shift. With P(lambda) the share that meets it again the slope is that of a straight line through P,
m_2 = P' / P at 600 nm: what single reflection loses at each wavelength is what multiple reflection gets, and the colour
of all light together is kept.

    P = integral of D (1 - V) (i . h) dω_h / integral of D (i . h) dω_h,   V = 0 below the horizon

D is what the Kirchhoff approximation has in place of a distribution of normals h, (|q|^2 / q_z)^2 |I|^2 / lambda^2 but
for a constant; it goes on below the horizon, where a steep facet sends light down to its neighbour. Only the plane of
incidence is computed: out of it, at the azimuth psi of h, D is taken as (1 + cos psi) / 2 of that at the same angle
before the normal and (1 - cos psi) / 2 of that behind it. V out of the plane is taken from the same zenith angle in it.
"""

from dataclasses import dataclass, fields

import numpy as np

from analysis.reflectance.fresnel import fresnel_conductor
from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import FloatArray
from simulators.materials.surfaces import Reflectance
from simulators.rays.rays import beam, terrain, trace, virtual_scan
from simulators.topographies.heights import HeightField
from simulators.waves.scan import Setup
from simulators.waves.waves import Averaged

RAYS = 2**16
"""Per patch and incident angle, unless said otherwise."""

APERTURE = 5.0
"""Degrees over which light that was reflected more than once is collected: it has no narrow features."""

_WEDGE, _STEP = 10.0, 5.0
"""Half angle around the plane and step within it, degrees, over which V is averaged."""

_OUTERMOST = 89.9 - APERTURE / 2
"""Degrees up to which the whole aperture is above the horizon; beyond, the value there is taken."""

_GRAZING = 8.0
"""Degrees; a facet that the light grazes sends it straight on, where the window's own lobe is."""

_TILTS, _SPOKES = np.arange(0.25, 60, 0.5), 36
"""Angles of normals to the vertical, degrees, and number of azimuths on one side of the plane."""

_NONE = 1e-9
"""Share of the light that counts as none."""


@dataclass(frozen=True)
class Multiple:
    """What rays say of one patch, and waves of the light that meets it again; points as in the set-up of the waves."""

    leaves: FloatArray
    """[points] V, share of the light going there after its first reflection that leaves the surface."""
    brdf: FloatArray
    """[points, wavelengths] of light that was reflected twice or more often, 1/sr, without any shift."""
    again: FloatArray
    """[incident angles, wavelengths] P, share of the light that meets the surface again; angles ascend."""
    again_by_rays: FloatArray
    """[incident angles] the same by geometric optics."""
    lost: float
    """Largest share of the rays, of all incident angles, that left a finite patch through its side."""


def kz_reach(setup: Setup) -> tuple[float, float]:
    """Smallest and largest kz for which the average over a patch is needed for P, 1/um."""
    ends = setup.wavelengths[[0, -1]]
    kz = np.stack(
        [_vectors(angle, _seen_from(angle, side), ends)[1] for angle in np.unique(setup.theta_in) for side in (1, -1)]
    )
    return float(kz.min()), float(kz.max())


def multiply_reflected(field: HeightField, mean: Averaged, setup: Setup, seed: int, rays: int = RAYS) -> Multiple:
    """Trace `rays` on `field` for each incident angle of `setup`, see the module.

    `mean` is the patch as waves see it, within `kz_reach`. Raises as `simulators.rays.rays.virtual_scan`.
    """
    angles = np.unique(setup.theta_in)
    leaves, brdf = np.ones(setup.theta_in.size), np.empty((setup.theta_in.size, setup.wavelengths.size))
    again, by_rays, lost = np.empty((angles.size, setup.wavelengths.size)), np.empty(angles.size), 0.0
    for number, theta_in in enumerate(angles):
        here = setup.theta_in == theta_in
        own = seed * 1000 + number
        looking = np.clip(setup.theta_out[here], -_OUTERMOST, _OUTERMOST)
        scan = virtual_scan(field, float(theta_in), looking, _reflectance(setup), rays, own, APERTURE)
        brdf[here] = scan.brdf[:, 1:].sum(axis=1)
        wedges, share = _leaves(field, float(theta_in), rays, own)
        leaves[here] = np.interp(setup.theta_out[here], wedges, share)
        again[number] = _again(mean, setup, float(theta_in), wedges, share)
        by_rays[number] = 1 - scan.escaped[:2].sum() - scan.lost
        lost = max(lost, scan.lost)
    return Multiple(leaves, brdf, again, by_rays, lost)


def mean_of(patches: list[Multiple]) -> Multiple:
    """The mean of several patches."""
    values = (np.mean([getattr(patch, each.name) for patch in patches], axis=0) for each in fields(Multiple))
    return Multiple(*values)


def shift_of_multiple(again: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[incident angles] m_2 in 1/um, from P [incident angles, wavelengths]; zero where nothing meets the surface again.

    >>> shift_of_multiple(np.array([[0.011, 0.010, 0.009]]), np.array([500.0, 600.0, 700.0])).round(3)
    array([-1.])
    """
    slope, level = np.polyfit(1e-3 * (wavelengths - LAMBDA_N), again.T, 1)
    return np.where(level > _NONE, slope / np.maximum(level, _NONE), 0.0)


def combined(
    wave: FloatArray, leaves: FloatArray, higher: FloatArray, slope: FloatArray, wavelengths: FloatArray
) -> FloatArray:
    """[points, wavelengths] f of the module's equation, 1/sr, from f_wave, V, f_2 and m_2 [points] in 1/um.

    A shift that would be negative is none.
    """
    shift = np.maximum(1 + slope[:, None] * 1e-3 * (wavelengths - LAMBDA_N), 0)
    return np.asarray(wave * leaves[:, None] + higher * shift)


def _leaves(field: HeightField, theta_in: float, rays: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Middles of the wedges of `_STEP` to which light goes after its first reflection, degrees, and V in each."""
    surface = terrain(field)
    paths = trace(surface, *beam(surface, theta_in, rays, seed), limit=1)
    x, y, z = paths.directions.T
    near = ~paths.lost & (np.abs(y) <= np.sin(np.radians(_WEDGE))) & (z > 0)
    wedge = np.floor((np.degrees(np.arctan2(x, z)) + 90) / _STEP).astype(int)
    count = round(180 / _STEP)
    met, left = (np.bincount(wedge[which], minlength=count)[:count] for which in (near, near & paths.escaped))
    some = met > 0
    middle = np.linspace(-90 + _STEP / 2, 90 - _STEP / 2, count)
    return middle[some], np.asarray(left[some] / met[some])


def _again(mean: Averaged, setup: Setup, theta_in: float, wedges: FloatArray, share: FloatArray) -> FloatArray:
    """[wavelengths] P of one incident angle, from V in `wedges`."""
    before, behind = (_normals(mean, setup, theta_in, side) for side in (1, -1))
    psi = np.radians(180 * (np.arange(_SPOKES) + 0.5) / _SPOKES)
    theta, tilt = np.radians(theta_in), np.radians(_TILTS)[:, None]
    cos_d = np.cos(theta) * np.cos(tilt) - np.sin(theta) * np.sin(tilt) * np.cos(psi)
    x, z = 2 * cos_d * np.sin(tilt) * np.cos(psi) + np.sin(theta), 2 * cos_d * np.cos(tilt) - np.cos(theta)
    zenith = np.copysign(np.degrees(np.arccos(np.clip(z, -1, 1))), x)
    meets = np.where(z > 0, 1 - np.interp(zenith, wedges, share), 1.0)
    weight = np.sin(tilt) * np.maximum(cos_d, 0)
    known = (theta_in + 2 * _TILTS <= _end(theta_in))[:, None]
    forward = np.where(known, (1 + np.cos(psi)) / 2, 0.0)
    met, whole = (
        (of * forward).sum(axis=1) @ before + (of * (1 - forward)).sum(axis=1) @ behind
        for of in (weight * meets, weight)
    )
    return np.asarray(met / whole)


def _normals(mean: Averaged, setup: Setup, theta_in: float, side: int) -> FloatArray:
    """[tilts, wavelengths] D, up to a factor, of normals tilted towards (1) or from (-1) the mirror's side."""
    kx, kz = _vectors(theta_in, _seen_from(theta_in, side), setup.wavelengths)
    sizes = setup.coherence.size(setup.wavelengths)
    square = [mean.spectrum.mean_square(kx[:, i], kz[:, i], float(size)) for i, size in enumerate(sizes)]
    return np.asarray(((kx**2 + kz**2) / kz) ** 2 * np.stack(square, axis=1))


def _seen_from(theta_in: float, side: int) -> FloatArray:
    """[tilts] where such normals send the light, below the horizon too, degrees; no further than `_end`."""
    return np.clip(theta_in + 2 * side * _TILTS, -_end(theta_in), _end(theta_in))


def _end(theta_in: float) -> float:
    """Degrees in the plane, short of the facets that the light grazes."""
    return 180 - theta_in - _GRAZING


def _vectors(theta_in: float, theta_out: FloatArray, wavelengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """kx and kz [angles, wavelengths] in 1/um; as of `waves.scattering_vectors`, but below the horizon, too."""
    k = 2 * np.pi / (1e-3 * wavelengths)
    incident, reflected = np.radians(theta_in), np.radians(theta_out)
    along, up = np.sin(reflected) - np.sin(incident), np.cos(incident) + np.cos(reflected)
    return along[:, None] * k, up[:, None] * k


def _reflectance(setup: Setup) -> Reflectance:
    """Of a facet."""
    if setup.conductor is None:
        return lambda cosine: np.ones(np.broadcast_shapes(cosine.shape, setup.wavelengths.shape))
    n, k = setup.conductor.index(setup.wavelengths)
    return lambda cosine: fresnel_conductor(cosine, n, k)
