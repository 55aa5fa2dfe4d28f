"""A check made into a test with a bombardment of drawn examples."""

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

TOGETHER = 20
"""Examples of 10,000 that are drawn at once, because to begin a draw takes longer than most of the checks."""


def bombarded(strategy: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make of a check a test of 200 drawn examples, and one of 10,000 for who has the time.

    The last parameter of the check is what is drawn; those before it are fixtures.
    """

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        *fixtures, drawn = signature(check).parameters.values()

        @pytest.mark.parametrize(
            ("examples", "together"), [(200, 1), pytest.param(10_000, TOGETHER, marks=pytest.mark.slow)]
        )
        def test(examples: int, together: int, **fixture_values: Any) -> None:
            repeated = examples // 10 if together > 1 else 0  # about half as many come again in another draw

            @settings(
                max_examples=(examples + repeated) // together,
                deadline=None,
                derandomize=True,
                suppress_health_check=list(HealthCheck),
            )
            # without `unique_by` hypothesis would fill most of a list with copies
            @given(st.lists(strategy, min_size=together, max_size=together, unique_by=repr))
            def each(values: list[Any]) -> None:
                for value in values:
                    check(**fixture_values, **{drawn.name: value})

            each()

        test.__name__ = check.__name__
        test.__doc__ = check.__doc__
        # pytest reads here what the test wants
        new = [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in ("examples", "together")]
        test.__signature__ = signature(check).replace(parameters=[*new, *fixtures])
        return test

    return decorate
