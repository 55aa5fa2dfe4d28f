"""Some hundred points in a row on a bench on which something happens all the time."""

from pathlib import Path

import pytest

from tests.benchmarks.soak import soak


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory and descriptors as Linux shows them")
def test_a_bench_that_is_disturbed_all_the_time_loses_no_point_and_stores_no_false_one() -> None:
    soaked = soak(300, rate=0.2, seed=2)
    assert soaked.points >= 300
    assert soaked.struck.total() >= 50
    assert len(soaked.struck) >= 10
    assert soaked.wrong == []
    assert soaked.unexplained == []
    assert soaked.threads[0] == soaked.threads[1]
    assert soaked.descriptors[0] == soaked.descriptors[1]
