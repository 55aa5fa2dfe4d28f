"""The time that a bench lives in.

Drivers wait on a clock rather than on the wall, so that the same driver code runs a real bench in real
time and a simulated one as fast as the computer allows.
"""

import asyncio
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds, and a way to wait for them."""

    def now(self) -> float:
        """Seconds since an arbitrary start; never goes backwards."""

    async def sleep(self, seconds: float) -> None:
        """Return when `now()` has grown by at least `seconds`."""


class WallClock:
    """Real time."""

    def now(self) -> float:
        """Seconds of the operating system's monotonic clock."""
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait `seconds` of real time."""
        await asyncio.sleep(seconds)
