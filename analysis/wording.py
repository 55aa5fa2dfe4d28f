"""How reports call what they are about: a measurement, here or elsewhere, or a simulation."""

from typing import NamedTuple

from goniometer.datasets.dataset import Dataset


class Words(NamedTuple):
    """What was done, and what came of it."""

    done: str
    """"measured" or "simulated"."""
    result: str
    """"measurement" or "simulation"."""


def words(dataset: Dataset) -> Words:
    """The words for a dataset."""
    return Words("simulated", "simulation") if dataset.simulated else Words("measured", "measurement")
