"""JSON that every reader understands: without NaN and infinities, and a list of numbers on one line."""

import json
import math
import re
from typing import Any

from analysis.errors import ExportError

_LINE_BREAK = re.compile(r"\s*\n\s*")


def strict_json(document: dict[str, Any]) -> str:
    """JSON without NaN or infinities (see above), a list of numbers on one line so that a person can scroll by.

    Raises `ExportError` for content that JSON does not know.
    """
    try:
        text = json.dumps(_without_non_finite(document), indent=1, allow_nan=False, ensure_ascii=False)
    except TypeError as fault:
        raise ExportError(f"The content cannot be written as JSON: {fault}.") from fault
    # a line break never stands inside a JSON string, so this touches lists only
    return re.sub(r"\[\n\s*([^\[\]{}]*?)\s*\n\s*\]", lambda list_: f"[{_LINE_BREAK.sub(' ', list_[1])}]", text) + "\n"


def _without_non_finite(value: Any) -> Any:
    """The same structure with NaN and infinities in their written form."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, dict):
        return {key: _without_non_finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_non_finite(item) for item in value]
    return value
