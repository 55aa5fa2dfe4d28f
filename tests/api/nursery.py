"""Commands in processes of their own that need not load the program again: children of one that has loaded it.

    python -m tests.api.nursery

Loading takes longer than most commands that tests give. Each line on stdin is a job, a JSON object of the arguments,
the folder, the files for stdin, stdout and stderr and the seconds that it may take; the answer is a line with the exit
code, or "null" where it took longer. The children have a session of their own, so that what they start ends with them.
"""

import gc
import importlib
import json
import os
import signal
import sys
import time
from contextlib import suppress
from types import ModuleType
from typing import Any, NoReturn

from api.commands.main import main

HEAVY = (
    "analysis.reports.photographs",
    "api.characterise",
    "api.results.choose",
    "api.commands.demo",
    "api.exports.formats",
    "api.simulated.gratings",
    "api.results.imports",
    "api.preview",
    "api.results.quality",
    "api.simulated.ray_page",
    "api.results.render",
    "api.results.stability",
    "api.simulated.surface_page",
    "api.results.tradeoff",
    "api.simulated.wave_page",
    "colour",
    "lmfit",
    "matplotlib.pyplot",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.stats",
    "simulators.photographs.session",
)
"""What the commands load where they use it."""


def serve() -> None:
    """Do one job after the other until stdin ends."""
    for name in HEAVY:
        importlib.import_module(name)
    gc.freeze()  # what is loaded stays; a child that ends need not look through it
    for line in sys.stdin:
        job = json.loads(line)
        child = os.fork()
        if child == 0:
            run(job)
        print(json.dumps(code_of(child, job["timeout"])), flush=True)


def run(job: dict[str, Any]) -> NoReturn:
    """Be the command that the job asks for."""
    os.setsid()
    os.chdir(job["cwd"])
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for number, path in enumerate((job["stdin"], job["stdout"], job["stderr"])):
        file = os.open(path, flags if number else os.O_RDONLY, 0o600)
        os.dup2(file, number)
        os.close(file)
    # a pool's process loads what its work needs, and not this module, as it would load the one that the command ran
    sys.modules["__main__"] = ModuleType("__main__")
    sys.argv = ["goniometer", *job["arguments"]]
    main()


def code_of(child: int, timeout: float) -> int | None:
    """The exit code of a child, negative for a signal as `subprocess` has it; None where it had to be ended."""
    deadline = time.monotonic() + timeout
    pause = 0.001
    while time.monotonic() < deadline:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(pause)
        pause = min(2 * pause, 0.02)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


if __name__ == "__main__":
    serve()
