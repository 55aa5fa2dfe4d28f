"""Processes that begin at once: forks of one server that has loaded what they need, and that has no threads."""

import multiprocessing
import os
from multiprocessing import forkserver

PREPARED = multiprocessing.get_context("forkserver")
"""For the process of the bench and those of jobs, each of which would take seconds to load."""
PREPARED.set_forkserver_preload(["api.bench.worker", "api.jobs.worker"])


def prepare() -> None:
    """Start the server, so that it loads while nobody waits for it yet; harmless when repeated."""
    # Threads that share a small task wait for each other at full speed, which the bench on the same cores pays for.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    forkserver.ensure_running()
