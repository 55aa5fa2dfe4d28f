"""Whatever bytes come down a line, a driver gives a value or a typed error, in bounded time, and works again after."""

import asyncio
import errno
import hashlib
import logging
import math
import selectors
import struct
from collections.abc import Awaitable, Callable, Iterator
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pymodbus.transport.transport
import pytest
import serial
import usb.core
import usb.util
from hypothesis import strategies as st

from drivers import apt, modbus_line, serial_port
from drivers.device_thread import DeviceThread
from drivers.errors import DriverError, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.k10cr1 import COUNTS_PER_DEGREE, K10CR1
from drivers.obp import ACK, RESPONSE, Message, decode, encode, total_length
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.qepro import QEPro
from drivers.qepro_wire import METADATA, PIXELS, SPECTRUM
from drivers.serial_port import Query, SerialPort, line
from drivers.smc100 import SMC100
from drivers.stage import Stage
from simulators.devices.clock import SimulatedClock
from simulators.devices.k10cr1 import SimulatedK10CR1
from simulators.devices.motion import Axis
from simulators.devices.oriental_az import SimulatedOrientalAZ
from simulators.devices.owis import SimulatedOwisPS
from simulators.devices.smc100 import SimulatedSMC100
from simulators.devices.wire import ByteServer
from tests.bombarded import bombarded

MOST_READS = 50_000
"""After which a driver is said to hang."""
BYTE_TIME = 0.001
"""Seconds that a byte takes on the slow lines of these tests."""
SECONDS_PER_READ = 0.05


