"""OWIS PS 10 and PS 90 motion controllers (one axis, and up to nine).

ASCII at 9600 8N1, lines that end with CR, positions in counts. A question begins with "?"; only questions are
answered, and an answer is bare: it names neither the question nor the axis and has no checksum, so that any number
could answer any question. Therefore each look at an axis begins with `?VERSION`, whose answer resembles no other, and
questions that numbers answer do not follow each other; nothing is believed that did not come twice in a row; and every
setting is read back before the axis moves. Why a command was refused is asked with `?MSG`.

The commands were compared with public clients of these controllers: `INIT`, `REF`, `EFREE`, `STOP`, `ABSOL`, `PSET`,
`PGO`, `PVEL`, `ACC` and `?VERSION`, `?ASTAT`, `?ESTAT`, `?CNT`, `?MODE`, `?MSG` are in use there. From memory are
`?REFST` (1 once the reference is found), the units of `PVEL` and `ACC`, and that `?MSG` answers with a number, 0 when
there is nothing to tell. No real device was touched.
"""

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from enum import IntEnum

from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.serial_port import ATTEMPTS, Query, SerialPort, line
from drivers.stage import AT_REST, DIRECTLY, Mounting, Stage

log = logging.getLogger(__name__)

END = b"\r"
"""Of every line, either way."""
INTEGER = re.compile(rb"[-+]?\d{1,10}\r")
"""A counter or a setting: 32 bits."""
LETTERS = re.compile(rb"[A-Z?]{1,9}\r")
"""What `?ASTAT` answers: one letter for each axis."""
VERSION = re.compile(rb"[A-Za-z][ -~]*\d[ -~]*\r")
"""What only `?VERSION` answers: it begins with a letter and contains a digit."""
MESSAGE = re.compile(rb"\d+([ -~]*)\r")
"""What `?MSG` answers: a number, in some terminal modes with words behind it."""

INITIALISING_TIME = 10.0
"""Seconds that an axis may take to be ready after `INIT`."""
RELEASING_TIME = 30.0
"""Seconds that an axis may take to leave its limit switch."""
START_TIME = 1.0
"""Seconds within which a motion must be seen to have begun."""
POLL = 0.1
"""Seconds between two looks meanwhile."""
ON_THE_WAY = 2.0
"""Seconds of travel by which two looks at a moving axis may differ."""

PHASES = {
    "I": StagePhase.NOT_REFERENCED,
    "O": StagePhase.DISABLED,
    "R": StagePhase.READY,
    "P": StagePhase.HOMING,
    "H": StagePhase.HOMING,
} | dict.fromkeys("TSVWXYCJNF", StagePhase.MOVING)
"""The letters of `?ASTAT`; the others are faults. I waits for `INIT`, H finds its phase, F leaves a switch."""

FAULTS = {
    "L": "it was switched off at a limit switch",
    "B": "it was braked at a limit switch",
    "A": "it was switched off after a limit switch error",
    "M": "it was switched off after an error of the motion controller",
    "Z": "it was switched off after a timeout",
    "E": "it was switched off after a motion error",
    "U": "it is not released; check the emergency stop and the enable input",
    "?": "the controller does not know its state",
}
"""The other letters of `?ASTAT`, in words."""

LIMIT_SWITCHES = 0x01 | 0x08
POWER_STAGE = 0x10
SWITCHES = {
    0x01: "low limit switch",
    0x02: "low brake switch",
    0x04: "high brake switch",
    0x08: "high limit switch",
    POWER_STAGE: "power stage error",
}
"""The bits of `?ESTAT`, in words."""


class ReferenceMode(IntEnum):
    """How `REF` finds the reference; only the ways after which the counter is set to 0."""

    INDEX = 3
    SWITCH = 4
    SWITCH_AND_INDEX = 5
    HIGH_THEN_LOW = 6
    """To the upper end, then to the lower one, where 0 is."""
    LOW_THEN_HIGH = 7
    """To the lower end, then to the upper one, where 0 is."""


