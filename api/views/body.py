"""What all answers have in common: frozen models, in which null is a number that nobody knows."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

Number = float | None
"""Null where there is no value: JSON knows no NaN."""


class Body(BaseModel):
    """An answer, or a part of one."""

    model_config = ConfigDict(frozen=True)


def number(value: float | str | None) -> Number:
    """A number of an answer; infinities, and what a stored fit writes for them, are no value either."""
    return None if value is None or not math.isfinite(float(value)) else float(value)


def numbers(values: NDArray[Any] | Iterable[float]) -> list[Number]:
    """The same of many."""
    return [number(value) for value in (values.tolist() if isinstance(values, np.ndarray) else values)]
