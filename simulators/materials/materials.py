"""What can lie on the simulated bench, and the BRDF that an ideal detector would see of it."""

import datetime
import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from analysis.reflectance.directions import Aperture, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe
from analysis.reflectance.fresnel import Conductor, fresnel_conductor, load_conductor
from analysis.reflectance.models import cosine_slope, theta_m
from drivers.arrays import FloatArray
from goniometer.campaigns.material_file import material_file
from goniometer.certificates.certificate import NOMINAL_SRS99, Certificate
from simulators.errors import UnknownMaterial
from simulators.materials.surfaces import (
    PATCHES,
    SANDBLASTED,
    SANDED,
    Surface,
    colorchecker_patch,
    over_aperture,
    surface_brdf,
)
from simulators.materials.tabulated import Tabulated, tabulated_brdf
from simulators.materials.tabulated_file import read_tabulated

DETECTOR_APERTURE = 1.0
"""Full angle of the detector's round aperture, degrees."""

_LONGEST_WAVELENGTH = 1100.0
"""How far the bench carries a conductor beyond the end of its table, nm; the detector ends near 1050 nm."""

_NARROW = 0.05
"""GGX roughness below which a lobe is narrow against the aperture."""

_AT_ONCE = 64
"""Points that are computed together: as many as keep the arrays within a processor's cache."""


@dataclass(frozen=True)
class Material:
    """A sandblasted disc of aluminium: GGX microfacets times the diffraction shift (paper Eq. 7)."""

    name: str
    alpha: float
    """GGX roughness, averaged over the disc."""
    h: float
    """Amplitude of the slope of the shift (Eq. 5), 1/um; 0 = no shift."""
    w: float
    """Angular frequency of the slope (Eq. 5), a pure number."""
    roughness_rms_um: float
    """Height rms by confocal microscope (paper, Table 1), um."""
    abrasive_um: tuple[float, float] | None
    """Smallest and largest diameter of the abrasive beads (Table 1), um; None for the polished disc."""
    diameter_mm: float = 50.0
    """Of the disc, mm."""
    alpha_swing: float = 0.0
    """How far the roughness departs from `alpha` over the disc; 0 = homogeneous."""

    def alpha_at(self, spot: int) -> float:
        """GGX roughness where the detector looks: `spot` 0 is the first place, 1 is another, and so on."""
        return self.alpha + self.alpha_swing * math.sin(math.radians(65.0 * spot - 28.0))


@dataclass(frozen=True)
class Panel:
    """A white reference panel."""

    name: str
    certificate: Certificate
    """Its 8-degree/hemispherical reflectance as certified; a bench may have a panel that departs from it."""
    diameter_mm: float = 50.0
    """Of the panel, mm."""


@dataclass(frozen=True)
class Embossed:
    """A diffuse sheet, of the same reflectance at all wavelengths, into which facets of one tilt are embossed.

    The facets point in all azimuths, so each incident angle has a narrow lobe on either side of the mirror direction,
    where the half vector is tilted as they are: light that no rough surface sends there.
    """

    name: str
    reflectance: float
    """Of the sheet, diffuse: the BRDF is this over pi."""
    tilt: float
    """Of the facets, degrees: their lobes lie at theta_in + 2 tilt and theta_in - 2 tilt."""
    width: float
    """Full width at half maximum of a lobe, degrees of theta_out."""
    height: float
    """BRDF at the top of a lobe, 1/sr."""
    diameter_mm: float = 50.0
    """Of the sheet, mm."""


@dataclass(frozen=True)
class Emitter:
    """What sends back none of the bench's light, and shines by itself or not at all."""

    name: str
    lines: tuple[tuple[float, float], ...]
    """Wavelength in air, nm, and strength of each emission line: counts a second, all pixels of the line together."""


Mountable = Material | Surface | Panel | Embossed | Emitter | Tabulated

_COUPON = Material("coupon", 0.180, 1.2, 3.4, 0.98, (70, 100), diameter_mm=15.0)

SAMPLES = {
    sample.name: sample
    for sample in (
        Material("sample-1", 0.364, 1.6, 2.3, 2.39, (70, 100)),
        Material("sample-2", 0.280, 1.5, 2.6, 1.76, (70, 100)),
        Material("sample-3", 0.209, 1.35, 3.0, 1.20, (70, 100)),
        Material("sample-4", 0.180, 1.2, 3.4, 0.98, (70, 100)),
        Material("sample-5", 0.113, 0.9, 4.5, 0.52, (70, 100)),
        Material("sample-6", 0.0045, 0.0, 0.0, 0.10, None),
        Material("sample-7", 0.275, 1.2, 3.0, 0.66, (35, 35), alpha_swing=0.075),
        Material("sample-8", 0.100, 0.8, 4.8, 0.43, (70, 100)),
        _COUPON,
    )
}
"""The paper's Samples 1 to 8, of which 6 is the mirror and 7 is inhomogeneous, and a small coupon made as Sample 4.

Roughness and abrasive are the paper's (Table 1), alpha was fitted to its measurements; h and w are chosen so
that the slopes are about as large as the paper's, and are not measurements. The coupon is so small that the detector
looks past it beyond 80 degrees.
"""

