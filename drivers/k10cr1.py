"""Thorlabs K10CR1 motorised rotation mount, on the serial line inside its USB plug.

Binary APT messages at 115200 8N1 with RTS/CTS. The mount has a stepper motor and no encoder: it counts the steps
that it commands, so its position is where it should be. It knows no place until it has been homed after switching
on, and moves all the same when it is told to; that is refused here.

A message has no checksum. So what is read counts only when it comes twice.

Where the controller's units come from: a degree of the mount is 409600/3 microsteps; its velocity unit is a microstep
per second divided by 53.68, that of the acceleration a microstep per second squared times 90.9 (Thorlabs' protocol,
under "Conversion between position, velocity and acceleration values"). Unchecked on a device: that a fault is cleared
by disabling and enabling the motor, and that the controller words a refusal as message 0x0081.

The distance by which the controller passes a target on its way backwards, against backlash, is set to 0: who commands
the stage knows where it may stand, and takes up the backlash of every family alike.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from drivers import apt
from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.serial_port import Query, SerialPort
from drivers.stage import AT_REST, DIRECTLY, Mounting, Stage
from drivers.travel import ALLOWANCE, POLL_INTERVAL, wait_for_rest

COUNTS_PER_DEGREE = 409600 / 3
"""Microsteps in a degree."""
VELOCITY_UNITS = COUNTS_PER_DEGREE * 53.68
"""In a degree per second."""
ACCELERATION_UNITS = COUNTS_PER_DEGREE / 90.9
"""In a degree per second squared."""
HOMING_VELOCITY = 5.0
"""Degrees per second of the search for the reference mark; some mounts wake up with 0.01, which takes hours."""
START_TIME = 1.0
"""Seconds that a motor may take to begin what it was told."""
READINGS = 7
"""How often something is read until two readings in a row agree."""

MOVING, SEARCHING, REFERENCED, ENABLED = 0xF0, 0x200, 0x400, 0x80000000
"""Status bits: moving or jogging either way, homing, homed, motor under power."""
FAULTS = {
    0x00004000: "motion error",
    0x00008000: "instrument error",
    0x00020000: "too hot",
    0x00040000: "supply voltage out of range",
    0x00080000: "commutation error",
    0x01000000: "motor current limit",
    0x02000000: "encoder fault",
    0x04000000: "motor overcurrent",
    0x08000000: "supply current fault",
    0x40000000: "error",
}
"""The status bits that mean a fault, in words."""
FAULTY = sum(FAULTS)
RELEVANT = MOVING | SEARCHING | REFERENCED | ENABLED | FAULTY
"""The status bits that are used; the others may change as they like."""

STATUS = Query(apt.short(apt.REQUEST_STATUS, apt.CHANNEL), lambda frame: apt.number_of(frame) == apt.STATUS)
INFO = Query(apt.short(apt.REQUEST_INFO), lambda frame: apt.number_of(frame) == apt.INFO)
VELOCITY = Query(apt.short(apt.REQUEST_VELOCITY, apt.CHANNEL), lambda frame: apt.number_of(frame) == apt.VELOCITY)
BACKLASH = Query(apt.short(apt.REQUEST_BACKLASH, apt.CHANNEL), lambda frame: apt.number_of(frame) == apt.BACKLASH)
HOMING = Query(apt.short(apt.REQUEST_HOMING, apt.CHANNEL), lambda frame: apt.number_of(frame) == apt.HOMING)

T = TypeVar("T")

log = logging.getLogger(__name__)


class K10CR1(Stage):
    """A `RotationStage` on a K10CR1.

    `url` is pyserial's; `serial_number`, where given, is the one that must answer; `velocity` (degrees/s, 10 at most)
    and `acceleration` (degrees/s^2, 20 at most) on the bench are set when it is opened; `limits` are the lowest and
    highest angle that may be commanded (degrees), `timeout` the longest wait for a reply (seconds).
    """

    def __init__(
        self,
        name: str,
        url: str,
        clock: Clock,
        *,
        serial_number: int | None = None,
        velocity: float = 10.0,
        acceleration: float = 10.0,
        limits: tuple[float, float] = (-5.0, 90.0),
        mounting: Mounting = DIRECTLY,
        timeout: float = 1.0,
    ) -> None:
        super().__init__(name, clock, limits=limits, mounting=mounting)
        self.velocity = velocity
        self.acceleration = acceleration
        self._url = url
        self._serial_number = serial_number
        self._port = SerialPort(
            name, url, baudrate=115200, timeout=timeout, missing=apt.missing, unmistakable=INFO, rtscts=True
        )

    async def open(self) -> None:
        """Connect, check that the right K10CR1 answers and set how fast it moves.

        Raises `DeviceNotFound` when nothing answers, `ProtocolError` when something else does and `DeviceRefused`
        when it does not take the velocity.
        """
        try:
            await self._port.open()
            info = await self._info()
            if not info.model.startswith("K10CR1"):
                raise ProtocolError(f"{self.name}: {info.model!r} answers at {self._url} instead of a K10CR1")
            if self._serial_number not in {None, info.serial_number}:
                raise ProtocolError(
                    f"{self.name}: the K10CR1 at {self._url} has the serial number {info.serial_number} instead of"
                    f" {self._serial_number}; exchange the addresses or the cables"
                )
            await self._port.send(apt.short(apt.STOP_UPDATES))
            await self._read_status()
            await self._prepare()
        except DeviceTimeout as error:
            await self.close()
            message = f"{self.name}: no K10CR1 answers at {self._url}; check its power, its cable and the address"
            raise DeviceNotFound(message) from error
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        await self._port.close()

    async def identity(self) -> str:
        """Maker, model, serial number and firmware."""
        info = await self._info()
        return f"Thorlabs {info.model} {info.serial_number} firmware {info.firmware}"

    async def stop(self) -> None:
        """Stop moving at once, with the set deceleration: without it the motor would lose steps and not know it.

        A stage that is not moving is left as it is.
        """
        request = apt.short(apt.STOP, apt.CHANNEL, apt.PROFILED)
        self._port.send_now(request)
        if (await self._read_status()).bits & (MOVING | SEARCHING):
            # nothing says that it was not lost on the way; a motor that brakes already does not mind another
            self._port.send_now(request)
            await self._read_status()

    async def _read_state(self) -> StageState:
        status = await self._read_status()
        position = status.position / COUNTS_PER_DEGREE
        faults = [words for bit, words in FAULTS.items() if status.bits & bit]
        if faults:
            return StageState(StagePhase.FAULT, position, ", ".join(faults))
        return StageState(_phase(status.bits), position)

    async def _read_position(self) -> float:
        return (await self._read_status()).position / COUNTS_PER_DEGREE

    async def _set_velocity(self, velocity: float) -> None:
        setting = apt.VelocitySetting(
            acceleration=round(self.acceleration * self._mounting.scale * ACCELERATION_UNITS),
            velocity=round(velocity * VELOCITY_UNITS),
        )
        await self._set(apt.SET_VELOCITY, setting, VELOCITY)

    async def _prepare(self) -> None:
        """Set how fast it moves, and that it goes straight to its target."""
        await self._set_velocity(self.velocity * self._mounting.scale)
        await self._set(apt.SET_BACKLASH, apt.BacklashSetting(0), BACKLASH)

    async def _begin_homing(self) -> None:
        """Stop what is under way, clear a fault, and set a velocity at which the search comes to an end."""
        state = await self._read_state()
        if state.phase in {StagePhase.MOVING, StagePhase.HOMING}:
            await self.stop()
            braking = self.velocity / self.acceleration
            await wait_for_rest(self.name, self._clock, self.state, expected=braking, at_most=braking + ALLOWANCE)
        if state.phase in {StagePhase.FAULT, StagePhase.DISABLED}:
            await self._port.send(apt.short(apt.SET_ENABLED, apt.CHANNEL, apt.DISABLE))
            await self._port.send(apt.short(apt.SET_ENABLED, apt.CHANNEL, apt.ENABLE))
        await self._prepare()  # the mount may have been switched off since it was opened
        setting = await self._read_twice(HOMING, apt.HomingSetting.read)
        setting = replace(setting, velocity=round(HOMING_VELOCITY * VELOCITY_UNITS))
        await self._set(apt.SET_HOMING, setting, HOMING)
        await self._command(apt.short(apt.HOME, apt.CHANNEL), lambda status: bool(status.bits & SEARCHING))

    async def _begin_move(self, reading: float) -> None:
        state = await self._read_state()
        if state.phase is not StagePhase.READY:
            # by itself it would move, but from a zero where it happened to be switched on
            what = "wait, or stop it first" if state.phase is StagePhase.MOVING else "home it first"
            raise DeviceRefused(f"{self.name}: is {state.phase.value}, not ready; {what}")
        target = round(reading * COUNTS_PER_DEGREE)
        status = await self._command(
            apt.long(apt.MOVE_TO, apt.MOVE_DATA.pack(apt.CHANNEL, target)),
            lambda status: bool(status.bits & MOVING) or status.position == target or not status.bits & REFERENCED,
        )
        if not status.bits & REFERENCED:
            await self.stop()
            raise DeviceFault(f"{self.name}: had lost its reference when it began to move, and was stopped; home it")

    async def _set(
        self, number: int, setting: apt.VelocitySetting | apt.HomingSetting | apt.BacklashSetting, query: Query
    ) -> None:
        """Change a setting and read it back. Raises `DeviceRefused` when it has become another."""
        await self._tell(apt.long(number, setting.data()), query)
        kept = await self._read_twice(query, type(setting).read)
        if kept != setting:
            raise DeviceRefused(f"{self.name}: the K10CR1 was told {setting} and keeps {kept}; ask for less, or again")

    async def _command(self, command: bytes, begun: Callable[[apt.Status], bool]) -> apt.Status:
        """Send a command that moves, once, and return the first status that shows what came of it.

        Raises `DeviceRefused` when the mount says so, and `DeviceTimeout` when nothing happens.
        """
        await self._tell(command, STATUS)
        begin = self._clock.now()
        while True:
            elapsed = self._clock.now() - begin
            status = await self._read_status()
            if begun(status) or status.bits & FAULTY:
                return status
            if elapsed > START_TIME:
                raise DeviceTimeout(
                    f"{self.name}: did not begin to move within {START_TIME:g} s of being told; check its power and"
                    " its cable, then tell it again"
                )
            await self._clock.sleep(POLL_INTERVAL)

    async def _tell(self, command: bytes, query: Query) -> None:
        """Send `command` and `query` in one write, so that a refusal comes before the answer. Raises `DeviceRefused`.

        Whether the command was taken is not known when neither comes; the caller reads back.
        """
        number = apt.number_of(command)

        def refused(frame: bytes) -> bool:
            return apt.number_of(frame) == apt.REFUSED and _refusal(frame)[0] == number

        both = Query(command + query.request, lambda frame: query.wanted(frame) or refused(frame))
        try:
            reply = await self._port.ask(both, attempts=1)
        except (DeviceTimeout, ProtocolError) as error:
            log.warning("%s; reading back what became of the command", error)
            return
        if refused(reply):
            await self._info()  # the answer to the query is still to come, and must not be taken for another
            _, code, words = _refusal(reply)
            raise DeviceRefused(f"{self.name}: the K10CR1 refused message 0x{number:04X}: {words} (code {code})")

    async def _info(self) -> apt.Info:
        return await self._read_twice(INFO, apt.Info.read)

    async def _read_status(self) -> apt.Status:
        return await self._read_twice(STATUS, apt.Status.read, _alike)

    async def _read_twice(
        self, query: Query, read: Callable[[bytes], T], alike: Callable[[T, T], bool] = lambda one, other: one == other
    ) -> T:
        """What two answers in a row agree on. Raises `ProtocolError` when none of `READINGS` do."""
        last = read(await self._port.ask(query))
        for _ in range(READINGS - 1):
            before, last = last, read(await self._port.ask(query))
            if alike(before, last):
                return last
            log.warning("%s: answered %s and then %s; asking again", self.name, before, last)
        raise ProtocolError(f"{self.name}: answers {last} and something else each time before; check the cable")


def _alike(one: apt.Status, other: apt.Status) -> bool:
    """Whether two readings one after the other can both be true."""
    if (one.bits ^ other.bits) & RELEVANT & ~MOVING or bool(one.bits & MOVING) != bool(other.bits & MOVING):
        return False
    moves = bool(one.bits & (MOVING | SEARCHING))
    return moves or abs(one.position - other.position) <= AT_REST * COUNTS_PER_DEGREE


def _phase(bits: int) -> StagePhase:
    """What a mount without a fault is doing."""
    if not bits & ENABLED:
        return StagePhase.DISABLED  # without power it may be turned by hand, and does not know
    if bits & SEARCHING:
        return StagePhase.HOMING
    if bits & MOVING:
        return StagePhase.MOVING
    return StagePhase.READY if bits & REFERENCED else StagePhase.NOT_REFERENCED


def _refusal(frame: bytes) -> tuple[int, int, str]:
    """The number of the message that a `REFUSED` frame is about, its code and its words."""
    number, code, words = apt.REFUSED_DATA.unpack_from(frame, apt.HEADER.size)
    return number, code, words.partition(b"\0")[0].decode("ascii", errors="backslashreplace")
