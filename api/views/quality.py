"""How good a dataset is: its sanity checks, its flags, and the uncertainty budget of a value."""

from api.bodies.base import number
from api.bodies.datasets import Checks, UncertaintyBudget
from api.results.quality import budget_content, dataset_budget, quality_of
from api.views.opened import Opened
from goniometer.storage.store import Store


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
