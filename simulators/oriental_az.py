"""An Oriental Motor AZ driver that answers on Modbus TCP."""

import asyncio
from typing import cast

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from simulators.motion import Axis
from simulators.wire import Listener

DIRECT_DATA, DIRECT_DATA_WORDS = 0x0058, 18
INPUT_AND_OUTPUT, INPUT_AND_OUTPUT_WORDS = 0x007C, 6
INPUT, OUTPUT, ALARM = 0x007D, 0x007F, 0x0080
FEEDBACK_POSITION = 0x00CC
HOME_BIT, STOP_BIT, FREE_BIT, ALARM_RESET_BIT = 1 << 4, 1 << 5, 1 << 6, 1 << 7
HOME_END, READY, ALARM_ACTIVE, MOVE, IN_POSITION = 1 << 4, 1 << 5, 1 << 7, 1 << 13, 1 << 14
SOFTWARE_OVERTRAVEL = 0x67
WRITE_MANY = 16
"""Modbus function."""


class SimulatedOrientalAZ(Listener):
    """One driver as a Modbus unit, and an axis with an absolute encoder."""

    def __init__(self, axis: Axis, *, unit: int = 1, degrees_per_step: float = 0.01) -> None:
        super().__init__("simulated AZ")
        self.silent = False
        """Whether replies are swallowed."""
        self.lost_replies_to_motions = 0
        """Motions that are still to be carried out without a reply."""
        self._axis = axis
        self._unit = unit
        self._degrees_per_step = degrees_per_step
        self._request = b""
        self._input = 0
        self._alarm = 0
        self._homed = False
        self._server: ModbusTcpServer | None = None

    def start(self) -> tuple[str, int]:
        """Begin to listen and return host and port; the same ones after an unplug."""
        self._start()
        return "127.0.0.1", self._port

    def fail(self, alarm: int) -> None:
        """Stop with an alarm until it is reset."""
        self._axis.stop()
        self._alarm = alarm

    async def _listen(self) -> None:
        registers = [
            SimData(DIRECT_DATA, values=[0] * DIRECT_DATA_WORDS, datatype=DataType.REGISTERS),
            SimData(INPUT_AND_OUTPUT, values=[0] * INPUT_AND_OUTPUT_WORDS, datatype=DataType.REGISTERS),
            SimData(FEEDBACK_POSITION, values=[0, 0], datatype=DataType.REGISTERS),
        ]
        device = SimDevice(self._unit, registers, action=self._access)
        self._server = ModbusTcpServer(device, address=("127.0.0.1", self._port), trace_packet=self._pass_on)
        await self._server.serve_forever(background=True)
        # pymodbus types it as a transport, but a listener's is the asyncio server
        self._port = cast(asyncio.Server, self._server.transport).sockets[0].getsockname()[1]

    async def _hang_up(self) -> None:
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None

    def _pass_on(self, sending: bool, packet: bytes) -> bytes:
        if not sending:
            self._request = packet
            return packet
        # function code and first register stand behind the 7 bytes of the header
        is_motion = self._request[7:10] == bytes([WRITE_MANY, 0, DIRECT_DATA])
        if self.lost_replies_to_motions and is_motion:
            self.lost_replies_to_motions -= 1
            return b""
        return b"" if self.silent else packet

    async def _access(
        self,
        function: int,
        first: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Bring the registers up to date before a read, and act on what a write changes."""
        if values is None:
            registers[OUTPUT - first] = self._output()
            registers[ALARM - first : ALARM - first + 2] = _words(self._alarm)
            position = round(self._axis.position() / self._degrees_per_step)
            registers[FEEDBACK_POSITION - first : FEEDBACK_POSITION - first + 2] = _words(position)
            return None
        after = dict(enumerate(registers, start=first)) | dict(enumerate(map(int, values), start=address))
        if address <= INPUT < address + count:
            self._obey(after[INPUT])
        if address <= DIRECT_DATA + 15 < address + count and after[DIRECT_DATA + 15] == 1:
            return self._move(*(_number(after, DIRECT_DATA + offset) for offset in (2, 4, 6, 8)))
        return None

    def _output(self) -> int:
        if self._alarm:
            return ALARM_ACTIVE
        if self._axis.moving():
            return MOVE
        return IN_POSITION | (READY if not self._input & FREE_BIT else 0) | (HOME_END if self._homed else 0)

    def _obey(self, bits: int) -> None:
        """Act on the bits of the input register that have risen."""
        risen, self._input = bits & ~self._input, bits
        if risen & ALARM_RESET_BIT:
            self._alarm = 0
        if risen & (STOP_BIT | FREE_BIT):
            self._axis.stop()
        if risen & HOME_BIT and self._output() & READY:
            self._axis.home()
            self._homed = True

    def _move(self, kind: int, position: int, speed: int, ramp: int) -> ExcCodes | None:
        """Begin a motion; one that is not allowed now is ignored, one out of range raises an alarm."""
        if kind != 1 or speed <= 0 or ramp <= 0:
            return ExcCodes.ILLEGAL_VALUE
        if self._alarm or self._input & (STOP_BIT | FREE_BIT):
            return None
        target = position * self._degrees_per_step
        low, high = self._axis.limits
        if not low <= target <= high:
            self.fail(SOFTWARE_OVERTRAVEL)
            return None
        self._homed = False
        self._axis.velocity = speed * self._degrees_per_step
        self._axis.acceleration = ramp * self._degrees_per_step
        self._axis.move(target)
        return None


def _words(value: int) -> list[int]:
    """A signed 32-bit number as two registers, high word first."""
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


def _number(registers: dict[int, int], address: int) -> int:
    """The signed 32-bit number at `address`, high word first."""
    unsigned = registers[address] << 16 | registers[address + 1]
    return unsigned - (1 << 32) if unsigned >= 1 << 31 else unsigned