PANEL_CERTIFICATE = replace(
    NOMINAL_SRS99,
    serial_number="SIM-SRS-99-01",
    calibrated=datetime.date(2024, 1, 15),
    valid_until=datetime.date(2099, 12, 31),
)
"""What came with the white panel of the simulated bench."""

SPECTRALON = Panel("spectralon", PANEL_CERTIFICATE)
"""The white reference that the simulated bench owns."""

_LINE_STRENGTH = 1e6
"""Counts a second of a line of relative strength 1: about 50,000 in its brightest pixel after 0.1 s."""

EMBOSSED = Embossed("embossed", reflectance=0.5, tilt=11.8, width=1.0, height=2.0)
"""A sheet whose lobes lie where few would look for them."""

MERCURY_ARGON = Emitter(
    "mercury-argon",
    tuple(
        (wavelength, strength * _LINE_STRENGTH)
        for wavelength, strength in (
            # mercury
            (253.6517, 0.80), (296.7280, 0.08), (302.1498, 0.04), (312.5668, 0.09), (313.1548, 0.07), (313.1839, 0.07),
            (334.148, 0.03), (365.0153, 0.40), (365.4836, 0.06), (366.3279, 0.04), (404.6563, 0.45), (407.7837, 0.03),
            (435.8328, 1.00), (546.0735, 1.00), (576.9598, 0.25), (579.0663, 0.27),
            # argon
            (696.5431, 0.30), (706.7218, 0.14), (727.2936, 0.07), (738.3980, 0.17), (750.3869, 0.30), (751.4652, 0.16),
            (763.5106, 0.55), (772.3761, 0.13), (772.4207, 0.11), (794.8176, 0.16), (800.6157, 0.12), (801.4786, 0.16),
            (810.3693, 0.19), (811.5311, 0.45), (826.4522, 0.19), (840.8210, 0.18), (842.4648, 0.26), (852.1442, 0.08),
            (912.2967, 0.22), (922.4499, 0.06), (965.7786, 0.05),
        )
    ),
)  # fmt: skip
"""A calibration lamp that stands in for the sample.

Wavelengths in air: Sansonetti & Martin, Handbook of Basic Atomic Spectroscopic Data (NIST, J. Phys. Chem. Ref. Data 34
(2005), 1559); they are rounded where the table has more digits, and lines too weak to be seen are left out. Strengths
are our judgement of what a pencil lamp looks like through fibre and grating; no two lamps agree about them.
"""

NOTHING = Emitter("nothing", ())
"""An empty stage: what is left is stray light."""

_ALIASES = {"mirror": "sample-6"}


def material(name: str) -> Mountable:
    """What is called `name`: a key of `SAMPLES`, "mirror" for Sample 6, or the name of one of the others.

    These are those of `simulators.materials.surfaces.SANDBLASTED` and `SANDED`, "colorchecker-1" to "colorchecker-24",
    "spectralon", "embossed", "mercury-argon" and "nothing"; "file:PATH" is one of `simulators.materials.tabulated`.

    Raises `UnknownMaterial`, which lists what there is, and for a file that is not the one that its name means;
    `UnfitTable` for a file that holds no material.
    """
    file = material_file(name)
    if file is not None:
        table = read_tabulated(file.path)
        if file.content is not None and file.content.sha256 != table.sha256:
            raise UnknownMaterial(
                f"{file.path}: the material is not the one that the campaign began with; put that file back, or give "
                f"the campaign another name."
            )
        return table
    others: tuple[Mountable, ...] = (SPECTRALON, EMBOSSED, MERCURY_ARGON, NOTHING)
    known: dict[str, Mountable] = {**SAMPLES, **SANDBLASTED, **SANDED, **{other.name: other for other in others}}
    found = known.get(_ALIASES.get(name, name))
    if found is not None:
        return found
    patches = {f"colorchecker-{number}": number for number in range(1, PATCHES + 1)}
    if name in patches:
        return colorchecker_patch(patches[name])
    names = [*known, *_ALIASES, f"colorchecker-1 to colorchecker-{PATCHES}", "file:PATH"]
    raise UnknownMaterial(f"The simulated bench has no material '{name}'; it has {', '.join(names)}")


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
def _aperture(full_angle: float, narrow: bool) -> Aperture:
    """The cheapest rule over a disc of `full_angle` degrees that is exact enough for a lobe, narrow or not.

    The mirror's lobe is 0.1 degrees narrow sideways at grazing incidence; for it the relative error is below 3e-7 up to
    80 degrees and 4e-4 at 85, where the default rule of `round_aperture` errs by 15 and 50 per cent. That one errs by
    less than 1e-7 for all others.
    """
    if full_angle == 0:
        return round_aperture(0.0, rings=1, spokes=1)
    return round_aperture(full_angle, rings=24, spokes=96) if narrow else round_aperture(full_angle)


