"""The intervals that a dataset states hold the truth as often as they say."""

import pytest

from tests.benchmarks.coverage import report, run


@pytest.mark.slow
def test_the_95_percent_interval_holds_the_truth_in_93_to_97_percent_of_the_cells() -> None:
    # directions of one bench share most of its errors, so a few on many benches tell as much as many
    for sample, share in report(run(range(1, 51), grid=((10.0, 70.0), 30.0))).items():
        assert 0.93 < share < 0.97, sample
