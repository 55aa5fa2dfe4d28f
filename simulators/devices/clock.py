"""Time on the simulated bench: it passes when somebody waits for it, and only then."""

import asyncio
import threading


class SimulatedClock:
    """A clock that jumps to whatever moment is waited for.

    Two waits that overlap cost the longer of the two, as on a real bench. It is shared by drivers and
    simulators, which run in several threads.
    """

    def __init__(self) -> None:
        self._now = 0.0
        self._lock = threading.Lock()

    def now(self) -> float:
        """Simulated seconds."""
        with self._lock:
            return self._now

    def advance_to(self, moment: float) -> None:
        """Let time pass until `moment`, unless it has passed already."""
        with self._lock:
            self._now = max(self._now, moment)

    async def sleep(self, seconds: float) -> None:
        """Let other tasks run, then let `seconds` pass."""
        moment = self.now() + seconds
        await asyncio.sleep(0)
        self.advance_to(moment)
