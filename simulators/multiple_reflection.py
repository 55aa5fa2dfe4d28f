"""Light that is reflected more than once, from rays, added to what waves say of light that is reflected once.

    f = f_wave V + f_2 (1 + m_2 (lambda - 600 nm))

f_wave is the diffracted BRDF, in which all light leaves after one reflection. V(theta_in, theta_out) is the share of
the light going to theta_out after its first reflection that does leave, found with rays. f_2 is the BRDF of rays that
were reflected twice or more often. Both come from a surface without roughness below the wavelength, where there are no
rays.

What is assumed: diffraction at the first reflection changes how much light of each wavelength meets the surface again,
and nothing more. Light of short and of long waves that meets it again goes the same ways thereafter, so that all higher
orders have one shift. With P(lambda) the share that meets it again,

    P = (integral over theta_out > 90 degrees of J + integral over all others of J (1 - V)) / integral of J,

the slope is that of a straight line through P, m_2 = P' / P at 600 nm: what single reflection loses at each wavelength
is what multiple reflection gets, and the colour of all light together is kept. J is the radiant intensity of the
Kirchhoff approximation, (|q|^2 / q_z)^2 |I|^2 / (4 cos_i lambda^2), which goes on below the horizon, where light leads
from a steep facet down to its neighbour. Only the plane of incidence is computed; the integrals take J as the same on
rings around the mirror direction, and end `_GRAZING` before the facets that the light just grazes.
"""

from dataclasses import dataclass, fields

import numpy as np

from analysis.fresnel import fresnel_conductor
from analysis.models import LAMBDA_N
from drivers.arrays import FloatArray
from simulators.heights import HeightField
from simulators.rays import beam, terrain, trace, virtual_scan
from simulators.surfaces import Reflectance
from simulators.wave_scan import Setup
from simulators.waves import Averaged

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


def lowest_kz(setup: Setup) -> float:
    """kz down to which the average over a patch is needed for P, 1/um."""
    longest = setup.wavelengths[-1:]
    return min(float(_vectors(angle, _around(angle), longest)[1].min()) for angle in np.unique(setup.theta_in))


def multiply_reflected(field: HeightField, mean: Averaged, setup: Setup, seed: int, rays: int = RAYS) -> Multiple:
    """Trace `rays` on `field` for each incident angle of `setup`, see the module.

    `mean` is the patch as waves see it, down to `lowest_kz`. Raises as `simulators.rays.virtual_scan`.
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
    theta_out = _around(theta_in)
    kx, kz = _vectors(theta_in, theta_out, setup.wavelengths)
    sizes = setup.coherence.size(setup.wavelengths)
    square = np.stack(
        [mean.spectrum.mean_square(kx[:, i], kz[:, i], float(size)) for i, size in enumerate(sizes)], axis=1
    )
    intensity = ((kx**2 + kz**2) / kz) ** 2 * square  # up to a factor of the incident angle
    ring = np.abs(np.sin(np.radians(theta_out - theta_in)))
    leaves = np.where(theta_out < 90, np.interp(theta_out, wedges, share), 0.0)
    return np.asarray((ring * (1 - leaves)) @ intensity / (ring @ intensity))


def _around(theta_in: float) -> FloatArray:
    """Reflected angles, below the horizon too, in degrees."""
    return np.arange(-89.5, 180 - theta_in - _GRAZING, 1.0)


def _vectors(theta_in: float, theta_out: FloatArray, wavelengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """kx and kz [angles, wavelengths] in 1/um; as `simulators.waves.scattering_vectors`, but below the horizon, too."""
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
