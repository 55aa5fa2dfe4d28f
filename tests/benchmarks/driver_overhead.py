"""How long the drivers take for a point, without the time of motions and exposures.

    python -m tests.benchmarks.driver_overhead

Motions and exposures take no real time on the simulated clock. From the real time of a point is taken what the
simulators compute: the processor time of their threads and the time inside the USB backend. What is left is our code
with its threads, the system's sockets, and the pauses between frames that a serial Modbus line prescribes.
"""

import asyncio
import statistics
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any
from unittest.mock import patch

import numpy as np

from drivers.arrays import CountArray
from drivers.interfaces import StagePhase
from goniometer.geometry import Geometry
from simulators.bench.optics import OpticalBench
from tests.benchmarks.figures import tell
from tests.benchmarks.nights import RTU, bench

POINTS = 150
BENCHES = (("smc100", "oriental-az"), ("owis", "oriental-az"), ("smc100", "k10cr1"), ("smc100", RTU))
EXPOSURE = 0.1
"""Seconds, simulated."""
SLOW = {
    "owis": "its replies carry no echo, so each look is four questions, twice",
    RTU: "the line needs its silences, and an echo for each exchange",
}
"""Why a family of stages takes longer."""
FLAT = np.full(OpticalBench.pixels, 2000, dtype=np.uint32)


class _Usb:
    """Adds up the time inside the USB backend."""

    def __init__(self, backend: Any) -> None:
        self.seconds = 0.0
        for name in ("bulk_write", "bulk_read"):
            setattr(backend, name, self._timed(getattr(backend, name)))

    def _timed(self, call: Callable[..., int]) -> Callable[..., int]:
        def timed(*arguments: Any) -> int:
            begin = time.perf_counter()
            try:
                return call(*arguments)
            finally:
                self.seconds += time.perf_counter() - begin

        return timed


def _simulators() -> float:
    """Seconds of processor time that the threads of the simulated stages have used."""
    clocks = [
        time.pthread_getcpuclockid(thread.ident)
        for thread in threading.enumerate()
        if thread.name.startswith("simulated ") and thread.ident is not None
    ]
    return sum(time.clock_gettime(clock) for clock in clocks)


def _dark(*_: object, **__: object) -> CountArray:
    return FLAT


def _told(name: str, samples: list[float]) -> float:
    low, middle, high = statistics.quantiles([1000 * sample for sample in samples], n=4)
    print(f"  {name:44} {middle:6.2f} ms   (quartiles {low:.2f} to {high:.2f})")
    return middle


async def _measure(usb: _Usb, action: Callable[[int], Awaitable[object]]) -> list[float]:
    """[points] seconds that `action` takes beyond what the simulators compute."""
    samples = []
    for number in range(POINTS + 10):
        begin, simulated = time.perf_counter(), _simulators() + usb.seconds
        await action(number)
        samples.append(time.perf_counter() - begin - (_simulators() + usb.seconds - simulated))
    return samples[10:]


async def _one_bench(instrument: Any, backend: Any) -> float:
    """Print what everything takes; returns milliseconds for a point."""
    usb = _Usb(backend)
    await instrument.open()
    try:

        async def whole(number: int) -> None:
            await instrument.arm.goto(Geometry(30.0, -20.0 + 0.5 * (number % 100)))
            await instrument.expose(EXPOSURE)

        async def stage(which: Any, angle: float) -> None:
            # what `goto` asks of a stage: whether it is ready, then the move
            assert (await which.state()).phase is StagePhase.READY
            await which.move_to(angle)

        async def stay(which: Any) -> None:
            assert (await which.state()).phase is StagePhase.READY
            await which.position()

        sample, detector = instrument.arm.stages
        point = _told("point, whole (detector stage moves)", await _measure(usb, whole))
        _told("sample stage stays", await _measure(usb, lambda _: stay(sample)))
        _told("sample stage moves", await _measure(usb, lambda n: stage(sample, 20.0 + 0.5 * (n % 50))))
        _told("detector stage moves", await _measure(usb, lambda n: stage(detector, 20.0 + 0.5 * (n % 50))))
        _told("exposure", await _measure(usb, lambda _: instrument.expose(EXPOSURE)))
        _told("four exposures in a row", await _measure(usb, lambda _: instrument.sequence(EXPOSURE, 4)))
        return point
    finally:
        await instrument.close()


def main() -> int:
    """Print median and quartiles for each bench and each device of it."""
    for families in BENCHES:
        print(f"sample stage {families[0]}, detector stage {families[1]}, QE Pro")
        with patch.object(OpticalBench, "read_out", _dark), bench(0, families) as (laboratory, instrument):
            point = asyncio.run(_one_bench(instrument, laboratory.usb_backend))
        because = "; ".join(SLOW[family] for family in families if family in SLOW)
        tell(f"a point with {families[0]} and {families[1]}", point, "ms", "< 5", because)
    return 0


if __name__ == "__main__":
    sys.exit(main())
