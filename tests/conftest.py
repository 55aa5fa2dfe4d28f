"""What holds for all tests."""

import gc
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from goniometer.storage.store import Store

# Tests run in several processes, one for each core: a pool of threads in each of them, for matrices as small as these,
# would only wait for the others'. It must be said before NumPy is imported; commands that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("busy", deadline=None)  # a machine on which others work may stand still for a while
settings.load_profile("busy")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with the most slow tests come first: one that is left for the end would run alone."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def pytest_collection_finish() -> None:
    """What is loaded by now stays: to look through it for garbage again and again takes a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


@pytest.fixture(scope="session")
def postgresql(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of a PostgreSQL server."""
    from tests.databases import start_server  # noqa: PLC0415  (loads the store, after the threads are set)

    shared = tmp_path_factory.getbasetemp()
    return start_server(shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path | str]:
    """A database of either kind, as `Store.open` takes it."""
    if request.param == "sqlite":
        yield tmp_path / "bench.db"
        return
    from tests.databases import fresh_database  # noqa: PLC0415

    with fresh_database(request.getfixturevalue("postgresql")) as url:
        yield url


@pytest.fixture
def either(database: Path | str) -> Iterator["Store"]:
    """The open `database`, of either kind."""
    from goniometer.storage.store import Store  # noqa: PLC0415

    opened = Store.open(database)
    yield opened
    opened.close()
