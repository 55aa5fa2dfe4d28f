"""Every correction earns its place on a bench whose errors are known."""

import pytest

from tests.benchmarks.corrections import table


@pytest.mark.slow
def test_each_correction_takes_away_more_bias_than_it_leaves() -> None:
    for correction, (with_it, without) in table().items():
        print(f"{correction}: {with_it:.2%} with it, {without:.2%} without it")
        assert with_it < 0.011, correction
        assert without > 1.9 * with_it, correction