@dataclass(frozen=True)
class Look:
    """What one axis shows at a moment."""

    letter: str
    """Its letter of `?ASTAT`."""
    counts: int
    """Its counter."""
    switches: int
    """Its bits of `?ESTAT`."""

    @property
    def phase(self) -> StagePhase:
        """What the axis is doing, as far as the letter and the power stage tell."""
        if self.switches & POWER_STAGE:
            return StagePhase.FAULT
        return PHASES.get(self.letter, StagePhase.FAULT)

    @property
    def words(self) -> str:
        """What is wrong, for an operator; empty when nothing is."""
        if self.phase is not StagePhase.FAULT:
            return ""
        reasons = [FAULTS[self.letter]] if self.letter in FAULTS else []
        return ", ".join(reasons + [text for bit, text in SWITCHES.items() if self.switches & bit])


class OwisPS(Stage):
    """A `RotationStage` on axis `axis` of a PS 10 (always 1) or a PS 90 (1 to 9).

    `url` is pyserial's; a PS 90 has one line for all its axes, which their drivers share. `counts_per_degree` are
    counts per degree that the stage reads, as configured by gear and micro-steps. `velocity` (degrees on the bench per
    second) and `acceleration` (degrees/s^2) are set whenever the axis is ready: the controller forgets them when it
    is switched off. `velocity_unit` and `acceleration_unit` are the counts/s and counts/s^2 of one unit of `PVEL` and
    `ACC`; a PS 90 may count these in its own cycle. `limits` are degrees on the bench, `timeout` is the longest wait
    for a reply (seconds), `reference_query` what asks whether the reference is known.
    """

    def __init__(
        self,
        name: str,
        url: str,
        clock: Clock,
        *,
        axis: int = 1,
        counts_per_degree: float,
        reference_mode: ReferenceMode = ReferenceMode.SWITCH,
        velocity: float = 10.0,
        acceleration: float = 20.0,
        velocity_unit: float = 1.0,
        acceleration_unit: float = 1.0,
        limits: tuple[float, float] = (-5.0, 90.0),
        mounting: Mounting = DIRECTLY,
        timeout: float = 1.0,
        baudrate: int = 9600,
        reference_query: str = "?REFST",
    ) -> None:
        super().__init__(name, clock, limits=limits, mounting=mounting)
        self.velocity = velocity
        self.acceleration = acceleration
        self._url = url
        self._axis = axis
        self._counts_per_degree = counts_per_degree
        self._reference_mode = reference_mode
        self._velocity_unit = velocity_unit
        self._acceleration_unit = acceleration_unit
        self._reference_query = reference_query
        self._version = b""
        self._axes = 0
        self._marker = Query(b"?VERSION" + END, self._is_version)
        self._port = SerialPort(
            name, url, baudrate=baudrate, timeout=timeout, missing=line(END), unmistakable=self._marker
        )

    async def open(self) -> None:
        """Connect, check that a PS controller with this axis answers and, where the axis is ready, set its speed.

        Raises `DeviceNotFound` when nothing answers and `ProtocolError` when something else does.
        """
        self._version, self._axes = b"", 0
        try:
            await self._port.open()
            self._version = await self._twice(self._marker)
            letters = await self._twice(Query(b"?ASTAT" + END, _has_form(LETTERS)))
            self._axes = len(letters.removesuffix(END))
            if not 1 <= self._axis <= self._axes:
                message = f"{self.name}: the controller at {self._url} has no axis {self._axis}"
                raise DeviceNotFound(message + f"; it has {self._axes}, counted from 1")
            await self._message()  # forget what somebody else left behind
            if (await self._look()).phase is StagePhase.READY:
                await self._set_speed()
        except DeviceTimeout as error:
            await self.close()
            message = f"{self.name}: no OWIS PS controller answers at {self._url}"
            raise DeviceNotFound(message + "; check its power, its cable and the baud rate") from error
        except (DriverError, asyncio.CancelledError):  # nor does a caller that gives up leave the line open
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        await self._port.close()

    async def identity(self) -> str:
        """Maker, what the controller says of itself, and the axis."""
        version = (await self._port.ask(self._marker)).removesuffix(END).decode("ascii")
        return f"OWIS {version}, axis {self._axis}"

    async def stop(self) -> None:
        """Stop moving at once; an axis that is not moving is left as it is.

        The request is sent twice: it has no reply, and twice does no harm.
        """
        request = self._command("STOP")
        self._port.send_now(request)
        await self._port.send(request, to_stop=True)
        await self._port.ask(self._marker)

    async def _read_state(self) -> StageState:
        look = await self._look()
        phase = look.phase
        if phase is StagePhase.READY and not await self._referenced():
            phase = StagePhase.NOT_REFERENCED
        return StageState(phase, look.counts / self._counts_per_degree, look.words)

    async def _read_position(self) -> float:
        return (await self._look()).counts / self._counts_per_degree

    async def _set_velocity(self, velocity: float) -> None:
        await self._set("PVEL", velocity * self._counts_per_degree / self._velocity_unit)

    async def _set_speed(self) -> None:
        """Set velocity and acceleration to what they should be; both are given in degrees on the bench."""
        await self._set_velocity(self.velocity * self._mounting.scale)
        acceleration = self.acceleration * self._mounting.scale
        await self._set("ACC", acceleration * self._counts_per_degree / self._acceleration_unit)

    async def _begin_homing(self) -> None:
        """Initialise the axis, which clears a fault, leave a limit switch, then begin to search."""
        await self._message()  # forget an older one
        await self._send("INIT")
        await self._wait("is not ready", _is_ready, INITIALISING_TIME)
        await self._set_speed()
        if (await self._look()).switches & LIMIT_SWITCHES:
            log.warning("%s: stands on a limit switch; leaving it", self.name)
            await self._send("EFREE")
            await self._wait("stands on its limit switch", _is_released, RELEASING_TIME)
        await self._send("REF", f"={int(self._reference_mode)}")
        await self._wait("does not search for its reference", self._searches_or_stands_at_zero, START_TIME)

    async def _searches_or_stands_at_zero(self, look: Look) -> bool:
        """A short search may be over before anybody looks; it leaves the axis at its reference, where counts begin."""
        if look.phase is StagePhase.READY and self._is_at(0, look.counts):
            return await self._referenced()
        return look.phase is StagePhase.HOMING

    async def _begin_move(self, reading: float) -> None:
        state = await self._read_state()
        if state.phase is not StagePhase.READY:
            words = f" ({state.message})" if state.message else ""
            raise DeviceRefused(f"{self.name}: cannot move, it is {state.phase.value}{words}; home it first")
        if not await self._is_absolute():
            await self._send("ABSOL")
            if not await self._is_absolute():
                raise DeviceRefused(f"{self.name}: does not count positions from zero: {await self._message()}")
        target = await self._set("PSET", reading * self._counts_per_degree)
        await self._send("PGO")

        async def has_begun(look: Look) -> bool:
            return look.phase is not StagePhase.READY or self._is_at(target, look.counts)

        await self._wait("does not move", has_begun, START_TIME)

    async def _wait(self, otherwise: str, condition: Callable[[Look], Awaitable[bool]], seconds: float) -> None:
        """Look until `condition` holds. Raises `DeviceFault` or `DeviceRefused` when it does not after `seconds`."""
        begin = self._clock.now()
        while True:
            elapsed = self._clock.now() - begin
            look = await self._look()
            if await condition(look):
                return
            if elapsed > seconds:
                break
            await self._clock.sleep(POLL)
        message = f"{self.name}: {otherwise} {seconds:g} s after the request: {look.words or await self._message()}"
        if look.phase is StagePhase.FAULT:
            raise DeviceFault(message + "; clear its cause, then home the stage")
        raise DeviceRefused(message + "; check the axis at the controller, then home the stage")

    async def _look(self) -> Look:
        """What the axis shows, when it shows it twice in a row. Raises `ProtocolError` when it never does.

        At rest the counter must be the same, too; where an encoder trembles, the middle one of several is taken.
        """
        looks = [await self._glance()]
        for _ in range(ATTEMPTS):
            looks.append(await self._glance())
            if self._agree(*looks[-2:]):
                return looks[-1]
        middle = sorted(looks, key=lambda look: look.counts)[len(looks) // 2]
        if all(replace(look, counts=0) == replace(middle, counts=0) for look in looks) and all(
            self._is_at(middle.counts, look.counts) for look in looks
        ):
            return middle
        message = f"{self.name}: never shows the same twice, last {looks[-2]} and {looks[-1]}"
        raise ProtocolError(message + "; check the cable and the brake")

    async def _glance(self) -> Look:
        async with self._port.turn:
            await self._port.ask(self._marker)
            counts = int(await self._port.ask(self._question("?CNT")))
            letters = (await self._port.ask(Query(b"?ASTAT" + END, self._is_letters))).decode("ascii")
            switches = _switches(await self._port.ask(self._question("?ESTAT")))
        return Look(letters[self._axis - 1], counts, switches)

    def _agree(self, before: Look, now: Look) -> bool:
        if PHASES.get(now.letter) in {StagePhase.MOVING, StagePhase.HOMING}:
            way = ON_THE_WAY * self.velocity * self._mounting.scale * self._counts_per_degree
            return replace(before, counts=now.counts) == now and abs(now.counts - before.counts) <= way
        if before != now:
            log.warning("%s: showed %s and then %s; looking again", self.name, before, now)
        return before == now

    def _is_at(self, target: int, counts: int) -> bool:
        return abs(counts - target) <= max(1.0, AT_REST * self._counts_per_degree)

    async def _referenced(self) -> bool:
        return int(await self._twice(self._question(self._reference_query))) == 1

    async def _is_absolute(self) -> bool:
        """Whether `PSET` counts from zero rather than from where the axis stands."""
        request = self._command("?MODE")
        reply = await self._twice(Query(request, lambda reply: reply in {b"ABSOL\r", b"RELAT\r"}))
        return reply == b"ABSOL\r"

    async def _twice(self, query: Query) -> bytes:
        """A reply that came twice in a row, each time behind that to `?VERSION`. Raises `ProtocolError`."""
        async with self._port.turn:
            before = b""
            for _ in range(1 + ATTEMPTS):
                await self._port.ask(self._marker)
                reply = await self._port.ask(query)
                if reply == before:
                    return reply
                if before:
                    log.warning("%s: answered %r and then %r to %r", self.name, before, reply, query.request)
                before = reply
        raise ProtocolError(f"{self.name}: never answers the same twice to {query.request!r}; check the cable")

    async def _set(self, letters: str, value: float) -> int:
        """Set a parameter to the nearest whole number, read it back and return it. Raises `DeviceRefused`."""
        number = round(value)
        await self._send(letters, f"={number}")
        taken = int(await self._twice(self._question(f"?{letters}")))
        if taken != number:
            message = f"{self.name}: the controller did not take {letters}{self._axis}={number} and keeps {taken}"
            raise DeviceRefused(f"{message}: {await self._message()}")
        return number

    async def _message(self) -> str:
        """The controller's last message, in words; it forgets it when it has told it."""
        async with self._port.turn:
            await self._port.ask(self._marker)
            reply = await self._port.ask(Query(b"?MSG" + END, _has_form(MESSAGE)))
        text = reply.decode("ascii").strip()
        if int(re.split(r"\D", text)[0]) == 0:
            return "the controller gives no reason, the request may have been lost on the line"
        return f"the controller says {text!r}"

    async def _send(self, letters: str, parameter: str = "") -> None:
        await self._port.send(self._command(letters, parameter))

    def _command(self, letters: str, parameter: str = "") -> bytes:
        return f"{letters}{self._axis}{parameter}".encode("ascii") + END

    def _question(self, letters: str) -> Query:
        """A question of this axis that a number answers."""
        return Query(self._command(letters), _has_form(INTEGER))

    def _is_version(self, reply: bytes) -> bool:
        """Whether this answers `?VERSION`; once known, only the very same does."""
        return VERSION.fullmatch(reply) is not None and self._version in {b"", reply}

    def _is_letters(self, reply: bytes) -> bool:
        return LETTERS.fullmatch(reply) is not None and len(reply) == self._axes + len(END)


def _has_form(pattern: re.Pattern[bytes]) -> Callable[[bytes], bool]:
    return lambda reply: pattern.fullmatch(reply) is not None


async def _is_ready(look: Look) -> bool:
    return look.phase is StagePhase.READY


async def _is_released(look: Look) -> bool:
    return look.phase is StagePhase.READY and not look.switches & LIMIT_SWITCHES


def _switches(reply: bytes) -> int:
    """Bits of `?ESTAT`; one public client reads a decimal number, another five digits with the lowest bit first."""
    digits = reply.removesuffix(END)
    if len(digits) == len(SWITCHES) and set(digits) <= set(b"01"):
        return int(digits[::-1], 2)
    return int(digits)