def true_brdf(
    what: Mountable,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    aperture: float = DETECTOR_APERTURE,
    spot: int = 0,
) -> FloatArray:
    """BRDF averaged over the detector aperture, without any noise, [points, wavelengths], 1/sr.

    `theta_in`, `theta_out` [points] in degrees, signed as in `goniometer.geometry`; zero below the horizon.
    `wavelengths` in nm. `aperture` is the full angle, degrees, 0 for a detector that is a point; `spot` says where on
    an inhomogeneous sample it looks. The panel is what its certificate says, at the centre of the aperture, over which
    it hardly changes; a table that is an average over an aperture is taken as it is, whatever `aperture` says. Raises
    `OutOfRange` or `CertificateError` where the material has no data, and `UnknownMaterial` for a lamp, which has no
    BRDF.
    """
    value = np.zeros((theta_in.size, wavelengths.size))
    above = np.flatnonzero((np.abs(theta_in) < 90) & (np.abs(theta_out) < 90))
    if isinstance(what, Emitter):
        if what.lines:
            raise UnknownMaterial(f"'{what.name}' shines by itself and has no BRDF; mount a sample or the panel")
    elif isinstance(what, Panel):
        # The formula jumps where theta_in changes sign, which no real panel does: a stage that stands at -0.004 degrees
        # instead of 0 must not exchange forward and back.
        value[above] = what.certificate.brdf(np.abs(theta_in[above]), theta_out[above], wavelengths)
    elif isinstance(what, Embossed):
        value[above] = _embossed(what, theta_in[above], theta_out[above], _aperture(aperture, False))[:, None]
    elif isinstance(what, Tabulated):
        disc = _aperture(aperture, False) if aperture > 0 else None
        for start in range(0, above.size, _AT_ONCE):
            some = above[start : start + _AT_ONCE]
            value[some] = tabulated_brdf(what, theta_in[some], theta_out[some], wavelengths, disc)
    else:
        alpha = what.alpha if isinstance(what, Surface) else what.alpha_at(spot)
        index = aluminium_beyond_its_table().index(wavelengths)
        rule = _aperture(aperture, alpha < _NARROW)
        for start in range(0, above.size, _AT_ONCE):
            some = above[start : start + _AT_ONCE]
            if isinstance(what, Surface):
                value[some] = surface_brdf(what, theta_in[some], theta_out[some], wavelengths, index, rule)
            else:
                value[some] = _metal(what, alpha, theta_in[some], theta_out[some], wavelengths, index, rule)
    return value


def _embossed(sheet: Embossed, theta_in: FloatArray, theta_out: FloatArray, aperture: Aperture) -> FloatArray:
    """[points] of the sheet; a lobe is a Gaussian in the tilt of the half vector within the plane, and as wide across
    it as the aperture sees."""
    half = np.abs(theta_out[:, None] + aperture.along - theta_in[:, None]) / 2
    lobe = np.exp(-4 * np.log(2) * ((half - sheet.tilt) / (sheet.width / 2)) ** 2)
    return np.asarray((sheet.reflectance / np.pi + sheet.height * lobe) @ aperture.weights)


def _metal(
    metal: Material,
    alpha: float,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    index: tuple[FloatArray, FloatArray],
    aperture: Aperture,
) -> FloatArray:
    """[points, wavelengths] sum over aperture nodes of weight x lobe x Fresnel x shift.

    The presets never clamp the shift: their |m| stays below 2.2 /um.
    """
    directions = through_aperture(theta_in, theta_out, aperture)
    slope = cosine_slope(theta_m(directions), metal.h, metal.w)
    weight = lobe(directions, alpha) * aperture.weights
    return over_aperture(directions, weight, slope, lambda cosine: fresnel_conductor(cosine, *index), wavelengths)
