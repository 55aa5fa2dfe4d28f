"""A Dask cluster does the same work as one process, to the last bit, loses nothing, and says what is wrong with it."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster
from numpy.typing import NDArray

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from api import cluster as api_cluster
from api.access.accounts import add_user
from api.access.tokens import create_token
from api.cluster import connected, difference, software
from api.errors import ClusterError, VersionsDiffer
from api.executor import processes
from api.results.products import fit_dataset, fit_datasets
from api.web.live import open_live
from goniometer.errors import InputError
from goniometer.storage.store import Store
from simulators.choices import Kernel
from simulators.rays.rays import terrain
from simulators.rays.scan import Goniometer, ray_scan
from simulators.stability.ensemble import ensemble, jobs
from simulators.topographies.topography import topography
from simulators.waves.diffraction import seen_through
from simulators.waves.scan import Setup, choose_patches
from simulators.waves.simulation import simulate
from tests.api.service_client import Client
from tests.drawn_dataset import drawn_dataset
from tests.served import wait_for

NM = np.arange(420.0, 701, 40)
INDEX = load_conductor().index(NM)
WORKERS = 4


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=":0", protocol="tcp://") as started:
        yield started


@pytest.fixture(scope="module")
def executor(cluster: LocalCluster) -> Iterator[Executor]:
    with connected(cluster.scheduler_address) as executor:
        yield executor


ASKED = Goniometer(
    np.array([0.0, 60.0]),
    np.arange(-80.0, 81, 8),
    NM,
    partial(fresnel_conductor, n=INDEX[0], k=INDEX[1]),
    decomposed_at=0,
    rays=1_200_000,
    seed=1,
    aperture=8.0,
    azimuth=0.0,
)


def traced(executor: Executor | None, told: Callable[[float], None] = lambda share: None) -> list[NDArray[Any]]:
    """All that a scan with rays found."""
    surfaces = [terrain(topography("sample-1", 256, None, seed, micro=False).field) for seed in (1, 2)]
    with nullcontext(executor) if executor else ThreadPoolExecutor(2) as used:
        found = ray_scan(surfaces, ASKED, used, told)
    return [found.brdf, found.u_level, found.u_spectral, found.by_order, found.light, found.ends, found.escaped]


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_an_ensemble_of_fits_is_the_same_on_a_cluster(executor: Executor) -> None:
    wanted = jobs(["few points", "outliers"], ["global", "cook-torrance-shift"], 1)[:8]
    with ThreadPoolExecutor(1) as here:
        serial = list(ensemble(wanted, here))
    assert repr(list(ensemble(wanted, executor))) == repr(serial)


@pytest.mark.slow
def test_fits_of_datasets_are_the_same_on_a_cluster(executor: Executor, tmp_path: Path) -> None:
    stored = []
    for name, by in (("here", None), ("there", executor)):
        store = Store.open(tmp_path / f"{name}.db")
        made = [store.add_dataset(None, drawn_dataset("sample-1", seed=seed)) for seed in (1, 2)]
        list(fit_datasets(store, made, None, executor=by))
        stored.append([(fit.kind, fit.text) for each in made for fit in store.fits(each)])
    assert len(stored[0]) > 2
    assert stored[0] == stored[1]


@pytest.mark.slow
def test_rays_are_the_same_on_a_cluster(executor: Executor) -> None:
    for there, here in zip(traced(executor), traced(None), strict=True):
        np.testing.assert_array_equal(there, here)


@pytest.mark.slow
def test_waves_are_the_same_on_a_cluster(executor: Executor) -> None:
    theta_in, theta_out = (each.ravel() for each in np.meshgrid([0.0, 40.0], np.arange(-60.0, 61, 20), indexing="ij"))
    setup = Setup(theta_in, theta_out, NM, seen_through(5.0), Kernel.HARVEY_SHACK, load_conductor())
    patches = choose_patches("gaussian:0.3:3", 96, 0.25, 1, 4, micro=False)
    with ThreadPoolExecutor(1) as here:
        serial = simulate(patches, setup, here, multiple_seed=1)
    found = simulate(patches, setup, executor, multiple_seed=1)
    np.testing.assert_array_equal(found.computed.brdf, serial.computed.brdf)
    np.testing.assert_array_equal(found.computed.u_level, serial.computed.u_level)
    assert repr(found.convergence) == repr(serial.convergence)
    assert found.computed.lineage == serial.computed.lineage


@pytest.mark.slow
def test_workers_that_are_killed_in_mid_run_change_nothing(cluster: LocalCluster, executor: Executor) -> None:
    alive = [worker.pid for worker in cluster.workers.values()]

    def kill(share: float) -> None:
        if share > 0.1 and alive:
            os.kill(alive.pop(), signal.SIGKILL)

    found = traced(executor, kill)
    assert not alive  # even whoever had the surfaces
    for there, here in zip(found, traced(None), strict=True):
        np.testing.assert_array_equal(there, here)


@pytest.mark.slow
def test_a_task_that_ends_its_workers_again_and_again_ends_in_one_sentence(executor: Executor) -> None:
    with pytest.raises(ClusterError, match=r"A task ended 4 workers, the last one tcp://.*look at its log"):
        executor.submit(die).result(timeout=120)
    assert executor.submit(divmod, 7, 2).result(timeout=60) == (3, 1)


@pytest.mark.slow
def test_other_software_on_a_worker_is_refused_before_and_after_it_joins(
    cluster: LocalCluster, executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = software()
    monkeypatch.setattr(api_cluster, "software", lambda: here | {"numpy": "1.0"})
    with pytest.raises(VersionsDiffer, match=rf"numpy {np.__version__} for 1.0; install"):
        executor.submit(divmod, 7, 2).result(timeout=60)
    with (
        pytest.raises(VersionsDiffer, match=rf"Worker tcp://.* numpy {np.__version__} for 1.0"),
        connected(cluster.scheduler_address),
    ):
        pass


@pytest.mark.slow
def test_a_command_says_the_same_with_a_cluster_as_without(cluster: LocalCluster, cli: Any, tmp_path: Path) -> None:
    asked = ["stability", "--regime", "few points", "--method", "global", "--runs", 1, "--json"]
    here, there = cli(*asked, cwd=tmp_path), cli("--cluster", cluster.scheduler_address, *asked, cwd=tmp_path)
    assert (there.returncode, there.stderr) == (0, "")
    assert there.stdout == here.stdout


@pytest.mark.slow
def test_a_service_has_its_fits_made_on_the_cluster_and_stores_what_it_would_have_found_itself(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    def tasks() -> int:
        """Done by the cluster so far."""
        return sum(str(key).startswith("_run") and state == "memory" for key, _, state, *_ in list(log))

    assert cluster.scheduler is not None  # it has started
    log = cluster.scheduler.transition_log
    before = tasks()
    with open_live(tmp_path / "bench.db", tmp_path, cluster=cluster.scheduler_address) as live:
        number = live.store.add_dataset(None, drawn_dataset("sample-1"))
        add_user(live.store, "anna", "operator", None)
        client = Client(live)
        client.headers["Authorization"] = f"Bearer {create_token(live.store, 'anna', 'test')[0]}"
        asked = client.post(f"/api/datasets/{number}/fits", {"model": "global"})
        assert asked.status_code == 202, asked.text
        path = f"/api/jobs/{asked.json()['id']}"
        job = wait_for(lambda: (now := client.get(path).json())["finished"] and now)
        assert (job["state"], job["reason"]) == ("done", "")
        assert tasks() == before + 1
        fit_dataset(live.store, number, "global")
        there, here = live.store.fits(number)
    assert there.text == here.text


@pytest.mark.slow
def test_a_cluster_that_is_gone_or_cannot_work_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with LocalCluster(n_workers=0, threads_per_worker=2, dashboard_address=":0", protocol="tcp://") as started:
        address = started.scheduler_address
        with monkeypatch.context() as patch:
            patch.setattr(api_cluster, "PATIENCE", 2.0)
            with pytest.raises(ClusterError, match=f"{address} has no worker; start"), connected(address):
                pass
        started.scale(1)
        started.wait_for_workers(1, timeout=60)
        with pytest.raises(ClusterError, match="2 tasks at once in one process; start it with --nthreads 1"):
            connected(address).__enter__()
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", protocol="tcp://") as started:
        address = started.scheduler_address
        with connected(address) as executor:
            waiting = executor.submit(time.sleep, 600)
            started.close()
            with pytest.raises(ClusterError, match=f"{address} is gone"):
                waiting.result(timeout=60)
    with pytest.raises(ClusterError, match=f"No Dask scheduler answers at {address}"), connected(address):
        pass


@pytest.mark.parametrize("address", ["", "banana", "smoke://banana:1", "tcp://host:many"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="tcp://HOST:PORT"), processes(address):
        pass


def test_a_cluster_that_does_not_answer_is_one_line_and_exit_code_1(cli: Any, tmp_path: Path) -> None:
    done = cli("--cluster", "tcp://127.0.0.1:9", "stability", "--regime", "few points", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip().splitlines() == [
        "goniometer: No Dask scheduler answers at tcp://127.0.0.1:9; start one there with: dask scheduler, or name "
        "another with --cluster."
    ]


def test_software_that_is_the_same_has_no_difference() -> None:
    assert difference(software()) is None
    assert difference(software() | {"scipy": "0.1"}) is not None
