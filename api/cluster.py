"""A Dask cluster as an executor: `goniometer --cluster tcp://host:8786 COMMAND`.

Workers may be on other machines: nothing is told by path, everything travels in the task. What a `partial` binds is
common to many tasks; it travels once, as a task of its own, which the cluster runs again where the worker that had it
is lost. So is every other task; one that is running wherever a worker dies, four times over, is given up (`allowed-
failures` of the scheduler).
"""

import hashlib
import logging
import pickle  # nosec B403 # only between this program and the workers that its user has named
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any, TypeVar
from urllib.parse import urlsplit

import analysis
import api
import drivers
import goniometer
import simulators
from api.errors import ClusterError, VersionsDiffer
from goniometer.errors import InputError
from goniometer.storage.derived import software_version

T = TypeVar("T")

PATIENCE = 10.0
"""Seconds in which the scheduler, and a first worker, must answer."""

_LIBRARIES = ("numpy", "scipy", "numba", "finufft", "lmfit", "distributed")
"""On which results, or what travels, depend."""


@contextmanager
def connected(address: str) -> Iterator[Executor]:
    """The cluster whose scheduler is at `address`, e.g. tcp://host:8786, as an executor.

    Raises `InputError` for what is no address and where Dask is not installed, and `ClusterError` where nobody answers,
    where there is no worker, or where workers run several tasks at once or other software than this program. Futures
    raise `ClusterError` for a task that ended its workers again and again, and when the cluster is lost.
    """
    try:
        import dask  # noqa: PLC0415  (an extra)
        import distributed  # noqa: PLC0415
    except ModuleNotFoundError:
        raise InputError(
            'A cluster needs distributed, which is not installed; run: pip install "goniometer[scale]".'
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is raised
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "10GB"})  # it travels once
    silent = f"No Dask scheduler answers at {address}; start one there with: dask scheduler, or name another with "
    silent += "--cluster."
    _check_answer(address, silent)
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except OSError:
        raise ClusterError(silent) from None
    with client:
        _check_workers(client, address)
        executor = _Cluster(client, address)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


def _check_answer(address: str, silent: str) -> None:
    """Whether anybody listens at `address`.

    A client of Dask that finds nobody is left half made. Where it is collected as garbage while another one starts,
    both wait for the same lock for ever; so none is made without need.
    """
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:  # of a port that is no number
        host, port = None, None
    if parts.scheme not in {"tcp", "tls"} or not host or not port:
        raise InputError(f'"{address}" is no address of a cluster; it should read tcp://HOST:PORT.')
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError:
        raise ClusterError(silent) from None


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise ClusterError(
            f"The cluster at {address} has no worker; start some with: dask worker {address} --nthreads 1."
        ) from None
    wanted = software()

    def fit() -> str | None:  # no name of a module: pickled as it stands, for a worker that has no such module
        try:
            own: str | None = import_module("api.cluster").difference(wanted)
        except ImportError as error:
            return f"does not have all of this program ({error})"
        return own

    found = client.run(fit)
    threads = {worker: facts["nthreads"] for worker, facts in client.scheduler_info(n_workers=-1)["workers"].items()}
    for worker, problem in found.items():
        if problem is not None:
            raise VersionsDiffer(f"Worker {worker} {problem}; install the same software there and here.")
        if threads.get(worker, 1) > 1:
            raise ClusterError(
                f"Worker {worker} runs {threads[worker]} tasks at once in one process; start it with --nthreads 1, and "
                "as many workers as there are processors."
            )


@cache
def software() -> dict[str, str]:
    """What results depend on: the code of this program and the versions below it, by name."""
    digest = hashlib.sha256()
    for floor in (drivers, goniometer, analysis, simulators, api):
        folder = Path(floor.__path__[0])
        for file in sorted([*folder.glob("*.py"), *folder.glob("*/*.py")]):
            digest.update(file.read_bytes())
    own = {"goniometer": f"{software_version()} ({digest.hexdigest()[:8]})", "Python": python_version()}
    return own | {name: version(name) for name in _LIBRARIES}


def difference(wanted: dict[str, str]) -> str | None:
    """What of the software of this process is not as `wanted`, as the end of a sentence; None where it is the same."""
    here = software()
    other = [f"{name} {here.get(name)} for {wanted[name]}" for name in wanted if here.get(name) != wanted[name]]
    return f"runs other software than this program: {', '.join(other)}" if other else None


class _Cluster(Executor):
    """The executor of Dask, with tasks that look where they are and errors in our words."""

    def __init__(self, client: Any, address: str) -> None:
        self._client = client
        self._address = address
        self._executor = client.get_executor(pure=False)
        self._common: dict[int, tuple[Callable[..., Any], Any]] = {}
        """By identity, what `partial`s bind, and where that is on the cluster."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> "Future[T]":
        """As every executor."""
        function = self._sent(fn) if isinstance(fn, partial) else fn
        running = self._executor.submit(_run, software(), function, args, kwargs)
        told: Future[T] = Future()
        told.add_done_callback(lambda done: running.cancel() if done.cancelled() else None)
        running.add_done_callback(partial(self._tell, told))
        return told

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As every executor; what is not waited for is cancelled."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        self._common.clear()

    def _sent(self, fn: Callable[..., Any]) -> Any:
        known = self._common.get(id(fn))
        if known is None:
            from distributed.protocol.pickle import dumps  # noqa: PLC0415  (an extra)

            known = fn, self._client.submit(pickle.loads, dumps(fn), pure=False)
            self._common[id(fn)] = known
        return known[1]

    def _tell(self, told: "Future[Any]", done: "Future[Any]") -> None:
        """Pass on how a task ended."""
        from distributed.scheduler import KilledWorker  # noqa: PLC0415  (an extra)

        if not told.set_running_or_notify_cancel():
            return
        try:
            fault = done.exception()
        except CancelledError:
            fault = ClusterError(
                f"The cluster at {self._address} is gone, and what was running with it; run the command again."
            )
        if isinstance(fault, KilledWorker):
            times, last = fault.allowed_failures + 1, fault.last_worker.address
            fault = ClusterError(
                f"A task ended {times} workers, the last one {last}; look at its log, perhaps it wants more memory."
            )
        if fault is None:
            told.set_result(done.result())
        else:
            told.set_exception(fault)


def _run(wanted: dict[str, str], function: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any]) -> T:
    """Do a task on a worker, which may have come after the others were checked."""
    if (problem := difference(wanted)) is not None:
        raise VersionsDiffer(f"A worker that joined {problem}; install the same software there and here.")
    return function(*args, **kwargs)
