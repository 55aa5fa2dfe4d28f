"""What may be chosen of a fit and of its files, and what is said of a choice, by name.

This module loads nothing: a command line that only names its choices starts at once.
"""

from typing import Literal

Engine = Literal["fast", "lmfit"]
"""Own derivatives, or the library that the paper used, with derivatives by differences."""

Distribution = Literal["ggx", "beckmann"]
"""Of the microfacets' normals."""

Weight = Literal["none", "sine", "uncertainty"]
"""How the terms of the cost are weighed: all alike, by sin(theta_in), or by the uncertainty of their counts."""

BRDF_MODELS = (
    "cook-torrance",
    "cook-torrance-shift",
    "two-component",
    "dielectric",
    "dielectric-shift",
    "dielectric-two-component",
)
"""Names of the models that `analysis.fits.brdf_fit` knows."""

MODELS = ("local", "global", "global-two-component", *BRDF_MODELS)
"""Names of all models that can be fitted."""

MODEL_NAMES = {
    "local": "Local fit",
    "global": "Global model",
    "global-two-component": "Global model, two components",
    "constant-slope": "Constant slope",
    "cook-torrance": "Cook-Torrance",
    "cook-torrance-shift": "Cook-Torrance with shift",
    "two-component": "Cook-Torrance, two components",
    "dielectric": "Dielectric",
    "dielectric-shift": "Dielectric with shift",
    "dielectric-two-component": "Dielectric, two components",
}
"""How a person reads the name of a model."""

USUAL_ERROR, USUAL_COLOUR_ERROR = 0.02, 0.5
"""How far a file for renderers may be from its model: relative, and dE00."""

State = Literal["meets", "fails", "undetermined", "not identified"]
"""What a model does in a scene with the tolerance that is asked for."""
