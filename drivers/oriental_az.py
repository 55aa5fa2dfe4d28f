"""Oriental Motor AZ driver with a DG hollow rotary table, over Modbus TCP.

Registers are 32 bits wide, two Modbus registers each, high word first. A motion is one "direct data operation":
type, position, speed, ramps and trigger written together. The constants below whose comment says "unchecked"
come from memory and were not checked on a device: compare them with the manual of yours before it moves.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU

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
from drivers.travel import check_arrival, check_limits, longest_travel, travel_time, wait_for_rest

# what it logs as errors is raised here in our words; without a handler it would go to stderr as well
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())

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
INPUT = 0x007D
"""Commands, one bit each; written 1 and then 0."""
HOME_BIT, STOP_BIT, ALARM_RESET_BIT = 1 << 4, 1 << 5, 1 << 7
OUTPUT = 0x007F
"""State bits, followed by the two registers of the present alarm; the bits are unchecked."""
READY_BIT, ALARM_BIT, MOVE_BIT = 1 << 5, 1 << 7, 1 << 13
FEEDBACK_POSITION = 0x00CC
"""Position of the encoder, steps; unchecked."""

HOMING_TIME = 120.0
"""Seconds that a return to the home position may take."""
HOMING_POLL = 0.5
"""Seconds between two questions while it returns."""

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

EXCEPTIONS = {
    1: "it does not know the function",
    2: "it does not have that register",
    3: "the value is not allowed",
    4: "it cannot do that in its present state",
    11: "nothing answers behind its gateway",
}
"""Modbus exception codes in words (Modbus application protocol, section 7)."""


class OrientalAZ:
    """A `RotationStage` on an AZ driver.

    `unit` is the Modbus unit; `limits` the lowest and highest angle that may be commanded (degrees); `velocity`
    (degrees/s) and `acceleration` (degrees/s^2) are those of each motion; `timeout` is the longest wait for a
    reply (seconds). The encoder is absolute, so the stage never needs homing to know its angle. The connection
    belongs to the event loop in which it was opened.
    """

    def __init__(
        self,
        name: str,
        host: str,
        port: int,
        clock: Clock,
        *,
        unit: int = 1,
        limits: tuple[float, float] = (-90.0, 175.0),
        degrees_per_step: float = 0.01,
        velocity: float = 30.0,
        acceleration: float = 60.0,
        timeout: float = 1.0,
    ) -> None:
        self.name = name
        self.limits = limits
        self._host = host
        self._port = port
        self._clock = clock
        self._unit = unit
        self._degrees_per_step = degrees_per_step
        self._velocity = velocity
        self._acceleration = acceleration
        self._timeout = timeout
        self._client: AsyncModbusTcpClient | None = None

    async def open(self) -> None:
        """Connect and check that the unit has the registers of an AZ driver. Raises `DeviceNotFound`."""
        await self.close()
        # a repeated trigger could move the stage twice, so nothing is ever sent again
        self._client = AsyncModbusTcpClient(
            self._host, port=self._port, timeout=self._timeout, retries=0, reconnect_delay=0
        )
        address = f"{self._host}:{self._port} (unit {self._unit})"
        try:
            if not await self._client.connect():
                message = f"{self.name}: nothing answers at {address}; check its power, its cable and the address"
                raise DeviceNotFound(message)
            await self.state()
            await self._write(INPUT, [0])  # whoever used the device before may have left a bit raised
        except (DeviceTimeout, DeviceRefused) as error:
            await self.close()
            message = f"{self.name}: what answers at {address} is no AZ driver; check the address and the unit"
            raise DeviceNotFound(message) from error
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    async def identity(self) -> str:
        """Maker and model; the device tells nothing more, so the address follows."""
        return f"Oriental Motor AZ at {self._host}:{self._port} unit {self._unit}"

    async def state(self) -> StageState:
        """What the stage is doing now; an alarm is shown in words."""
        output, *alarm = await self._read(OUTPUT, 3)
        position = await self.position()
        if output & ALARM_BIT:
            code = _from_words(alarm)
            return StageState(StagePhase.FAULT, position, f"alarm {code:02X}: {ALARMS.get(code, 'see its manual')}")
        if output & MOVE_BIT:
            return StageState(StagePhase.MOVING, position)
        return StageState(StagePhase.READY if output & READY_BIT else StagePhase.DISABLED, position)

    async def home(self) -> None:
        """Return to the home position of the absolute encoder, resetting an alarm first.

        Raises `DeviceFault` when the alarm remains, `DeviceTimeout` when home is not reached.
        """
        if (await self.state()).phase is StagePhase.FAULT:
            await self._pulse(ALARM_RESET_BIT)
        await self._require_ready()
        await self._pulse(HOME_BIT)
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=0.0, at_most=HOMING_TIME, poll=HOMING_POLL
        )
        if state.phase is not StagePhase.READY:
            raise DeviceFault(f"{self.name}: is {state.phase.value}, not ready, after homing; home it again")

    async def move_to(self, angle: float) -> float:
        """Move to `angle` degrees, wait until the stage rests there, and return the angle it reads back.

        Raises `DeviceRefused` outside `limits` before anything is sent, or when the stage is not ready;
        `DeviceFault` on an alarm or when it stops elsewhere; `DeviceTimeout` when it does not arrive.
        """
        check_limits(self.name, angle, self.limits)
        before = await self._require_ready()
        expected = travel_time(angle - before.position, self._velocity, self._acceleration)
        await self._trigger(angle)
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=expected, at_most=longest_travel(expected)
        )
        check_arrival(self.name, angle, state.position)
        return state.position

    async def position(self) -> float:
        """Angle now, degrees."""
        return _from_words(await self._read(FEEDBACK_POSITION, 2)) * self._degrees_per_step

    async def stop(self) -> None:
        """Stop moving at once; allowed from every state."""
        await self._pulse(STOP_BIT)

    async def _require_ready(self) -> StageState:
        state = await self.state()
        if state.phase is StagePhase.FAULT:
            raise DeviceFault(f"{self.name}: {state.message}; clear its cause, then home the stage")
        if state.phase is not StagePhase.READY:
            raise DeviceRefused(f"{self.name}: is {state.phase.value}, not ready; wait, or switch its motor on")
        return state

    async def _trigger(self, angle: float) -> None:
        """Write a motion and its trigger, once, and confirm it by reading back."""
        steps = round(angle / self._degrees_per_step)
        speed = round(self._velocity / self._degrees_per_step)
        ramp = round(self._acceleration / self._degrees_per_step / RAMP_STEPS_PER_UNIT)
        motion = [0, ABSOLUTE, steps, speed, ramp, ramp, FULL_CURRENT]
        written = [word for value in motion for word in _to_words(value)]
        with contextlib.suppress(DeviceTimeout):  # perhaps only the reply was lost; reading back tells
            await self._write(DIRECT_DATA, [*written, *_to_words(TRIGGER_ALL), *_to_words(0)])
        if await self._read(DIRECT_DATA, len(written)) != written:
            raise ProtocolError(f"{self.name}: did not take a motion to {angle:g}°; check that no one else commands it")

    async def _pulse(self, bit: int) -> None:
        """Raise and lower one bit of the input; the device acts on the rising edge.

        Both happen even when the caller is cancelled: a stop that stays raised forbids every motion after it.
        """

        async def raise_and_lower() -> None:
            await self._write(INPUT, [bit])
            await self._write(INPUT, [0])

        await asyncio.shield(raise_and_lower())

    async def _read(self, address: int, count: int) -> list[int]:
        request = self._connected().read_holding_registers(address, count=count, device_id=self._unit)
        reply = await self._exchange(request, f"reading register {address:#06x}")
        if len(reply.registers) != count:
            message = f"{self.name}: answered {len(reply.registers)} registers where {count} were asked"
            raise ProtocolError(message + "; reopen the device")
        return list(reply.registers)

    async def _write(self, address: int, words: list[int]) -> None:
        request = self._connected().write_registers(address, words, device_id=self._unit)
        await self._exchange(request, f"writing register {address:#06x}")

    async def _exchange(self, request: Awaitable[ModbusPDU], what: str) -> ModbusPDU:
        """Send `request` and return the reply.

        A request that is cancelled still waits for its reply: a second one sent meanwhile could get lost.
        """
        try:
            reply = await asyncio.shield(request)
        except ModbusException as error:
            raise self._explain(error) from error
        if reply.isError():
            reason = EXCEPTIONS.get(reply.exception_code, f"exception {reply.exception_code}")
            raise DeviceRefused(f"{self.name}: the AZ refused {what}: {reason}")
        return reply

    def _connected(self) -> AsyncModbusTcpClient:
        if self._client is None:
            raise DeviceDisconnected(f"{self.name}: is not open; open the device first")
        if not self._client.connected:
            raise self._lost()
        return self._client

    def _lost(self) -> DeviceDisconnected:
        message = f"{self.name}: the connection to {self._host}:{self._port} is lost"
        return DeviceDisconnected(message + "; check the cable, then reopen it")

    def _explain(self, error: ModbusException) -> DriverError:
        """A pymodbus exception in our words."""
        gone = self._client is None or not self._client.connected
        if gone or isinstance(error, ConnectionException):
            return self._lost()
        if isinstance(error, ModbusIOException):
            message = f"{self.name}: no answer from {self._host}:{self._port} within {self._timeout:g} s"
            return DeviceTimeout(message + "; check that the device is on")
        return ProtocolError(f"{self.name}: sent a malformed Modbus reply ({error}); reopen the device")


def _to_words(value: int) -> list[int]:
    """A signed 32-bit number as two registers, high word first."""
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


def _from_words(words: list[int]) -> int:
    """Two registers, high word first, as a signed 32-bit number."""
    return int.from_bytes(b"".join(word.to_bytes(2, "big") for word in words), "big", signed=True)
