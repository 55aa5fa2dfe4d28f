"""Moves of the stages, none of which is believed because it was commanded."""

import asyncio
import logging
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.clock import Clock
from drivers.errors import DeviceFault, DriverError, ProtocolError
from drivers.interfaces import RotationStage, StagePhase, StageState
from drivers.travel import longest_travel

ARRIVAL = 0.1
"""Degrees between the angle that a stage was sent to and the one that it reads back."""

TWICE = 0.01
"""Degrees by which two readings of a stage at rest may differ."""

log = logging.getLogger(__name__)


def not_ready(stage: RotationStage, state: StageState) -> str:
    """What is wrong with a stage that is not ready, as a sentence."""
    why = f" ({state.message})" if state.message else ""
    return f"{stage.name}: is {state.phase.value}{why}, not ready; was it switched off? Home it"


@dataclass(frozen=True)
class Move:
    """A move of one stage, angles in degrees."""

    stage: RotationStage
    here: float
    """Where it was read last."""
    wanted: float
    stays: bool
    """Whether it is there already, and is only looked at."""


async def home(stage: RotationStage) -> float:
    """Find the reference mark of one stage; returns the angle read back."""
    await stage.home()
    return await stage.position()


async def ready(stage: RotationStage) -> float:
    """Where a stage rests, ready to move; raises `DeviceFault` where it is not."""
    state = await stage.state()
    if state.phase is not StagePhase.READY:
        raise DeviceFault(not_ready(stage, state))
    return state.position


async def bring(clock: Clock, moves: Sequence[Move]) -> tuple[float, ...]:
    """Make all moves; returns the angles read back, in their order.

    The stages begin at once and are then awaited one after the other, each however the one before has ended, so that no
    stage is left unwatched; when all rest does not depend on whose reply comes first. Raises the first thing that went
    wrong.
    """
    begun = await asyncio.gather(*(_begin(move) for move in moves), return_exceptions=True)
    moment = clock.now()
    reached: list[float] = []
    faults: list[BaseException] = []
    for move, seconds in zip(moves, begun, strict=True):
        if isinstance(seconds, BaseException):
            faults.append(seconds)
            continue
        try:
            reached.append(await _end(move, max(moment + seconds - clock.now(), 0.0)))
        except DriverError as error:
            faults.append(error)
    if faults:
        raise faults[0]
    return tuple(reached)


async def _begin(move: Move) -> float:
    """Begin a move and return how long it should take, seconds."""
    return 0.0 if move.stays else await move.stage.begin_move(move.wanted)


async def _end(move: Move, seconds: float) -> float:
    """Wait for a move that should still take so long; returns the angle read back."""
    stage = move.stage
    reached = await (stage.position() if move.stays else stage.arrive(move.wanted, seconds))
    if move.stays and abs(reached - move.here) > TWICE:
        raise ProtocolError(
            f"{stage.name}: reads {move.here:.3f}° and then {reached:.3f}° at rest; check the cable and the brake"
        )
    if not abs(reached - move.wanted) <= ARRIVAL:  # also where it is no number
        raise DeviceFault(
            f"{stage.name}: reads {reached:.3f}° where it was sent to {move.wanted:.3f}°; look for an obstacle"
        )
    return reached


async def both(first: Coroutine[Any, Any, float], second: Coroutine[Any, Any, float]) -> tuple[float, float]:
    """Two moves at once; when one fails the other is still awaited, so that no stage is left unwatched."""
    results = await asyncio.gather(first, second, return_exceptions=True)
    if isinstance(results[0], BaseException):
        raise results[0]
    if isinstance(results[1], BaseException):
        raise results[1]
    return results[0], results[1]


async def faults_of(*actions: Coroutine[Any, Any, None]) -> list[DriverError]:
    """Begin all actions in this order, wait for all, and return what went wrong; what is no fault is raised."""
    faults: list[DriverError] = []
    for result in await asyncio.gather(*actions, return_exceptions=True):
        if isinstance(result, DriverError):
            log.warning("%s", result)
            faults.append(result)
        elif result is not None:
            raise result
    return faults


async def followed(
    stage: RotationStage, clock: Clock, target: float, seconds: float, look: float
) -> list[tuple[float, float]]:
    """Where a stage is that has begun to move to `target`, degrees, from look to look until it rests there.

    Pairs of a moment, seconds on the clock, and an angle, degrees. The motion should take `seconds`; `look` is the time
    between two of them. Raises as `RotationStage.arrive` does.
    """
    track: list[tuple[float, float]] = []
    latest = clock.now() + longest_travel(seconds)
    phase = StagePhase.MOVING
    while phase is StagePhase.MOVING and clock.now() < latest:
        await clock.sleep(look)
        asked = clock.now()
        state = await stage.state()
        phase = state.phase
        track.append(((asked + clock.now()) / 2, state.position))
    await stage.arrive(target)
    return track
