"""What can lie on the simulated bench, and the BRDF that an ideal detector would see of it."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from analysis.directions import Aperture, round_aperture, through_aperture
from analysis.fresnel import Conductor, fresnel_conductor, load_conductor
from analysis.models import LAMBDA_N, cosine_slope, ggx_lobe, theta_m
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from goniometer.reference import NOMINAL_SRS99, Certificate, reference_brdf

DETECTOR_APERTURE = 1.0
"""Full angle of the detector's round aperture, degrees."""

_LONGEST_WAVELENGTH = 1100.0
"""How far the bench carries a conductor beyond the end of its table, nm; the detector ends near 1050 nm."""


class UnknownMaterial(InputError):
    """A material that is not in the store room of the bench."""


@dataclass(frozen=True)
class Material:
    """A sandblasted disc of aluminium: GGX microfacets times the diffraction shift (paper Eq. 7)."""

    name: str
    alpha: float
    """GGX roughness."""
    h: float
    """Amplitude of the slope of the shift (Eq. 5), 1/um; 0 = no shift."""
    w: float
    """Angular frequency of the slope (Eq. 5), a pure number."""
    roughness_rms_um: float
    """Height rms by confocal microscope (paper, Table 1), um."""
    pressure_bar: float | None
    """Sandblasting pressure (Table 1), bar; None for the polished disc."""
    distance_mm: float | None
    """Distance of the nozzle (Table 1), mm; None for the polished disc."""
    abrasive_um: tuple[float, float] | None
    """Smallest and largest diameter of the abrasive beads (Table 1), um; None for the polished disc."""


@dataclass(frozen=True)
class Panel:
    """A white reference panel."""

    name: str
    certificate: Certificate
    """The truth about its 8-degree/hemispherical reflectance."""


SAMPLES = {
    sample.name: sample
    for sample in (
        Material("sample-1", 0.364, 1.6, 2.3, 2.39, 6.5, 100, (70, 100)),
        Material("sample-2", 0.280, 1.5, 2.6, 1.76, 4, 100, (70, 100)),
        Material("sample-3", 0.209, 1.35, 3.0, 1.20, 3, 100, (70, 100)),
        Material("sample-4", 0.180, 1.2, 3.4, 0.98, 2, 100, (70, 100)),
        Material("sample-5", 0.113, 0.9, 4.5, 0.52, 1, 100, (70, 100)),
        Material("sample-6", 0.0045, 0.0, 0.0, 0.10, None, None, None),
    )
}
"""The paper's Samples 1 to 6, of which 6 is the mirror.

Roughness and preparation are the paper's (Table 1), alpha was fitted to its measurements; h and w are chosen so
that the slopes are about as large as the paper's, and are not measurements.
"""

SPECTRALON = Panel("spectralon", NOMINAL_SRS99)
"""The white reference that the simulated bench owns."""

_ALIASES = {"mirror": "sample-6"}


def material(name: str) -> Material | Panel:
    """What is called `name`: a key of `SAMPLES`, "mirror" for Sample 6, or "spectralon".

    Raises `UnknownMaterial`, which lists what there is.
    """
    known: dict[str, Material | Panel] = {**SAMPLES, SPECTRALON.name: SPECTRALON}
    found = known.get(_ALIASES.get(name, name))
    if found is None:
        raise UnknownMaterial(f"The simulated bench has no material '{name}'; it has {', '.join([*known, *_ALIASES])}")
    return found


@cache
def aluminium_beyond_its_table() -> Conductor:
    """Aluminium of Cheng et al. whose n and k stay constant from the end of the table (999.87 nm) to 1100 nm.

    Only the bench may do this: its detector reaches 1050 nm and something must shine there. The numbers beyond
    the table are invented, so the analysis leaves these wavelengths out.
    """
    table = load_conductor()
    return Conductor(
        f"{table.name}, held constant beyond {table.wavelengths[-1]:g} nm",
        np.append(table.wavelengths, _LONGEST_WAVELENGTH),
        np.append(table.n, table.n[-1]),
        np.append(table.k, table.k[-1]),
    )


@cache
def _fine_aperture() -> Aperture:
    """A rule fine enough for the mirror, whose lobe is 0.1 degrees narrow sideways at grazing incidence.

    Relative error below 3e-7 up to 80 degrees and 4e-4 at 85; the default rule of `round_aperture` errs there by
    15 and 50 per cent.
    """
    return round_aperture(DETECTOR_APERTURE, rings=24, spokes=96)


def true_brdf(
    what: Material | Panel, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray
) -> FloatArray:
    """BRDF averaged over the detector aperture, without any noise, [points, wavelengths], 1/sr.

    `theta_in`, `theta_out` [points] in degrees, signed as in `goniometer.geometry`; zero below the horizon.
    `wavelengths` in nm; raises `OutOfRange` or `CertificateError` where the material has no data. The panel is
    taken at the centre of the aperture, over which it hardly changes.
    """
    value = np.zeros((theta_in.size, wavelengths.size))
    above = (np.abs(theta_in) < 90) & (np.abs(theta_out) < 90)
    if isinstance(what, Panel):
        # The formula jumps where theta_in changes sign, which no real panel does: a stage that stands at -0.004 degrees
        # instead of 0 must not exchange forward and back.
        value[above] = reference_brdf(np.abs(theta_in[above]), theta_out[above], wavelengths, what.certificate)
        return value
    index = aluminium_beyond_its_table().index(wavelengths)
    for point in np.flatnonzero(above):
        value[point] = _metal(what, theta_in[point : point + 1], theta_out[point : point + 1], wavelengths, index)
    return value


def _metal(
    metal: Material,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    index: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """[wavelengths] of one direction, as the sum over aperture nodes of weight x lobe x Fresnel x shift.

    Within the aperture Fresnel reflectance is a parabola in the cosine of its angle (through three values, to
    1e-7), and the shift is linear in the slope as long as it is not clamped, which the presets never are (|m| stays
    below 2.2 /um). Then all nodes can be summed before the wavelengths enter.
    """
    directions = through_aperture(theta_in, theta_out, _fine_aperture())
    cos_d = directions.cos_d[0]
    weight = ggx_lobe(directions, metal.alpha)[0] * _fine_aperture().weights
    slope = cosine_slope(theta_m(directions)[0], metal.h, metal.w)
    low, high = cos_d.min(), cos_d.max()
    corners = np.array([low, (low + high) / 2, high])
    parabolas = np.stack(
        [
            (cos_d - corners[(j + 1) % 3])
            * (cos_d - corners[(j + 2) % 3])
            / ((corners[j] - corners[(j + 1) % 3]) * (corners[j] - corners[(j + 2) % 3]))
            for j in range(3)
        ]
    )
    level = parabolas @ weight
    tilt = parabolas @ (weight * slope)
    fresnel = fresnel_conductor(corners[:, None], *index)
    return np.asarray(level @ fresnel + (tilt @ fresnel) * (wavelengths - LAMBDA_N) * 1e-3)
