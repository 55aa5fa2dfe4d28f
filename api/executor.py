"""Where heavy work is done: in processes or threads of this machine, or on a Dask cluster, behind one interface.

Whoever has work submits pure functions of at least a tenth of a second to a `concurrent.futures.Executor` and knows
nothing more. What comes of them is the same to the last bit wherever they run: they draw from seeds of their own, are
summed in the order in which they were submitted, and run on one thread each.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager

BEHIND = 10
"""How far processes of heavy work step back: the bench and who is at the pages go before."""


@contextmanager
def processes(cluster: str | None, count: int | None = None) -> Iterator[Executor]:
    """The cluster at the address `cluster`; without one `count` processes of this machine, else one a processor.

    What has not been done when something goes wrong is lost: nobody would take it, and nobody waits for it.
    Raises as `api.cluster.connected`.
    """
    if cluster is not None:
        with _cluster(cluster) as executor:
            yield executor
        return
    for library in ("OMP", "OPENBLAS", "MKL"):
        # several tasks at once do more than one task on several threads
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin)
    try:
        yield pool
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """End this worker when the process that started it is gone, however it went; call it once in a worker.

    Ctrl-C reaches the worker as well, and ends it without a word: its parent says what there is to say.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _begin() -> None:
    end_with_parent()
    if hasattr(os, "nice"):
        os.nice(BEHIND)


@contextmanager
def threads(cluster: str | None) -> Iterator[Executor]:
    """The same for work that holds no interpreter lock: without a cluster, a thread for each processor."""
    if cluster is not None:
        with _cluster(cluster) as executor:
            yield executor
        return
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with ThreadPoolExecutor(count) as executor:
        yield executor


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    from api.cluster import connected  # noqa: PLC0415  (an extra, and it takes half a second)

    with connected(address) as executor:
        yield executor
