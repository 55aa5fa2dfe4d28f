"""How good a dataset is: its sanity checks, its flags, and the uncertainty budget of a value."""

from pydantic import Field

from api.results.quality import budget_content, dataset_budget, quality_of
from api.views.body import Body, Number, number
from api.views.opened import Opened
from goniometer.store import Store


class CheckResult(Body):
    """One question that the dataset was asked."""

    name: str
    passed: bool | None = Field(description="Null where the data do not tell.")
    message: str


class FlagCount(Body):
    """A flag that occurs."""

    flag: str
    meaning: str
    points: int
    in_fits: str = Field(description="What the fits do with its points.")


class Checks(Body):
    """All checks and flags of a dataset."""

    dataset: int
    sample: str
    passed: bool = Field(description="False where any check failed.")
    checks: list[CheckResult]
    points: int
    flags: list[FlagCount]
    too_noisy: str = Field(description="Which points missed the wanted signal-to-noise ratio; empty where none did.")
    certificate_override: str | None


class SourceShare(Body):
    """One source of error of one value."""

    name: str
    u: float = Field(description="Standard uncertainty (k = 1), 1/sr; signed: what its error does to the BRDF.")
    relative: Number
    share: float = Field(description="Of the variance, 0 to 1.")
    shared: str = Field(description="Which points and wavelengths have the same error, in words.")


class PartShare(Body):
    """A part of the budget of one value."""

    name: str
    u: float
    relative: Number
    share: float
    sources: list[SourceShare]


class UncertaintyBudget(Body):
    """The budget of one measured value."""

    dataset: int
    sample: str
    theta_in: float = Field(description="Of the measured point, degrees, as read back.")
    theta_out: float
    wavelength: float = Field(description="nm")
    brdf: float = Field(description="1/sr")
    u: float = Field(description="Combined standard uncertainty (k = 1), 1/sr.")
    parts: list[PartShare]
    expanded_uncertainty: float = Field(description="1/sr, by `coverage_factor`.")
    coverage_factor: int
    coverage: str


def checks(store: Store, opened: Opened) -> Checks:
    """Checks and flags of a dataset."""
    return Checks.model_validate(quality_of(store, opened.entry.id, opened.dataset))


def uncertainty_budget(
    opened: Opened, theta_in: float | None, theta_out: float | None, wavelength: float | None
) -> UncertaintyBudget:
    """The budget of the measured value nearest to a direction (degrees) and wavelength (nm).

    Raises what `api.results.quality.dataset_budget` raises.
    """
    content = budget_content(opened.entry.id, dataset_budget(opened.dataset, theta_in, theta_out, wavelength))
    for part in content["parts"]:
        for each in (part, *part["sources"]):
            each["relative"] = number(each["relative"])
    return UncertaintyBudget.model_validate(content)
