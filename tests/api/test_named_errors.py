"""What a service, or the process that drives its bench, refuses is caught by who asked as if it were raised there."""

import json

import pytest

import analysis.errors
import api.errors
import drivers.errors
import goniometer.errors
import simulators.errors
from api.errors import ServiceError, TooManyFailures
from api.named_errors import error_named
from api.web.problems import told
from goniometer.errors import (
    ArchiveMissing,
    BenchUnfit,
    GoniometerError,
    InputError,
    OptionError,
    RawDamaged,
    StoreError,
)

OF_MORE_THAN_A_SENTENCE: list[tuple[Exception, type[Exception]]] = [
    (OptionError("{raw} has no use here; leave it out.", "raw"), InputError),
    (RawDamaged(7), StoreError),
    (ArchiveMissing(7, "/archives/scan-7.h5", "which is not there"), StoreError),
    (BenchUnfit(["light: its lamp does not burn"]), GoniometerError),
    (TooManyFailures("Too many logins have failed; wait 5 s and try again", 5.0), ServiceError),
]
"""With what of them is caught."""
KINDS = {
    kind
    for tree in (drivers.errors, goniometer.errors, analysis.errors, simulators.errors, api.errors)
    for kind in vars(tree).values()
    if isinstance(kind, type) and issubclass(kind, Exception)
} - {type(raised) for raised, _ in OF_MORE_THAN_A_SENTENCE}
RAISED = pytest.mark.parametrize(
    ("raised", "caught"),
    [
        *OF_MORE_THAN_A_SENTENCE,
        *((kind("No scan 7."), kind) for kind in sorted(KINDS, key=lambda kind: kind.__name__)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else value.__name__,
)


@RAISED
def test_what_the_bench_refuses_keeps_its_kind_on_the_way_to_who_asked(
    raised: Exception, caught: type[Exception]
) -> None:
    answered = error_named(type(raised).__name__, str(raised))
    assert (type(answered), str(answered)) == (caught, str(raised))


@RAISED
def test_what_the_service_refuses_is_found_by_the_name_of_its_problem(
    raised: Exception, caught: type[Exception]
) -> None:
    problem = json.loads(bytes(told(raised).body))
    answered = error_named(problem["type"].rpartition(":")[2], problem["detail"])
    assert (type(answered), str(answered)) == (caught, problem["detail"])


def test_what_no_floor_raises_is_no_error_of_ours() -> None:
    assert error_named("method-not-allowed", "There is no such method here.") is None
