"""The other side of a job: what happens in its own process."""

import os
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from analysis.errors import AnalysisError
from analysis.strict_json import strict_json
from api.executor import end_with_parent
from api.jobs.kinds import KINDS, Work
from api.jobs.retention import JOBS
from api.jobs.uploads import called_as_sent
from api.named_errors import name_of
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, OptionError, StoreFull
from goniometer.storage.store import Store

_NICE = 10
"""The bench goes before."""

_told: list[Connection] = []
"""The way to tell, once there is one: this process has one job."""


@dataclass(frozen=True)
class Ended:
    """How a job ended."""

    result: str | None = None
    """JSON."""
    page: str | None = None
    """HTML."""
    reason: str = ""
    """Why there is no result, as a sentence."""
    fault: str | None = None
    """What a program calls that; None where there is a result."""


def begin_worker(told: Connection) -> None:
    """Prepare this process for a job: the first thing that is `told` is the number of its group."""
    end_with_parent()
    os.setsid()
    os.nice(_NICE)
    told.send(os.getpid())
    _told.append(told)


def _tell(share: float | None, words: str) -> None:
    for connection in _told:
        connection.send((share, words))


def work(database: str, output: str, cluster: str | None, job_id: int, kind: str, arguments: str) -> Ended:
    """Do a job on a database; `output` is the folder of all results, and `arguments` are those of its kind as JSON.

    `cluster` is the address of the Dask scheduler that does heavy work, None for this machine.
    """
    wanted = KINDS[kind]
    assert wanted.run is not None  # else it would be done elsewhere
    store = Store.open(database if "://" in database else Path(database))
    here = Work(store, Path(output) / JOBS / str(job_id), Path(output), _tell, cluster)
    try:
        made = wanted.run(here, wanted.arguments.model_validate_json(arguments))
    except OptionError as error:
        return Ended(reason=called_as_sent(here.output, error.by_field), fault=name_of(type(error)))
    except (GoniometerError, AnalysisError, DriverError) as error:
        return Ended(reason=called_as_sent(here.output, str(error)), fault=name_of(type(error)))
    except OSError as error:
        told = f"{error.filename or 'The output'}: {error.strerror or error}; make room, and run it again."
        return Ended(reason=told, fault=name_of(StoreFull))
    finally:
        store.close()
    return Ended(strict_json(made.result), made.page)
