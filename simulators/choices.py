"""What may be chosen of a simulation, by name, and what is usual; loads nothing, see `analysis.choices`."""

from dataclasses import dataclass
from enum import StrEnum

from analysis.choices import Engine

SIZE, PITCH_UM = 1024, 0.5
"""Usual points along each side of a synthesised surface, and their distance, um."""

SIDE_UM = 256.0
"""Usual side of a synthesised patch, um: some hundred dents of the paper's beads."""

STEP_UM = 0.25
"""Usual distance of its points, um, at which the creases between dents are fine enough; splines refine it further."""

FEWEST = 4
"""Patches below which nothing is known of their spread: the variance of Student's distribution is infinite."""

ABOUT = {
    "ordinary": "nothing is difficult",
    "mirror-like": "the lobe is as narrow as the aperture",
    "dim flanks": "low signal away from the specular peak",
    "grazing footprint": "the footprint leaves the sample at grazing angles",
    "blocked retro direction": "a gap towards the lamp, or a peak in it whose flanks show",
    "fast transitions": "the slope changes faster with direction than a cosine, or than the directions lie",
    "shift left out": "the surface has a shift and the model none",
    "compensation": "forward and back shift cancel, as on Spectralon sanded with grit 1000",
    "bad normalisation": "lambda_n is noisy, missing, outside what was measured, or nearly dark",
    "few colours": "p and t_y hardly matter: Fresnel is flat over what was measured",
    "wrong n and k": "another metal than it is fitted with",
    "wrong distribution": "normals that are not distributed as GGX",
    "few points": "too few directions",
    "outliers": "values that are wrong and do not know it",
    "saturation": "the top of the lobe is beyond full scale",
}
"""The regimes of `simulators.stability.regimes` by name: what is difficult in each, in a phrase."""


class Kernel(StrEnum):
    """How the BRDF follows from |I|^2 / wavelength^2."""

    HARVEY_SHACK = "harvey-shack"
    """cos_o / cos_i: the generalised Harvey-Shack theory (Krywonos, Harvey & Choi 2011). It is not reciprocal."""
    RECIPROCAL = "reciprocal"
    """(cos_i + cos_o)^2 / (4 cos_i cos_o): the same, made reciprocal."""
    KIRCHHOFF = "kirchhoff"
    """(|q|^2 / q_z)^2 / (4 cos_i cos_o): the Kirchhoff approximation (Beckmann & Spizzichino 1963)."""


class Spread(StrEnum):
    """In which quantity the spacings of many gratings are spread evenly."""

    SPACING = "spacing"
    """d: as many gratings in each micrometre of spacing."""
    LOGARITHM = "logarithm"
    """log d: as many in each octave."""
    FREQUENCY = "frequency"
    """1/d: as many in each line per millimetre."""


@dataclass(frozen=True)
class Method:
    """A way to fit."""

    model: str
    engine: Engine = "fast"


METHODS = {
    "local": Method("local"),
    "local, lmfit": Method("local", "lmfit"),
    "global": Method("global"),
    "global-two-component": Method("global-two-component"),
    "cook-torrance": Method("cook-torrance"),
    "cook-torrance-shift": Method("cook-torrance-shift"),
    "cook-torrance-shift, lmfit": Method("cook-torrance-shift", "lmfit"),
    "two-component": Method("two-component"),
    "dielectric-shift": Method("dielectric-shift"),
}
"""All methods by name."""
