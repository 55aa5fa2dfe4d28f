"""What can go wrong in analysis.

AnalysisError
├── OutOfRange         a wavelength, direction or parameter that a model or its data does not cover
├── UnknownConductor   a metal that the tables do not have (exit code 2)
├── FitError           data that cannot be fitted
├── ExportError        a result that cannot be written in the wanted format
├── SceneError         a scene that shows nothing of its material (exit code 2)
└── RenderError        a renderer that is not there, or that failed

Every message is one sentence that says what is wrong, where, and what would be right.
"""


class AnalysisError(Exception):
    """Base of everything that this floor raises."""

    exit_code = 1


class OutOfRange(AnalysisError):
    """A wavelength, direction or parameter that a model or its data does not cover."""


class UnknownConductor(AnalysisError):
    """A metal that the tables of refractive indices do not have."""

    exit_code = 2


class FitError(AnalysisError):
    """Data that cannot be fitted."""


class ExportError(AnalysisError):
    """A result that cannot be written in the wanted format."""


class SceneError(AnalysisError):
    """A scene that shows nothing of its material."""

    exit_code = 2


class RenderError(AnalysisError):
    """A renderer that is not there, or that failed."""
