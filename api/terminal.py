"""The person at the terminal: what is asked of them, and how the signals that end a process end it properly."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import threading
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.text import Text

from api.mount_request import mount_request
from goniometer.errors import RunAborted

if TYPE_CHECKING:
    from goniometer.records import Scan

Result = TypeVar("Result")

LONGEST_LINE = 10_000
"""Characters of a line that goes to no terminal."""


class Terminal(Console):
    """What is printed on a terminal, which nothing that comes from a file or another person can command.

    In a log or a pipe a sentence stays one line, so that it can be searched for.
    """

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        if not self.is_terminal:
            self.width = LONGEST_LINE

    def render_str(self, text: str, **how: Any) -> Text:
        """A text as it is shown, also that of a cell of a table."""
        from goniometer.wording import inert

        return super().render_str(inert(text), **how)


screen = Terminal(stderr=True)
"""For progress and messages; results go to stdout."""


async def ask_to_mount(scan: Scan) -> None:
    """Ask a person to mount a sample; returns when Enter is pressed, raises `RunAborted` without a terminal."""
    request, check = mount_request(scan)
    what = "the reference panel (Spectralon)" if scan.kind == "reference" else scan.sample
    state = "turned" if scan.kind == "spot" else "mounted"
    await confirm(f"{what} is {state}", f"{request}, {check}, and press Enter.")


async def confirm(state: str, request: str) -> None:
    """Print `request` and return when Enter is pressed; `RunAborted` without a terminal, as nobody confirms `state`."""
    if sys.stdin is None or not sys.stdin.isatty():
        raise RunAborted(f"Nobody can confirm that {state}, as there is no terminal; run this from one.")
    _forget_typed_ahead()
    screen.print(request, markup=False, highlight=False)
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
    """Do `work`; the signals that end a process end it properly, with the bench made safe."""

    async def guarded() -> Result:
        task = asyncio.current_task()
        assert task is not None  # this is one
        for name in ("SIGTERM", "SIGHUP"):
            with contextlib.suppress(AttributeError, NotImplementedError):  # Windows has no such signals
                asyncio.get_running_loop().add_signal_handler(getattr(signal, name), task.cancel)
        return await work

    return asyncio.run(guarded())
