"""What may be chosen at the command line, by name; loads nothing, see `analysis.choices`."""

from enum import StrEnum
from typing import Literal, get_args

Role = Literal["viewer", "operator", "metrologist", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
"""From the one that may least to the one that may most."""

WRITTEN = {
    "json": "all fits",
    "hdf5": "the dataset with uncertainty, flags and lineage, NeXus-style",
    "csv": "the same, one value a row",
    "parquet": "the same, for data frames",
    "paper": "the JSON of points of the paper's authors",
    "bird": "universal BRDF JSON of the BiRD project",
    "bluesky": "documents of bluesky's event model, one a line",
    "package": "all of it as a zip or a folder that is ready to be published",
    "mitsuba": "a .bsdf file for Mitsuba 3 and PBRT, with a scene that shows it",
    "mitsuba-plugin": "a scene for Mitsuba 3 with the exact model, by the plugin ggx_shift, which is written beside it",
}
"""Formats of exports, and what a file holds in each."""

FIRST_USER = "local"
"""Who uses a service that nobody has given users, from the machine itself."""

Through = Literal["plugin", "bsdf"]
"""Whether a model is rendered by the plugin ggx_shift, or as a table by the plugin `measured`."""


class ChartKind(StrEnum):
    """What is charted."""

    SCANS = "scans"
    FITS = "fits"
    MODELS = "models"
    SIMULATIONS = "simulations"
