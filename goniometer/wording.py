"""Texts from outside: names that can be shown, nothing that commands a terminal, and what pydantic finds wrong."""

import difflib
import unicodedata
from collections.abc import Iterable, Sequence
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

LONGEST_NAME = 200
"""Characters; with an ending it is still the name of a file."""


def inert(text: str) -> str:
    """A text in which stands as an escape what would command a terminal or turn the direction of writing.

    >>> inert("50 µm\\x1b[2J")
    '50 µm\\\\x1b[2J'
    """
    harmless = (c in "\n\t" or unicodedata.category(c) not in {"Cc", "Cf", "Cs"} for c in text)
    return "".join(c if fine else ascii(c)[1:-1] for c, fine in zip(text, harmless, strict=True))


def check_name(name: str) -> str:
    """The name of something that people call so; raises `ValueError` for what no list, file or terminal can show."""
    if len(name) > LONGEST_NAME or inert(name) != name or {"\n", "\t"} & set(name):
        raise ValueError(f"a name is one line of at most {LONGEST_NAME} characters, and nothing but what is seen of it")
    return name


def key_path(parts: Sequence[int | str]) -> str:
    """Where a key stands in a file, e.g. "samples[0].name"."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")


def nearest(given: str, known: Iterable[str]) -> str:
    """The known name that was meant, or all of them, as the end of a sentence."""
    known = list(known)
    near = difflib.get_close_matches(given, known, n=1, cutoff=0.5)
    return f'did you mean "{near[0]}"?' if near else "known here: " + ", ".join(known)


def and_more(faults: int) -> str:
    """The end of a sentence that tells the first of several faults.

    >>> and_more(0), and_more(1), and_more(2)
    ('', ' (and 1 more fault)', ' (and 2 more faults)')
    """
    return "" if faults == 0 else f" (and {faults} more fault{'s' if faults > 1 else ''})"


def ordered(error: ValidationError) -> list[ErrorDetails]:
    """What a pydantic validation found, unknown keys first: a typo explains the rest."""
    faults = error.errors()
    # a list whose items have faults is counted without them, and so told to be too short, which is no fault of its own
    own = (fault for fault in faults if fault["type"] != "too_short" or not _holds_another(fault["loc"], faults))
    return sorted(own, key=lambda fault: fault["type"] != "extra_forbidden")


def _holds_another(loc: tuple[int | str, ...], faults: Sequence[ErrorDetails]) -> bool:
    """Whether one of the faults lies within what `loc` leads to."""
    return any(len(fault["loc"]) > len(loc) and fault["loc"][: len(loc)] == loc for fault in faults)


def describe(error: ValidationError, model: type[BaseModel]) -> str:
    """The first fault of a pydantic validation of `model` as one sentence: key path, what is wrong, what is right."""
    faults = ordered(error)
    return _sentence(faults[0], model) + and_more(len(faults) - 1)


def _sentence(fault: ErrorDetails, model: type[BaseModel]) -> str:
    """One pydantic error in words."""
    loc = fault["loc"]
    tagged = loc[:1] == ("incident",) and loc[1:2] in {("steps",), ("list",)}
    parts = [*loc[:1], *loc[2:]] if tagged else list(loc)  # without the tag of `Incident`
    where = key_path(parts)
    given = fault["input"]
    match fault["type"]:
        case "extra_forbidden":
            known = _model_at(model, parts[:-1]).model_fields
            text = f"there is no such key; {nearest(str(parts[-1]), known)}"
        case "missing":
            text = "this key is missing"
        case "value_error":
            text = str(fault["ctx"]["error"])
        case "string_type":
            text = f"{given!r} is not text; write it in quotes"
        case "model_type" | "dict_type":
            fields = ", ".join(_model_at(model, parts).model_fields)
            text = f"{given!r} is not possible: give a mapping with keys of {fields}"
        case "incident_form":
            text = f"{given!r} is not possible: {fault['msg']}"
        case _:
            shown = "" if isinstance(given, dict | list | tuple) else f"{given!r} is not possible: "
            text = shown + fault["msg"].replace("Input should", "it must").replace("Tuple should", "it must")
    return f"{where}: {text}"


def _model_at(model: type[BaseModel], parts: list[int | str]) -> type[BaseModel]:
    """The model that the key path leads to."""
    for part in parts:
        if isinstance(part, int):
            continue
        annotation = model.model_fields[part].annotation
        nested = [annotation, *get_args(annotation)]
        nested += [inner for item in nested for inner in get_args(item)]
        model = next(item for item in nested if isinstance(item, type) and issubclass(item, BaseModel))
    return model
