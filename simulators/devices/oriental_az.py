"""An Oriental Motor AZ driver that answers on Modbus, over TCP or over a serial line (RTU)."""

from collections.abc import Coroutine
from typing import Any, cast

from pymodbus.constants import ExcCodes
from pymodbus.datastore import ModbusServerContext
from pymodbus.framer.rtu import FramerRTU
from pymodbus.framer.socket import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.diag_message import ReturnQueryDataRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simcore import SimCore

from simulators.devices.motion import Axis
from simulators.devices.wire import ByteServer

DIRECT_DATA, DIRECT_DATA_WORDS = 0x0058, 18
INPUT_AND_OUTPUT, INPUT_AND_OUTPUT_WORDS = 0x007C, 6
INPUT, OUTPUT, ALARM = 0x007D, 0x007F, 0x0080
FEEDBACK_POSITION = 0x00CC
HOME_BIT, STOP_BIT, FREE_BIT, ALARM_RESET_BIT = 1 << 4, 1 << 5, 1 << 6, 1 << 7
HOME_END, READY, ALARM_ACTIVE, MOVE, IN_POSITION = 1 << 4, 1 << 5, 1 << 7, 1 << 13, 1 << 14
POSITION_DEVIATION, SOFTWARE_OVERTRAVEL = 0x10, 0x67
"""Alarms."""
DRIFT = 0.5
"""Degrees by which a drifting encoder reads too much."""
SLOWNESS = 10.0
"""How many times as long a slow motion takes."""


SPOKEN = (
    ReadHoldingRegistersRequest,
    WriteSingleRegisterRequest,
    WriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    ReturnQueryDataRequest,
)
"""The Modbus functions that it knows."""


class SimulatedOrientalAZ(ByteServer):
    """One driver as a Modbus unit, and an axis with an absolute encoder.

    It speaks RTU on its line where `rtu` is true, and Modbus TCP otherwise.
    """

    def __init__(self, axis: Axis, *, unit: int = 1, degrees_per_step: float = 0.01, rtu: bool = False) -> None:
        super().__init__("simulated AZ")
        self._axis = axis
        self._unit = unit
        self._degrees_per_step = degrees_per_step
        self._rtu = rtu
        self._decoder = DecodePDU(True)
        self._framer = FramerRTU(self._decoder) if rtu else FramerSocket(self._decoder)
        self._registers = self._blank_registers()
        self._input = 0
        self._alarm = 0
        self._homed = False
        self._refusing = False
        self._drift = 0.0
        self._slowness = 1.0

    def start(self) -> str:
        """Begin to listen and return the URL for our driver; the same one after an unplug."""
        url = super().start()
        return f"rtu+{url}" if self._rtu else url.replace("socket://", "tcp://")

    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        """The whole frames in `data`, and the beginning of the next one."""
        requests = []
        while 0 < (size := self._frame_size(data)) <= len(data):
            requests.append(data[:size])
            data = data[size:]
        return requests, data

    def answer(self, request: bytes) -> bytes:
        """The frame that answers the frame `request`; none to one for another unit or with a wrong checksum."""
        unit, number, content = self._unpack(request)
        if not content or (self._rtu and unit != self._unit):
            return b""
        if unit != self._unit:
            # as a gateway does on behalf of a unit that does not exist
            return self._frame(ExceptionResponse(content[0], ExcCodes.GATEWAY_NO_RESPONSE), unit, number)
        pdu = self._decoder.decode(content)
        if not isinstance(pdu, SPOKEN):
            return self._frame(ExceptionResponse(content[0], ExcCodes.ILLEGAL_FUNCTION), unit, number)
        # what it is typed as is deprecated; the servers of pymodbus pass this, too
        return self._frame(
            _finished(pdu.datastore_update(cast(ModbusServerContext, self._registers), unit)), unit, number
        )

    def refuse(self) -> None:
        """Answer the next write with an exception, and do not carry it out."""
        self._refusing = True

    def restart(self) -> None:
        """Wake up as after switching off and on: all data is forgotten, but the encoder is absolute."""
        self._axis.stop()
        self._registers = self._blank_registers()
        self._input = self._alarm = 0
        self._homed = False

    def jam(self) -> None:
        """Stop with an alarm until it is reset."""
        self.fail(POSITION_DEVIATION)

    def drift(self) -> None:
        """Read too much from now on."""
        self._drift = DRIFT

    def slow(self) -> None:
        """Move slowly from the next motion on."""
        self._slowness = SLOWNESS

    def fail(self, alarm: int) -> None:
        """Stop with an alarm until it is reset."""
        self._axis.stop()
        self._alarm = alarm

    def _frame_size(self, data: bytes) -> int:
        """How long the frame is that begins with `data`; 0 while that is not known."""
        if not self._rtu:
            return int.from_bytes(data[4:6], "big") + 6 if len(data) >= 6 else 0
        if len(data) < 2:
            return 0
        kind = self._decoder.lookupPduClass(data.ljust(4, b"\0"))
        # an unknown function ends, as far as anybody can tell, with what has come
        return kind.calculateRtuFrameSize(data) if kind is not None and issubclass(kind, SPOKEN) else len(data)

    def _unpack(self, frame: bytes) -> tuple[int, int, bytes]:
        """Unit, number of the request and what it says; nothing where the frame is none."""
        if not self._rtu:
            _, unit, number, content = self._framer.decode(frame)
            return unit, number, content
        is_whole = FramerRTU.compute_CRC(frame[:-2]) == int.from_bytes(frame[-2:], "big")
        return frame[0], 0, frame[1:-2] if is_whole else b""

    def _frame(self, reply: ModbusPDU, unit: int, number: int) -> bytes:
        return self._framer.encode(bytes([reply.function_code]) + reply.encode(), unit, number)

    def _blank_registers(self) -> SimCore:
        registers = [
            SimData(DIRECT_DATA, values=[0] * DIRECT_DATA_WORDS, datatype=DataType.REGISTERS),
            SimData(INPUT_AND_OUTPUT, values=[0] * INPUT_AND_OUTPUT_WORDS, datatype=DataType.REGISTERS),
            SimData(FEEDBACK_POSITION, values=[0, 0], datatype=DataType.REGISTERS),
        ]
        return SimCore(SimDevice(self._unit, registers, action=self._access))

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
            position = round((self._axis.position() + self._drift) / self._degrees_per_step)
            registers[FEEDBACK_POSITION - first : FEEDBACK_POSITION - first + 2] = _words(position)
            return None
        if self._refusing:
            self._refusing = False
            return ExcCodes.DEVICE_FAILURE
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
        self._axis.velocity = speed * self._degrees_per_step / self._slowness
        self._axis.acceleration = ramp * self._degrees_per_step / self._slowness**2
        self._axis.move(target)
        return None


def _finished(call: Coroutine[Any, Any, ModbusPDU]) -> ModbusPDU:
    """What `call` returns; it is a coroutine only because others may wait, ours never do."""
    try:
        call.send(None)
    except StopIteration as end:
        reply: ModbusPDU = end.value
        return reply
    raise RuntimeError("the registers of the simulated AZ waited for something")


def _words(value: int) -> list[int]:
    """A signed 32-bit number as two registers, high word first."""
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


def _number(registers: dict[int, int], address: int) -> int:
    """The signed 32-bit number at `address`, high word first."""
    unsigned = registers[address] << 16 | registers[address + 1]
    return unsigned - (1 << 32) if unsigned >= 1 << 31 else unsigned
