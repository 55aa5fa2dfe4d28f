"""Some hundred points in a row on a bench on which something happens all the time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = """
import json, logging
from tests.benchmarks.soak import soak
logging.getLogger().addHandler(logging.NullHandler())
soaked = soak(300, rate=0.2, seed=2)
print(json.dumps([
    soaked.points, soaked.struck, soaked.wrong, list(map(str, soaked.unexplained)), soaked.threads, soaked.descriptors
]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory and descriptors as Linux shows them")
def test_a_bench_that_is_disturbed_all_the_time_loses_no_point_and_stores_no_false_one() -> None:
    # in a process of its own: pytest keeps every log record, and with it the errors and what these hold on to
    done = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True, check=True)
    points, struck, wrong, unexplained, threads, descriptors = json.loads(done.stdout)
    assert points >= 300
    assert sum(struck.values()) >= 50
    assert len(struck) >= 10
    assert wrong == []
    assert unexplained == []
    assert threads[0] == threads[1]
    assert descriptors[0] == descriptors[1]
