"""What fills the gaps of a dataset is found in a process of its own.

It takes seconds of computing. In a thread of the service every answer would have to wait for that thread each time that
it lets go of the interpreter, several times an answer.
"""

import os
import threading
from multiprocessing.connection import Connection
from pathlib import Path

from api.errors import Conflict
from api.executor import BEHIND, end_with_parent
from api.prepared import PREPARED
from api.views.opened import filled_content
from goniometer.storage.store import Store

NAME = "goniometer fill"
"""Of the process."""

_LOOK = 0.2
"""Seconds between two looks whether the service ends."""


def fill_apart(database: Path | str, dataset_id: int, stop: threading.Event) -> bytes | None:
    """`api.views.opened.filled_content` of a dataset in `database`, found by a process that ends with this one.

    Raises `Conflict` where the process has ended without an answer; it is killed as soon as `stop` is set.
    """
    heard, told = PREPARED.Pipe(duplex=False)
    process = PREPARED.Process(target=_work, args=(told, database, dataset_id), name=NAME, daemon=True)
    with heard:
        with told:
            process.start()
        try:
            while not heard.poll(_LOOK):
                if stop.is_set():
                    process.kill()
            return heard.recv_bytes() or None
        except EOFError:
            raise Conflict(
                f"Dataset {dataset_id} was not filled, because the process that does it has ended; ask "
                "again, or look into the log of the service"
            ) from None
        finally:
            process.join()


def _work(told: Connection, database: Path | str, dataset_id: int) -> None:
    end_with_parent()
    os.nice(BEHIND)
    store = Store.open(database)
    told.send_bytes(filled_content(store.dataset(dataset_id)) or b"")
    store.close()
