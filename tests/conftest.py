"""What holds for all tests."""

import os
from collections import Counter

import pytest

# Tests run in several processes, one for each core: a pool of threads in each of them, for matrices as small as these,
# would only wait for the others'. It must be said before NumPy is imported; commands that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with the most slow tests come first: one that is left for the end would run alone."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])
