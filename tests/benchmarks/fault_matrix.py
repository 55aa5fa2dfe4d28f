"""Every fault on every device, while the driver does its daily work.

    python -m tests.benchmarks.fault_matrix [COUNT]

prints a table of what came of COUNT (4) strikes for each fault and device.

A strike is one run: the device is opened, homed and used while a fault befalls it, then it is made usable again as
the bench would do it (`Instrument.recover`) and must work as on the first day. What must never happen is noted as a
breach: something false taken for data, a wait without end, an error that has no type, a thread or descriptor left.
"""

import asyncio
import contextlib
import logging
import os
import random
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from drivers.errors import DriverError
from drivers.modbus_line import PAUSES
from drivers.serial_port import ATTEMPTS
from simulators.devices.faults import LASTING, Fault, FaultScript, Kind
from tests.benchmarks.figures import tell
from tests.benchmarks.rigs import DEVICES, LASTS, NAME, TIMEOUT, Rig, make_rig

BLIND = {("K10CR1", Kind.DRIFT)}
"""What a driver cannot see: a mount without encoder that has lost steps."""


@dataclass
class Strike:
    """What came of one fault."""

    outcome: str = "ok"
    """"ok" where nobody noticed, "recovered" where something was tried again, else the name of the error."""
    retries: int = 0
    """Warnings of the driver."""
    happened: int = 0
    """How many requests were befallen."""
    seconds: float = 0.0
    """Real seconds, the work afterwards not included."""
    breaches: list[str] = field(default_factory=list)
    """What must never happen."""


class _Warnings(logging.Handler):
    """Counts the warnings of the drivers."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def longest(device: str, happened: int) -> float:
    """Real seconds that a run may take in which so many requests were befallen.

    The work without faults takes far less than two seconds. A request that was befallen may cost all attempts, each
    with bringing the line back into step first, which on a serial Modbus line is tried once for each of `PAUSES`.
    """
    step = sum(PAUSES) + (1 + len(PAUSES)) * TIMEOUT if device == "AZ on RTU" else TIMEOUT
    return 10.0 + happened * (ATTEMPTS + 1) * (TIMEOUT + LASTS + step)


def requests_of(device: str) -> int:
    """How many requests a day's work takes where nothing goes wrong."""
    rig = make_rig(device, [])
    rig.give_time()

    async def day() -> None:
        await rig.driver.open()
        await rig.work()
        await rig.driver.close()

    try:
        asyncio.run(day())
    finally:
        rig.close()
    return int(rig.simulator.script.requests)


def strike(device: str, kind: Kind, at: int, *, times: int = 1, seed: int = 0) -> Strike:
    """Let `kind` befall the request `at` and those after it, `times` in all, on a day's work with `device`."""
    result = Strike()
    before = _descriptors()
    rig = make_rig(device, result.breaches)
    rig.simulator.script = FaultScript([Fault(kind, at, times, seconds=LASTS if kind in LASTING else 0.0)], seed)
    script = rig.simulator.script
    warnings = _Warnings()
    logger = logging.getLogger("drivers")
    logger.addHandler(warnings)
    propagate, logger.propagate = logger.propagate, False
    try:
        asyncio.run(_day(device, rig, result, warnings))
    finally:
        logger.removeHandler(warnings)
        logger.propagate = propagate
        rig.close()
    result.happened = len(script.happened)
    if (device, kind) in BLIND:
        result.breaches[:] = [breach for breach in result.breaches if "while it stands at" not in breach]
    _look_for_leaks(before, result)
    return result


async def _day(device: str, rig: Rig, result: Strike, warnings: _Warnings) -> None:
    begin = time.monotonic()
    script = rig.simulator.script

    async def day() -> None:
        await rig.driver.open()
        await rig.work()

    await _bounded(device, day, result, script)
    result.seconds = time.monotonic() - begin
    result.retries = warnings.count
    if result.outcome == "ok" and warnings.count:
        result.outcome = "recovered"
    # a person has repaired what is broken; the bench does the rest
    rig.simulator.script = FaultScript()
    rig.repair()
    rig.give_time()
    await _bounded_revival(rig, result)
    await rig.driver.close()
    await rig.driver.close()


