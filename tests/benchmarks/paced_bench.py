"""The command line with a simulated bench that waits for stages and exposures, a sixtieth of what a real one would.

    python -m tests.benchmarks.paced_bench serve --mount-by-itself

The process that drives the bench loads this module as well, because it is started from it.
"""

import asyncio
import threading
import time

from api.commands.main import main
from simulators.devices.clock import SimulatedClock

PACE = 1 / 60
"""Seconds that pass for a second of the bench, on which a point takes half a minute; samples are exchanged at once."""

_at_once = SimulatedClock.advance_to


async def sleep(clock: SimulatedClock, seconds: float) -> None:
    """Wait as the driver of a real stage does."""
    moment = clock.now() + seconds
    await asyncio.sleep(PACE * seconds)
    _at_once(clock, moment)


def advance_to(clock: SimulatedClock, moment: float) -> None:
    """Wait in the thread of a device, as for a spectrum."""
    if threading.current_thread() is not threading.main_thread():
        time.sleep(max(0.0, PACE * (moment - clock.now())))
    _at_once(clock, moment)


SimulatedClock.sleep = sleep  # type: ignore[assignment]  # `clock` instead of `self`
SimulatedClock.advance_to = advance_to  # type: ignore[assignment]  # `clock` instead of `self`

if __name__ == "__main__":
    main()