class InstantSelector(selectors.SelectSelector):
    """Time passes at once; nothing but time is ever waited for."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        assert timeout is not None, "waits for something that never comes"
        self.now += timeout
        return []


class InstantLoop(asyncio.SelectorEventLoop):
    """An event loop on which no wait takes real time, with the far ends of all lines that are opened on it."""

    def __init__(self) -> None:
        self.selector = InstantSelector()
        super().__init__(self.selector)
        self.plug: Callable[[], Any] = lambda: None
        """Gives what stands for an opened serial port."""
        self.wire: Callable[[asyncio.Protocol], asyncio.Transport]
        """Gives what stands for an opened Modbus connection."""

    def time(self) -> float:
        return self.selector.now

    async def create_connection(self, factory: Any, *_: Any, **__: Any) -> Any:  # type: ignore[override]  # a stand-in
        protocol = factory()
        transport = self.wire(protocol)
        protocol.connection_made(transport)
        return transport, protocol


async def _call(self: DeviceThread, call: Callable[..., Any], *arguments: object) -> Any:
    return call(*arguments)


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> Iterator[InstantLoop]:
    loop = InstantLoop()
    numbers = iter(range(1 << 62))
    monkeypatch.setattr(DeviceThread, "run", _call)
    monkeypatch.setattr(DeviceThread, "finish", _call)
    monkeypatch.setattr(serial_port, "time", SimpleNamespace(monotonic=loop.time))
    monkeypatch.setattr(serial, "serial_for_url", lambda url, **_: loop.plug())
    monkeypatch.setattr(
        pymodbus.transport.transport,
        "create_serial_connection",
        lambda _, factory, *__, **___: loop.create_connection(factory),
    )
    monkeypatch.setattr(
        modbus_line,
        "secrets",
        SimpleNamespace(token_bytes=lambda size: (next(numbers) * 40503 % 65536).to_bytes(size, "big")),
    )
    monkeypatch.setattr(usb.util, "claim_interface", lambda *_: None)
    monkeypatch.setattr(usb.util, "dispose_resources", lambda *_: None)
    monkeypatch.setattr(usb.util, "find_descriptor", lambda *_, **__: SimpleNamespace(wMaxPacketSize=64))
    logging.disable(logging.CRITICAL)
    yield loop
    logging.disable(logging.NOTSET)
    loop.close()


INTACT = 24
"""Of 32 things that a line may do to a reply, as many leave it as it is."""
FLIP, CUT, DOUBLE, INSERT, RESPELL, LOSE, REPEAT, HOLD = range(INTACT, 32)


class Line:
    """What a line makes of replies, as drawn bytes say; they come as they are where these are 0 or used up."""

    def __init__(self, script: bytes, letters: bytes = bytes(range(256))) -> None:
        self._script = iter(script)
        self._letters = letters
        self._earlier: list[bytes] = []
        self._held = b""
        self.rests = False

    def draw(self, below: int) -> int:
        return next(self._script, 0) % max(below, 1)

    def noise(self) -> bytes:
        return bytes(self._letters[self.draw(len(self._letters))] for _ in range(self.draw(12)))

    def carry(self, reply: bytes) -> bytes:
        if self.rests:
            self._script = iter(b"")
        kind = self.draw(32)
        came, self._held = self._held + self.spoil(kind, reply), b""
        if reply:
            self._earlier.append(reply)
        if kind == HOLD:
            came, self._held = b"", came
        return came

    def spoil(self, kind: int, reply: bytes) -> bytes:
        at = self.draw(len(reply)) if kind in {FLIP, CUT, INSERT, RESPELL} else 0
        spoilt = reply
        if kind == FLIP and reply:
            spoilt = reply[:at] + bytes([reply[at] ^ 1 << self.draw(8)]) + reply[at + 1 :]
        elif kind == CUT:
            spoilt = reply[:at]
        elif kind == DOUBLE:
            spoilt = reply * 2
        elif kind == INSERT:
            spoilt = reply[:at] + self.noise() + reply[at:]
        elif kind == RESPELL:
            spoilt = reply[:at] + self.noise() + reply[at + self.draw(12) :]
        elif kind == LOSE:
            spoilt = b""
        elif kind == REPEAT and self._earlier:
            spoilt = self._earlier[self.draw(len(self._earlier))] + reply
        return spoilt


class Far:
    """A simulated instrument at the far end of a line, without sockets or threads."""

    def __init__(self, simulator: ByteServer, spoilt: Line) -> None:
        self._simulator = simulator
        self._line = spoilt
        self._unfinished = b""

    def answers(self, data: bytes) -> list[bytes]:
        requests, self._unfinished = self._simulator.split_requests(self._unfinished + data)
        return [self._line.carry(self._simulator.answer(request)) for request in requests]


class Port:
    """What stands for a serial port."""

    def __init__(self, loop: InstantLoop, answers: Callable[[bytes], list[bytes]], drone: bytes = b"") -> None:
        self._selector = loop.selector
        self._answers = answers
        self._drone = drone
        """What comes for ever when there is nothing else."""
        self._coming = b""
        self._reads = 0

    def reset_input_buffer(self) -> None:
        self._coming = b""

    def write(self, data: bytes) -> int:
        self._coming += b"".join(self._answers(data))
        return len(data)

    def read(self, size: int) -> bytes:
        self._reads += 1
        assert self._reads < MOST_READS, "reads without an end"
        if self._drone:
            while len(self._coming) < size:
                self._coming += self._drone
        data, self._coming = self._coming[:size], self._coming[size:]
        self._selector.now += BYTE_TIME * len(data) + (SECONDS_PER_READ if len(data) < size else 0)
        return data

    def close(self) -> None: ...


class Wire(asyncio.Transport):
    """What stands for a connection of pymodbus."""

    def __init__(self, loop: InstantLoop, protocol: asyncio.Protocol, answers: Callable[[bytes], list[bytes]]) -> None:
        super().__init__()
        self._loop = loop
        self._protocol = protocol
        self._answers = answers
        self._closed = False

    def write(self, data: Any) -> None:
        for answer in self._answers(data):
            half = len(answer) // 2
            for piece in (answer[:half], answer[half:]):
                if piece:
                    self._loop.call_soon(self._arrive, piece)

    def _arrive(self, data: bytes) -> None:
        if not self._closed:
            self._protocol.data_received(data)

    def close(self) -> None:
        self._closed = True

    def abort(self) -> None:
        self.close()


def smc100(axis: Axis, clock: SimulatedClock) -> tuple[ByteServer, Stage]:
    return SimulatedSMC100(axis), SMC100("stage", "/dev/x", clock, timeout=0.1)


def owis(axis: Axis, clock: SimulatedClock) -> tuple[ByteServer, Stage]:
    stage = OwisPS("stage", "/dev/x", clock, axis=2, counts_per_degree=500, timeout=0.1)
    return SimulatedOwisPS(
        [Axis(clock, velocity=1, acceleration=1, limits=(0, 1)), axis], clock, counts_per_degree=500
    ), stage


def k10cr1(axis: Axis, clock: SimulatedClock) -> tuple[ByteServer, Stage]:
    return SimulatedK10CR1(axis), K10CR1("stage", "/dev/x", clock, timeout=0.1)


def az_rtu(axis: Axis, clock: SimulatedClock) -> tuple[ByteServer, Stage]:
    return SimulatedOrientalAZ(axis, rtu=True), OrientalAZ("stage", "rtu:///dev/x", clock, timeout=0.1)


def az_tcp(axis: Axis, clock: SimulatedClock) -> tuple[ByteServer, Stage]:
    return SimulatedOrientalAZ(axis), OrientalAZ("stage", "tcp://host:502", clock, timeout=0.1)


OPERATIONS: list[Callable[[Stage], Awaitable[object]]] = [
    *4 * [lambda stage: stage.state(), lambda stage: stage.position(), lambda stage: stage.identity()],
    lambda stage: stage.stop(),
    lambda stage: stage.set_velocity(7.5),
    lambda stage: stage.move_to(30.0),
    lambda stage: stage.home(),
]


def check_value(value: object) -> None:
    """Whether this is something to go on with: finite, of the right type, printable."""
    match value:
        case StageState():
            assert isinstance(value.phase, StagePhase)
            assert math.isfinite(value.position)
            assert value.message.isprintable()
        case float():
            assert math.isfinite(value)
        case str():
            assert value.isprintable(), value
        case _:
            assert value is None


def bombard(
    loop: InstantLoop, family: Callable[[Axis, SimulatedClock], tuple[ByteServer, Stage]], drawn: bytes, letters: bytes
) -> float:
    """Open a stage and let it do one thing while the line does what is drawn; then read it on a line in order.

    Returns by how many degrees it is misread there; 0 for most of what is drawn, after which it is not read again.
    """
    clock = SimulatedClock()
    axis = Axis(clock, start=12.0, velocity=20, acceleration=40, limits=(-10, 100))
    simulator, stage = family(axis, clock)
    spoilt = Line(drawn[1:], letters)
    far = Far(simulator, spoilt)
    loop.plug = lambda: Port(loop, far.answers)
    loop.wire = lambda protocol: Wire(loop, protocol, far.answers)
    operation = OPERATIONS[drawn[0] % len(OPERATIONS)]

    async def scenario() -> float:
        try:
            await stage.open()
            assert 0 < stage.velocity < math.inf
            check_value(await operation(stage))
        except DriverError as error:
            check_value(str(error))
        finally:
            await stage.close()
        if drawn[0] >= 16:
            return 0.0
        spoilt.rests = True
        await stage.open()
        misread = abs(await stage.position() - true_reading(simulator, axis))
        await stage.close()
        return misread

    return loop.run_until_complete(scenario())


def true_reading(simulator: Any, axis: Axis) -> float:
    """What the simulated stage reads, in degrees, without a line between."""
    match simulator:
        case SimulatedSMC100():
            return simulator._reading()
        case SimulatedOwisPS():
            return simulator._counts(simulator._drives[1]) / 500
        case SimulatedK10CR1():
            return simulator._counts() / COUNTS_PER_DEGREE
        case _:
            return axis.position()


SCRIPTS = st.binary(min_size=40, max_size=40)
"""An operation, and what befalls the replies to it."""


@bombarded(SCRIPTS)
def test_an_smc100_on_a_spoilt_line_gives_an_angle_or_an_error_and_comes_back(loop: InstantLoop, drawn: bytes) -> None:
    assert bombard(loop, smc100, drawn, b"0123456789+-.eE \tnanif1TPSVA\r\n\x1b") < 0.01


@bombarded(SCRIPTS)
def test_an_owis_on_a_spoilt_line_gives_an_angle_or_an_error_and_comes_back(loop: InstantLoop, drawn: bytes) -> None:
    assert bombard(loop, owis, drawn, b"0123456789+-.RIPT? \r\n\x1b") < 0.01


@bombarded(SCRIPTS)
def test_a_k10cr1_on_a_spoilt_line_gives_an_angle_or_an_error_and_comes_back(loop: InstantLoop, drawn: bytes) -> None:
    assert bombard(loop, k10cr1, drawn, bytes(range(256))) < 0.01


@bombarded(SCRIPTS)
def test_an_az_on_a_spoilt_serial_line_gives_an_angle_or_an_error_and_comes_back(
    loop: InstantLoop, drawn: bytes
) -> None:
    assert bombard(loop, az_rtu, drawn, bytes(range(256))) < 0.01


@bombarded(SCRIPTS)
def test_an_az_on_a_spoilt_network_gives_an_angle_or_an_error_and_comes_back(loop: InstantLoop, drawn: bytes) -> None:
    assert bombard(loop, az_tcp, drawn, bytes(range(256))) < 0.01


class Spectrometer:
    """What stands for a QE Pro in pyusb: the right replies, after `spoil` was let at their payloads and the line."""

    PAYLOADS: ClassVar[dict[int, bytes]] = {
        0x00000080: b"\3", 0x00000090: b"\4\1", 0x00000100: b"QEP00001", 0x00100820: struct.pack("<L", 50_000),
        0x00100900: struct.pack("<L", 2), 0x00100908: b"\1", 0x00180100: b"\4", 0x00181100: b"\2", 0x00420000: b"\1",
        0x00420003: b"\1", 0x00420004: struct.pack("<f", -10.0),
    }  # fmt: skip
    COEFFICIENTS: ClassVar[dict[int, tuple[float, ...]]] = {
        0x00180101: (350.0, 0.8, -1e-5, 1e-9),
        0x00181101: (1.0, 1e-7),
    }
    READ_BACK: ClassVar[dict[int, int]] = {
        0x00110010: 0x00110000, 0x00110110: 0x00110100, 0x00100832: 0x00100822, 0x00420010: 0x00420000,
        0x00420011: 0x00420001, 0x00110410: 0x00110400,
    }  # fmt: skip
    """What reads back what each setting sets."""

    def __init__(self, script: bytes) -> None:
        self._payloads = Line(script[::2])
        self._line = Line(script[1::2])
        self._known = dict(self.PAYLOADS)
        self._count = 0
        self._coming = b""
        self._reads = 0

    def set_configuration(self) -> None: ...

    def get_active_configuration(self) -> dict[tuple[int, int], object]:
        return {(0, 0): SimpleNamespace()}

    def write(self, endpoint: int, data: bytes, timeout: int) -> int:
        request = decode(data)
        if request.message_type in self.READ_BACK:
            self._known[self.READ_BACK[request.message_type]] = request.payload
        payload = self._payloads.carry(self._payload(request))
        reply = encode(Message(request.message_type, request.regarding, RESPONSE | ACK, 0, payload))
        self._coming += self._line.carry(reply)
        return len(data)

    def _payload(self, request: Message) -> bytes:
        kind = request.message_type
        if kind in self.COEFFICIENTS:
            return struct.pack("<f", self.COEFFICIENTS[kind][request.payload[0] % len(self.COEFFICIENTS[kind])])
        if kind == SPECTRUM:
            self._count += 1
            (microseconds,) = struct.unpack("<L", self._known[0x00110000])
            return METADATA.pack(self._count, self._count * 10**7, microseconds, 0, 0) + bytes(4 * PIXELS)
        return self._known.get(kind, b"")

    def read(self, endpoint: int, size: int, timeout: int) -> bytes:
        self._reads += 1
        assert self._reads < MOST_READS, "reads without an end"
        assert timeout > 0
        if not self._coming:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        data, self._coming = self._coming[:size], self._coming[size:]
        return data


@bombarded(st.binary(min_size=120, max_size=120))
def test_a_qe_pro_that_sends_anything_gives_finite_numbers_or_an_error(loop: InstantLoop, drawn: bytes) -> None:
    clock = SimulatedClock()
    device = Spectrometer(drawn[1:])
    qepro = QEPro("spectrometer", clock, timeout=0.1)

    async def scenario() -> None:
        try:
            await qepro.open()
            assert np.isfinite(await qepro.wavelengths()).all()
            assert np.isfinite(await qepro.nonlinearity()).all()
            check_value(await qepro.identity())
            check_value(await qepro.temperature())
            spectra = await qepro.sequence(0.1, 2) if drawn[0] % 2 else [await qepro.expose(0.1)]
            assert {(spectrum.integration_time, len(spectrum.counts)) for spectrum in spectra} == {(0.1, PIXELS)}
            assert all(abs(spectrum.detector_temperature + 10) <= 0.5 for spectrum in spectra)
        except DriverError as error:
            check_value(str(error))
        finally:
            await qepro.close()

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(usb.core, "find", lambda **_: [device])
        loop.run_until_complete(scenario())


def signed(data: bytes) -> bytes:
    """A message of the Ocean Binary Protocol with the checksum that it may have."""
    covered = bytearray(data[:-20])
    covered[22] = 1
    return bytes(covered) + hashlib.md5(covered, usedforsecurity=False).digest() + data[-4:]


@bombarded(st.tuples(st.binary(max_size=40), st.binary(min_size=12, max_size=12), st.booleans()))
def test_a_spoilt_message_with_a_checksum_is_never_another_message(loop: InstantLoop, drawn: Any) -> None:
    payload, script, is_noise = drawn
    sent = Message(0x00100928, 7, RESPONSE, 0, payload)
    came = script + payload if is_noise else Line(script).carry(signed(encode(sent)))
    try:
        if len(came) > 22 and came[22] != 1:
            total_length(came)
            decode(came)
        else:
            assert decode(came) == sent
    except ProtocolError:
        pass


@bombarded(SCRIPTS)
def test_one_spoilt_reply_is_never_taken_for_an_angle(loop: InstantLoop, drawn: bytes) -> None:
    family = (owis, k10cr1, az_rtu)[drawn[0] % 3]
    clock = SimulatedClock()
    axis = Axis(clock, start=12.0, velocity=20, acceleration=40, limits=(-10, 100))
    simulator, stage = family(axis, clock)
    at = drawn[1] % 16
    kind = INTACT + drawn[2] % 8
    # one to three flipped bits are what the checksum of Modbus RTU is sure to find; twice is what the others ask for
    spoilt = Line(bytes(at) + bytes([kind]) + (drawn[3:6] if kind != RESPELL else drawn[3:20]), b"0123456789-")
    far = Far(simulator, spoilt)
    loop.plug = lambda: Port(loop, far.answers)
    loop.wire = lambda protocol: Wire(loop, protocol, far.answers)

    async def scenario() -> None:
        try:
            await stage.open()
            assert abs(await stage.position() - true_reading(simulator, axis)) < 0.01
        except DriverError as error:
            check_value(str(error))
        finally:
            await stage.close()

    loop.run_until_complete(scenario())


@bombarded(st.tuples(st.binary(min_size=1, max_size=30), st.booleans()))
def test_a_line_that_never_falls_silent_is_given_up(loop: InstantLoop, drawn: tuple[bytes, bool]) -> None:
    drone, is_binary = drawn
    missing = apt.missing if is_binary else line(b"\r")
    query = Query(b"?", lambda reply: reply == b"never\r")
    port = SerialPort("stage", "/dev/x", baudrate=9600, timeout=0.1, missing=missing, unmistakable=query)
    loop.plug = lambda: Port(loop, lambda data: [], drone)

    async def scenario() -> None:
        await port.open()
        begin = loop.time()
        with pytest.raises(DriverError):
            await port.ask(query)
        assert loop.time() - begin < 3.0
        await port.close()

    loop.run_until_complete(scenario())