async def _bounded(device: str, work: Callable[[], Awaitable[None]], result: Strike, script: FaultScript) -> None:
    """Do `work` and note how it ends; one that does not end is a breach."""
    task = asyncio.ensure_future(work())
    begin = time.monotonic()
    while not task.done():
        await asyncio.wait({task}, timeout=0.5)
        if time.monotonic() - begin > longest(device, len(script.happened)):
            task.cancel()
            await asyncio.wait({task}, timeout=5.0)
            result.breaches.append(f"hung for {time.monotonic() - begin:.1f} s")
            return
    error = task.exception()
    if isinstance(error, DriverError):
        result.outcome = type(error).__name__
        if not str(error).startswith(NAME):
            result.breaches.append(f"an error that does not name the device: {error}")
    elif error is not None:
        result.breaches.append(f"an error without a type: {error!r}")


async def _bounded_revival(rig: Rig, result: Strike) -> None:
    """The device must work again, once a cable that was pulled is back."""
    failure: DriverError | None = None
    for _ in range(5):
        try:
            async with asyncio.timeout(20.0):
                await rig.revive()
                failure = None
            break
        except DriverError as error:
            failure = error
            await rig.clock.sleep(5.0)
            await asyncio.sleep(LASTS / 2)
    try:
        async with asyncio.timeout(20.0):
            if failure is not None:
                raise failure
            await rig.work()
    except (DriverError, TimeoutError) as error:
        result.breaches.append(f"does not work again: {error!r}")


def _descriptors() -> int:
    with contextlib.suppress(FileNotFoundError):
        return len(os.listdir("/proc/self/fd"))
    return 0


def _look_for_leaks(descriptors: int, result: Strike) -> None:
    deadline = time.monotonic() + 60
    while True:
        threads = [thread.name for thread in threading.enumerate() if thread.name.startswith((NAME, "simulated "))]
        left = _descriptors() - descriptors
        if not threads and left <= 0:
            return
        if time.monotonic() > deadline:
            result.breaches.append(f"left {left} descriptors and the threads {threads}")
            return
        time.sleep(0.005)


def moments(device: str, kind: Kind, count: int, requests: int) -> list[tuple[int, int]]:
    """When to strike and how many requests in a row: spread over the day; the last blow is a longer one."""
    chance = random.Random(f"{device} {kind}")
    blows = []
    for number in range(count):
        at = 1 + int(requests * (number + chance.random()) / count)
        blows.append((at, 6 if number == count - 1 and count > 1 else 1))
    return blows


def main(count: int) -> int:
    """Print the matrix with `count` strikes in each cell; returns 1 where there was a breach."""
    requests = {device: requests_of(device) for device in DEVICES}
    print("requests of a day's work:", ", ".join(f"{device} {number}" for device, number in requests.items()))
    print(f"{'':14}" + "".join(f"{device:>27}" for device in DEVICES))
    breaches = []
    for kind in Kind:
        row = f"{kind:14}"
        for device in DEVICES:
            strikes = [
                strike(device, kind, at, times=times, seed=at)
                for at, times in moments(device, kind, count, requests[device])
            ]
            breaches += [f"{kind} on {device}: {breach}" for s in strikes for breach in s.breaches]
            names = list(dict.fromkeys(s.outcome for s in strikes))
            words = "/".join(name.replace("Device", "").replace("Error", "") for name in names)
            retries = sum(s.retries for s in strikes)
            row += f"{words}{f'({retries})' if retries else ''} {max(s.seconds for s in strikes):.2f} s".rjust(27)
        print(row, flush=True)
    print(*breaches, sep="\n")
    tell(f"strikes: {len(Kind)} faults on {len(DEVICES)} devices, {count} of each", count * len(Kind) * len(DEVICES))
    tell(
        "breaches: wrong data, a hang, an error without type, a leak, a device of no use afterwards",
        len(breaches),
        aim="= 0",
    )
    return bool(breaches)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 4))
