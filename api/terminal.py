"""The person at the terminal: what is asked of them, and how the signals that end a process end it properly."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Coroutine
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from api.mount_request import mount_request
from goniometer.errors import RunAborted

if TYPE_CHECKING:
    from api.inert_console import InertConsole
    from goniometer.storage.records import Scan

Result = TypeVar("Result")


class Stopped(BaseException):
    """A signal has ended the work."""


def stdout() -> InertConsole:
    """For results."""
    from api.inert_console import InertConsole

    return InertConsole()


@cache
def stderr() -> InertConsole:
    """For progress and messages."""
    from api.inert_console import InertConsole

    return InertConsole(stderr=True)


async def ask_to_mount(scan: Scan) -> None:
    """Ask a person to mount a sample; returns when Enter is pressed, raises `RunAborted` without a terminal."""
    request, check = mount_request(scan)
    what = "the reference panel (Spectralon)" if scan.kind == "reference" else scan.sample
    state = "turned" if scan.kind == "spot" else "mounted"
    await confirm(f"{what} is {state}", f"{request}, {check}, and press Enter.")


async def confirm(state: str, request: str) -> None:
    """Print `request` and return when Enter is pressed; `RunAborted` without a terminal, as nobody confirms `state`."""
    import asyncio

    if sys.stdin is None or not sys.stdin.isatty():
        raise RunAborted(f"Nobody can confirm that {state}, as there is no terminal; run this from one.")
    _forget_typed_ahead()
    stderr().print(request, markup=False, highlight=False)
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[str] = loop.create_future()

    def deliver(line: str) -> None:
        if not answer.done():
            answer.set_result(line)

    def read() -> None:
        line = ""
        with contextlib.suppress(OSError):  # a terminal that has gone says nothing any more
            line = sys.stdin.readline()
        with contextlib.suppress(RuntimeError):  # the run that asked is over and its loop closed
            loop.call_soon_threadsafe(deliver, line)

    # A daemon, because nothing can end a thread that waits for a key, and an abort must not wait for it.
    threading.Thread(target=read, daemon=True).start()
    if not await answer:
        raise RunAborted(f"Nobody can confirm that {state}, as the terminal was closed; run this again.")


def _forget_typed_ahead() -> None:
    """Throw away keys that were pressed before the question was asked: they are no answer to it."""
    if sys.platform == "win32":
        import msvcrt

        while msvcrt.kbhit():
            msvcrt.getch()
    else:
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def wait(work: Coroutine[Any, Any, Result]) -> Result:
    """Do `work`; the signals that end a process end it properly, with the bench made safe, and raise `Stopped`."""
    import asyncio

    async def guarded() -> Result:
        task = asyncio.current_task()
        assert task is not None  # this is one
        for name in ("SIGTERM", "SIGHUP"):
            with contextlib.suppress(AttributeError, NotImplementedError):  # Windows has no such signals
                asyncio.get_running_loop().add_signal_handler(getattr(signal, name), task.cancel)
        return await work

    try:
        return asyncio.run(guarded())
    except asyncio.CancelledError:
        raise Stopped from None
