"""What can go wrong in a simulation: what was to be simulated cannot be.

InputError                 what the user gave cannot be right (exit code 2)
└── SimulationError
    ├── UnfitTopography    a height map that has no surface, or not the one that a computation needs
    ├── UnfitTable         a file that holds no table of a material, or a dataset of which none can be made
    ├── UnfitRays          rays that cannot be traced, or a detector that cannot collect them
    ├── UnknownMaterial    a material that is not in the store room of the bench, or one that has no BRDF
    └── FaultScriptError   a line of a fault script that cannot be read, or a fault that cannot happen

Every message is one sentence that says what is wrong, where, and what would be right.
"""

from goniometer.errors import InputError


class SimulationError(InputError):
    """Base of everything that only this floor raises."""


class UnfitTopography(SimulationError):
    """A height map that has no surface, or not the one that a computation needs."""


class UnfitTable(SimulationError):
    """A file that holds no table of a material, or a dataset of which none can be made."""


class UnfitRays(SimulationError):
    """Rays that cannot be traced, or a detector that cannot collect them."""


class UnknownMaterial(SimulationError):
    """A material that is not in the store room of the bench, or one that has no BRDF."""


class FaultScriptError(SimulationError):
    """A line of a script that cannot be read, or a fault that cannot happen."""
