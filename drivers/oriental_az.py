"""Oriental Motor AZ driver with a DG hollow rotary table, over Modbus TCP or RTU.

Registers are 32 bits wide, two Modbus registers each, high word first. A motion is one "direct data operation":
type, position, speed, ramps and trigger written together. The constants below whose comment says "unchecked"
come from memory and were not checked on a device: compare them with the manual of yours before it moves.
"""

import asyncio
import logging

from drivers.clock import Clock
from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    DriverError,
    ProtocolError,
)
from drivers.interfaces import StagePhase, StageState
from drivers.modbus_line import ModbusLine
from drivers.serial_port import ATTEMPTS
from drivers.stage import DIRECTLY, Mounting, Stage
from drivers.travel import longest_travel, wait_for_rest

log = logging.getLogger(__name__)

DIRECT_DATA = 0x0058
"""First register of: data number, type, position, speed, acceleration, deceleration, current, trigger, destination."""
ABSOLUTE = 1
"""Operation type "absolute position"; unchecked."""
FULL_CURRENT = 1000
"""Operating current in 0.1 % of the rated one; unchecked."""
TRIGGER_ALL = 1
"""Trigger "all data"; unchecked."""
RAMP_STEPS_PER_UNIT = 1.0
"""A unit of acceleration in steps/s^2 (0.001 kHz/s); unchecked."""
FASTEST = 4_000_000
"""Highest operating speed, steps/s; unchecked."""
INPUT = 0x007D
"""Commands, one bit each; written 1 and then 0."""
HOME_BIT, STOP_BIT, ALARM_RESET_BIT = 1 << 4, 1 << 5, 1 << 7
OUTPUT = 0x007F
"""State bits, followed by the two registers of the present alarm; the bits are unchecked."""
READY_BIT, ALARM_BIT, MOVE_BIT = 1 << 5, 1 << 7, 1 << 13
FEEDBACK_POSITION = 0x00CC
"""Position of the encoder, steps; unchecked."""
RECOVERY = 1.0
"""Seconds that the driver is given to excite the motor again when an alarm was reset; unchecked."""

ALARMS = {
    0x10: "excessive position deviation",
    0x20: "overcurrent",
    0x21: "main circuit overheat",
    0x22: "overvoltage",
    0x25: "undervoltage",
    0x26: "motor overheat",
    0x30: "overload",
    0x31: "overspeed",
    0x60: "both limit sensors active",
    0x66: "hardware overtravel",
    0x67: "software overtravel",
}
"""Alarm codes in words; unchecked."""


