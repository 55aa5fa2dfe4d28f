"""Quantities in a campaign file: a number in the documented unit, or a text with a unit.

`10`, `"10 deg"`, `"0.17 rad"` for an angle; `30`, `"30 s"`, `"8 ms"`, `"500 us"` for a time; `50`, `"50 mm"`, `"5 cm"`
for a length, `0.002`, `"0.2 %"` for a ratio.
"""

import math
import re
from typing import Annotated

from pydantic import BeforeValidator, Field

ANGLE_UNITS = {"deg": 1.0, "°": 1.0, "rad": 180 / math.pi, "mrad": 0.18 / math.pi}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "h": 3600.0}
LENGTH_UNITS = {"mm": 1.0, "cm": 10.0}
RATIO_UNITS = {"%": 0.01}


def _quantity(value: object, units: dict[str, float], kind: str) -> object:
    """`value` in the first of `units`; numbers pass unchanged, text needs one of the units."""
    known = ", ".join(units)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{value!r} is not {kind}: give a number or a number with a unit ({known})")
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*", value)
    if match is None:
        raise ValueError(f'"{value}" is not {kind}: give a number or a number with a unit ({known})')
    number, unit = match.groups()
    if unit and unit not in units:
        raise ValueError(f'"{value}" has the unit "{unit}", but {kind} takes one of {known}')
    return float(number) * units.get(unit, 1.0)


def _angle(value: object) -> object:
    return _quantity(value, ANGLE_UNITS, "an angle")


def _time(value: object) -> object:
    return _quantity(value, TIME_UNITS, "a time")


def _length(value: object) -> object:
    return _quantity(value, LENGTH_UNITS, "a length")


def _ratio(value: object) -> object:
    return _quantity(value, RATIO_UNITS, "a ratio")


Angle = Annotated[float, BeforeValidator(_angle), Field(allow_inf_nan=False)]
"""Degrees."""
Duration = Annotated[float, BeforeValidator(_time), Field(allow_inf_nan=False)]
"""Seconds."""
Length = Annotated[float, BeforeValidator(_length), Field(allow_inf_nan=False)]
"""Millimetres."""
Ratio = Annotated[float, BeforeValidator(_ratio), Field(allow_inf_nan=False)]
"""A number without unit; a text may say it in per cent."""
