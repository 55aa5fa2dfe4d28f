"""How a benchmark tells a figure: what it is, what was measured, what was aimed at, and whether that was met.

A figure is printed as a row of a Markdown table, which a person reads at once and `python -m tests.benchmarks` puts on
its page as it is.
"""

import math
import operator
from numbers import Integral

HEAD = "| what | measured | aim | |\n|---|---|---|---|"
MISSED = "**missed**"
COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "=": operator.eq}


def met(value: float, aim: str) -> bool:
    """Whether a value is as an aim has it: "< 50", ">= 50", "= 0", or "93 to 97", the limits included.

    >>> met(12.5, "< 50"), met(1, "= 0"), met(97, "93 to 97")
    (True, False, True)
    """
    if " to " in aim:
        low, high = map(float, aim.split(" to "))
        return low <= value <= high
    comparison, limit = aim.split()
    return bool(COMPARISONS[comparison](value, float(limit)))


def shown(value: float) -> str:
    """Whole numbers whole, all others with three digits.

    >>> shown(3001000), shown(0.03456), shown(1234.5), shown(5.0)
    ('3,001,000', '0.0346', '1,234', '5.00')
    """
    if isinstance(value, Integral) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:#.3g}".rstrip(".")


def tell(what: str, value: float, unit: str = "", aim: str = "", because: str = "") -> None:
    """Print a figure in `unit`, beside its `aim` where there is one, and the known reason `because` it is missed.

    Raises ValueError for a value that is not a number: no figure is better than a wrong one.
    """
    if math.isnan(value):
        raise ValueError(f"{what} is not a number, so nothing was measured")
    verdict = ""
    if aim:
        verdict = "met" if met(value, aim) else MISSED + (f": {because}" if because else "")
    wanted = aim.replace("<=", "≤").replace(">=", "≥")
    print(f"| {what} | {shown(value)}{f' {unit}' if unit else ''} | {wanted} | {verdict} |", flush=True)
