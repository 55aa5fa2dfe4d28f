"""A thread of its own for each device whose library blocks."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


class DeviceThread:
    """Runs the blocking calls of one device, one after the other, away from the event loop.

    Each call is a whole exchange (request and reply). When the caller is cancelled, a call that has begun
    still runs to its own end, bounded by the device's timeout, and the next call waits for it; so no reply is
    ever left half-read, and two exchanges never interleave.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._executor: ThreadPoolExecutor | None = None

    async def run(self, call: Callable[..., T], *arguments: object) -> T:
        """Return `call(*arguments)`, or raise what it raises."""
        if self._executor is None:
            self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self._name)
        return await asyncio.get_running_loop().run_in_executor(self._executor, call, *arguments)

    async def finish(self, last_call: Callable[[], None]) -> None:
        """Run `last_call` and end the thread; a later `run` starts a new one.

        Both happen also when the caller is cancelled: what `last_call` gives back must not stay taken.
        """
        if self._executor is not None:
            await asyncio.shield(self._end(self._executor, last_call))

    async def _end(self, executor: ThreadPoolExecutor, last_call: Callable[[], None]) -> None:
        try:
            await self.run(last_call)
        finally:
            executor.shutdown(wait=False)
            if self._executor is executor:  # two that finish at once end one thread
                self._executor = None
