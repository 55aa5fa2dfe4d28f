"""What all bodies have in common: answers are frozen, and null in them is a number that nobody knows."""

import math
from collections.abc import Iterable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

T = TypeVar("T")

Number = float | None
"""Null where there is no value: JSON knows no NaN."""


class Body(BaseModel):
    """An answer, or a part of one."""

    model_config = ConfigDict(frozen=True)


class Asked(BaseModel):
    """What somebody asks for; what is not known is refused."""

    model_config = ConfigDict(extra="forbid")


class Page(Body, Generic[T]):
    """A part of a list."""

    items: list[T]
    next: str | None = Field(description="`after` of the next page; null on the last one.")


def number(value: float | str | None) -> Number:
    """A number of an answer; infinities, and what a stored fit writes for them, are no value either."""
    return None if value is None or not math.isfinite(float(value)) else float(value)


def numbers(values: NDArray[Any] | Iterable[float]) -> list[Number]:
    """The same of many."""
    return [number(value) for value in (values.tolist() if isinstance(values, np.ndarray) else values)]
