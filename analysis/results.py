"""What the analysis of one dataset gives: fits, verdicts and colour differences."""

import math
from dataclasses import dataclass, field

import numpy as np

from analysis.choices import Distribution, Engine
from analysis.reflectance.fresnel import Conductor
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter."""

    name: str
    value: float
    standard_error: float
    """Standard uncertainty (coverage factor 1), propagated from the uncertainty of the measurement."""
    unit: str
    """"1" for a pure number, else e.g. "1/um"."""
    error_by_part: dict[str, float] = field(default_factory=dict)
    """What each part of the uncertainty budget, and what the model does not describe
    (`analysis.fits.misfit.PARTS_OF_FITS`), gives to `standard_error`, which is the root of the sum of their squares;
    empty where the parameter is not determined."""


@dataclass(frozen=True)
class Verdict:
    """Whether a fit may be believed, in words that a person can act on."""

    trusted: bool
    reasons: tuple[str, ...] = ()
    """Whole sentences; empty only when `trusted`."""
    undetermined: tuple[str, ...] = ()
    """Names of the parameters that the data do not tell; their values are not to be shown as if they did."""
    converged: bool = True
    """Whether the optimiser came to an end by itself."""


@dataclass(frozen=True)
class Albedo:
    """Diffuse albedo of a dielectric (Eq. 8), all arrays [wavelengths]."""

    wavelengths: FloatArray
    """nm."""
    values: FloatArray
    """r_d, a pure number, at least 0."""
    u: FloatArray
    """Standard uncertainty (coverage factor 1); infinite where r_d stands at 0 and nothing more is known."""


@dataclass(frozen=True)
class Comparison:
    """A model against a simpler one that it contains, on the same data with the same cost."""

    simpler: str
    """Name of the simpler model."""
    bic: float
    """By how much the Bayesian information criterion falls; above 10 is very strong evidence (Kass & Raftery 1995)."""
    dE00: float  # noqa: N815  (the field's own spelling)
    """By how much the mean absolute CIEDE2000 falls; NaN without the visible wavelengths."""


@dataclass(frozen=True)
class LocalFit:
    """Eq. 2, fitted to each spectrum on its own; all arrays [points] unless said otherwise."""

    slope: FloatArray
    """m, 1/um."""
    u_slope: FloatArray
    """Standard uncertainty of m (coverage factor 1), by all errors of the measurement and by the misfit, 1/um."""
    exponent: FloatArray
    """p, a pure number."""
    u_exponent: FloatArray
    """Standard uncertainty of p (coverage factor 1), as that of m; zero where p was held."""
    scale: FloatArray
    """a, the BRDF at lambda_n, 1/sr."""
    r2: FloatArray
    """Coefficient of determination of the spectrum."""
    reliable: BoolArray
    """False where the point is flagged as unusable, the signal drowns in noise, or the optimiser stopped at a bound."""
    fitted: FloatArray
    """[points, wavelengths] the fitted spectra, 1/sr."""
    lambda_n: float
    """Normalisation wavelength, nm."""
    misfit: FloatArray
    """[2, points] the parts of `u_slope` and `u_exponent` that come from what Eq. 2 does not describe of a spectrum;
    zero where noise explains what it leaves."""
    doubts: tuple[str, ...] = ()
    """What speaks against all spectra together, whole sentences."""
    fresnel: bool = True
    """False where the exponent was held at 0."""


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to all points at once."""

    model: str
    """One of `analysis.choices.MODELS`, "local" excepted."""
    equation: str
    """The equation in words of the paper, e.g. "f = shift F G D / (4 cos_i cos_o), Eq. 7"."""
    parameters: tuple[Parameter, ...]
    correlation: FloatArray
    """[parameters, parameters]"""
    cost: str
    """Name of what was minimised, e.g. "loew" or "weighted least squares of the local slopes"."""
    cost_value: float
    r2: float
    verdict: Verdict
    fitted: FloatArray
    """[points, wavelengths] model values at the dataset's points, 1/sr."""
    lambda_n: float
    """Normalisation wavelength of the shift, nm."""
    theta_range: tuple[float, float, float, float]
    """Smallest and largest theta_in and theta_out of the fitted points, degrees."""
    wavelength_range: tuple[float, float]
    """Smallest and largest fitted wavelength, nm."""
    clamped_points: int
    """At how many of the dataset's points the shift was clamped at zero somewhere."""
    engine: Engine = "fast"
    """What minimised the cost."""
    distribution: Distribution | None = None
    """Of the normals; None for a model that has none."""
    albedo: Albedo | None = None
    """Of a dielectric."""
    independent: float = math.nan
    """As how many independent ones the residuals count, by their autocorrelation."""
    comparison: Comparison | None = None
    """With the next simpler model, if there is one."""

    def value(self, name: str) -> float:
        """Value of the parameter called `name`; raises `KeyError`."""
        return {p.name: p.value for p in self.parameters}[name]

    def standard_error(self, name: str) -> float:
        """Standard uncertainty of the parameter called `name`; raises `KeyError`."""
        return {p.name: p.standard_error for p in self.parameters}[name]


@dataclass(frozen=True)
class ColourDifferences:
    """CIEDE2000 differences between a model and the measurement, [points]."""

    absolute: FloatArray
    """On the values as they are, cos(theta_in) f under D65, white = D65 seen through f cos = 1."""
    chromatic: FloatArray
    """Both spectra normalised at lambda_n first."""

    def statistics(self, kind: str = "absolute") -> dict[str, float]:
        """Mean, median, p95, max and count of "absolute" or "chromatic"; points without a value are left out.

        All but the count are NaN where no point has a value.
        """
        values = getattr(self, kind)
        values = values[np.isfinite(values)]
        if values.size == 0:
            return dict.fromkeys(("mean", "median", "p95", "max"), math.nan) | {"count": 0}
        return {
            "mean": float(np.mean(values)),
            "median": float(np.median(values)),
            "p95": float(np.percentile(values, 95)),
            "max": float(np.max(values)),
            "count": int(values.size),
        }


@dataclass(frozen=True)
class SampleAnalysis:
    """Everything that is fitted when a scan ends."""

    dataset: Dataset
    local: LocalFit
    models: tuple[ModelFit, ...]
    """In the order in which they were asked for."""
    differences: dict[str, ColourDifferences]
    """By model name, and "local"."""
    conductor: Conductor
    """The metal that models of metals are of."""

    def model(self, name: str) -> ModelFit:
        """The fit of the model called `name`; raises `KeyError`."""
        return {m.model: m for m in self.models}[name]