class OrientalAZ(Stage):
    """A `RotationStage` on an AZ driver.

    `url` is `tcp://host:port`, `rtu:///dev/ttyUSB0`, `rtu://COM3` or `rtu+` and any URL of pyserial; `unit` is the
    Modbus unit; `baudrate` and `parity` ("E", "O" or "N") are those set on the driver for RTU; `limits` are the lowest
    and highest angle that may be commanded (degrees); `degrees_per_step` is the table's resolution as the driver is
    configured; `velocity` (degrees/s) and `acceleration` (degrees/s^2) are those of each motion; `timeout` is the
    longest wait for a reply (seconds). Raises `ValueError` for a URL of another kind.

    The encoder is absolute: the stage knows its angle without homing, also after it was switched off. The connection
    belongs to the event loop in which it was opened.
    """

    def __init__(
        self,
        name: str,
        url: str,
        clock: Clock,
        *,
        unit: int = 1,
        baudrate: int = 115200,
        parity: str = "E",
        limits: tuple[float, float] = (-90.0, 175.0),
        mounting: Mounting = DIRECTLY,
        degrees_per_step: float = 0.01,
        velocity: float = 30.0,
        acceleration: float = 60.0,
        timeout: float = 1.0,
    ) -> None:
        super().__init__(name, clock, limits=limits, mounting=mounting)
        # the device keeps neither: they go with each motion
        self.velocity = velocity
        self.acceleration = acceleration
        self._degrees_per_step = degrees_per_step
        self._line = ModbusLine(name, url, unit=unit, timeout=timeout, baudrate=baudrate, parity=parity)

    async def open(self) -> None:
        """Connect and check that the unit has the registers of an AZ driver.

        Raises `DeviceNotFound` when nothing answers or something without those registers does, and `ProtocolError`
        when what answers on a serial line does not echo.
        """
        await self._line.open()
        try:
            await self.state()
            await self._set_input(0)  # whoever used the device before may have left a bit raised
        except (DeviceTimeout, DeviceDisconnected) as error:
            await self.close()
            message = f"{self.name}: no AZ driver answers at {self._line.address}"
            raise DeviceNotFound(message + "; check its power, its cable, the address and the unit") from error
        except DeviceRefused as error:
            await self.close()
            message = f"{self.name}: what answers at {self._line.address} does not behave as an AZ driver ({error})"
            raise DeviceNotFound(message + "; check the address and the unit") from error
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        await self._line.close()

    async def identity(self) -> str:
        """Maker and model; the device tells nothing more, so the address follows."""
        return f"Oriental Motor AZ at {self._line.address}"

    async def stop(self) -> None:
        """Stop moving at once; allowed from every state."""
        self._line.write_at_once(INPUT, [STOP_BIT])
        # that it arrived is only known from a reply; where it did, the bit is up already and nothing happens
        await self._pulse(STOP_BIT)

    async def _read_state(self) -> StageState:
        output, *alarm = await self._line.read(OUTPUT, 3)
        position = await self._read_position()
        if output & ALARM_BIT:
            code = _from_words(alarm)
            return StageState(StagePhase.FAULT, position, f"alarm {code:02X}: {ALARMS.get(code, 'see its manual')}")
        if output & MOVE_BIT:
            return StageState(StagePhase.MOVING, position)
        return StageState(StagePhase.READY if output & READY_BIT else StagePhase.DISABLED, position)

    async def _read_position(self) -> float:
        return _from_words(await self._line.read(FEEDBACK_POSITION, 2)) * self._degrees_per_step

    async def _set_velocity(self, velocity: float) -> None:
        self._speed(velocity)  # the device learns it with the next motion

    async def _begin_homing(self) -> None:
        """Return to the home position that is stored in the absolute encoder."""
        if (await self._read_state()).phase is StagePhase.FAULT:
            await self._pulse(ALARM_RESET_BIT)
            await wait_for_rest(self.name, self._clock, self.state, expected=RECOVERY, at_most=longest_travel(RECOVERY))
        await self._require_ready()
        await self._pulse(HOME_BIT)

    async def _begin_move(self, reading: float) -> None:
        """Write a motion and its trigger, once, and confirm it by reading back."""
        await self._require_ready()
        steps = round(reading / self._degrees_per_step)
        speed = self._speed(self.velocity * self._mounting.scale)
        ramp = round(self.acceleration * self._mounting.scale / self._degrees_per_step / RAMP_STEPS_PER_UNIT)
        motion = [0, ABSOLUTE, steps, speed, ramp, ramp, FULL_CURRENT]
        written = [word for value in motion for word in _to_words(value)]
        failure: DriverError = ProtocolError(
            f"{self.name}: did not take a motion to {reading:g}°; check that no one else commands it"
        )
        try:
            await self._line.write(DIRECT_DATA, [*written, *_to_words(TRIGGER_ALL), *_to_words(0)])
        except (DeviceTimeout, ProtocolError) as error:  # perhaps only the reply was lost; reading back tells
            log.warning("%s; reading back whether it took the motion to %g°", error, reading)
            failure = error
        if await self._line.read(DIRECT_DATA, len(written)) != written:
            raise failure

    def _speed(self, velocity: float) -> int:
        """Degrees of the reading per second in the device's unit, steps/s. Raises `DeviceRefused` beyond its range."""
        steps = round(velocity / self._degrees_per_step)
        if not 1 <= steps <= FASTEST:
            unit = self._degrees_per_step / self._mounting.scale
            message = f"{self.name}: cannot move at {velocity / self._mounting.scale:g}°/s"
            raise DeviceRefused(message + f"; ask for {unit:g}°/s to {FASTEST * unit:g}°/s")
        return steps

    async def _require_ready(self) -> None:
        state = await self._read_state()
        if state.phase is StagePhase.FAULT:
            raise DeviceFault(f"{self.name}: {state.message}; clear its cause, then home the stage")
        if state.phase is not StagePhase.READY:
            raise DeviceRefused(f"{self.name}: is {state.phase.value}, not ready; wait, or switch its motor on")

    async def _pulse(self, bit: int) -> None:
        """Raise and lower one bit of the input; the device acts on the rising edge.

        Both happen even when the caller is cancelled: a stop that stays raised forbids every motion after it.
        """

        async def raise_and_lower() -> None:
            try:
                await self._set_input(bit, to_stop=bit == STOP_BIT)
            finally:
                await self._set_input(0, to_stop=bit == STOP_BIT)

        await asyncio.shield(raise_and_lower())

    async def _set_input(self, bits: int, *, to_stop: bool = False) -> None:
        """Write the input, again if need be: a bit that is written twice rises once."""
        await self._line.write(INPUT, [bits], attempts=ATTEMPTS, to_stop=to_stop)


def _to_words(value: int) -> list[int]:
    """A signed 32-bit number as two registers, high word first."""
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


def _from_words(words: list[int]) -> int:
    """Two registers, high word first, as a signed 32-bit number."""
    return int.from_bytes(b"".join(word.to_bytes(2, "big") for word in words), "big", signed=True)
