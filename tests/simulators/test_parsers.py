"""A simulator that is sent anything stays alive, answers in its own protocol, and still works."""

import logging
import math
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import usb.core
from hypothesis import strategies as st

from drivers import apt
from drivers.obp import ACK_REQUESTED, Message, decode, encode
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript, Kind
from simulators.devices.k10cr1 import SimulatedK10CR1
from simulators.devices.motion import Axis
from simulators.devices.oriental_az import SimulatedOrientalAZ
from simulators.devices.owis import SimulatedOwisPS
from simulators.devices.qepro import SimulatedQEPro
from simulators.devices.smc100 import SimulatedSMC100
from simulators.devices.wire import ByteServer
from simulators.errors import FaultScriptError
from tests.bombarded import bombarded


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def an_axis(clock: SimulatedClock) -> Axis:
    return Axis(clock, start=12.0, velocity=20, acceleration=40, limits=(-10, 100))


def feed(simulator: ByteServer, clock: SimulatedClock, data: bytes, size: int) -> list[bytes]:
    """Send `data` in pieces of `size` bytes, or in a hundred, a second apart, and return the replies."""
    replies, unfinished = [], b""
    size = max(size, len(data) // 100)
    for at in range(0, len(data), size):
        before = len(unfinished) + len(data[at : at + size])
        requests, unfinished = simulator.split_requests(unfinished + data[at : at + size])
        assert sum(map(len, requests)) + len(unfinished) <= before
        replies += [simulator.answer(request) for request in requests]
        clock.advance_to(clock.now() + 1.0)
    return replies


class Dice:
    """Choices that drawn bytes make; the first one where they are used up. Cheaper than a strategy for each choice."""

    def __init__(self, drawn: bytes) -> None:
        self._drawn = iter(drawn)

    def below(self, count: int) -> int:
        return next(self._drawn, 0) % count

    def of(self, choices: Sequence[Any]) -> Any:
        return choices[self.below(len(choices))]

    def noise(self, most: int) -> bytes:
        return bytes(self.below(256) for _ in range(self.below(most + 1)))


def said(part: Callable[[Dice], bytes]) -> st.SearchStrategy[tuple[bytes, int]]:
    """Up to four parts of a conversation, some of them noise, and in pieces of how many bytes they come."""

    def made(drawn: bytes) -> tuple[bytes, int]:
        dice = Dice(drawn)
        size = dice.of([1000, 3, 1])
        parts = [dice.noise(8) if dice.below(4) == 3 else part(dice) for _ in range(1 + dice.below(4))]
        return b"".join(parts), size

    return st.binary(min_size=64, max_size=64).map(made)


NUMBERS = ["0", "1", "30", "-5", "12.5", "0.000002", "99.999", "-", ".", "+", "?", "", "200000", "3", "7", "-45000"]
NUMBERS += ["9" * 400, "9" * 5000, "0." + "0" * 400 + "1"]


SMC100_LETTERS = ["OR", "PA", "PR", "TP", "TS", "TE", "ST", "VA", "AC", "SL", "SR", "MM", "RS", "VE", "XX"]


def smc100_line(dice: Dice) -> bytes:
    address = dice.of(["1", "1", "1", "1", "1", "2", "", "9" * 5000])
    return f"{address}{dice.of(SMC100_LETTERS)}{dice.of(NUMBERS)}\r\n".encode("ascii")


@bombarded(said(smc100_line))
def test_the_simulated_smc100_survives_any_bytes(drawn: tuple[bytes, int]) -> None:
    clock = SimulatedClock()
    simulator = SimulatedSMC100(an_axis(clock))
    for reply in feed(simulator, clock, *drawn):
        assert reply == b"" or (reply.lstrip(b"0").startswith(b"1") and reply.endswith(b"\r\n"))
    assert math.isfinite(float(simulator.answer(b"1TP")[3:]))
    assert len(simulator.answer(b"1TS")) == 11


OWIS_LETTERS = ["INIT", "MON", "MOFF", "STOP", "EFREE", "PGO", "ABSOL", "RELAT", "REF", "PSET", "CNT", "PVEL", "ACC"]
OWIS_LETTERS += ["TERM", "?CNT", "?ASTAT", "?MSG", "?PSET", "?MODE", "?X"]


def owis_line(dice: Dice) -> bytes:
    axis = dice.of(["1", "1", "1", "2", "9", ""])
    return f"{dice.of(OWIS_LETTERS)}{axis}{dice.of(['', '='])}{dice.of(NUMBERS)}\r".encode("ascii")


@bombarded(said(owis_line))
def test_the_simulated_owis_survives_any_bytes(drawn: tuple[bytes, int]) -> None:
    clock = SimulatedClock()
    simulator = SimulatedOwisPS([an_axis(clock)], clock, counts_per_degree=500)
    for reply in feed(simulator, clock, *drawn):
        assert reply == b"" or reply.endswith(b"\r")
    assert int(simulator.answer(b"?CNT1")) in range(-(10**400), 10**400)
    assert simulator.answer(b"?VERSION").startswith(b"PS10")


APT_NUMBERS = [0x0005, 0x0011, 0x0012, 0x0210, 0x0211, 0x0413, 0x0414, 0x0440, 0x0443, 0x0453, 0x0465, 0x0480, 0x0429]
APT_SIZES = {apt.MOVE_TO: 6, apt.SET_VELOCITY: 14, apt.SET_HOMING: 14}


def apt_frame(dice: Dice) -> bytes:
    number = dice.of(APT_NUMBERS)
    if dice.below(4) == 0:
        return apt.long(number, dice.noise(20))
    if number in APT_SIZES:
        return apt.long(number, bytes(dice.of([1, 0, 0, dice.below(256)]) for _ in range(APT_SIZES[number])))
    return apt.short(number, dice.below(3), dice.below(3))


@bombarded(said(apt_frame))
def test_the_simulated_k10cr1_survives_any_bytes(drawn: tuple[bytes, int]) -> None:
    clock = SimulatedClock()
    simulator = SimulatedK10CR1(an_axis(clock))
    for reply in feed(simulator, clock, *drawn):
        assert reply == b"" or reply[4] in {0x01, 0x81}
    status = simulator.answer(apt.short(apt.REQUEST_STATUS, 1))
    assert apt.missing(status[-20:]) == 0


def with_crc(frame: bytes) -> bytes:
    """A frame with the checksum of Modbus RTU, bit by bit as its specification says."""
    crc = 0xFFFF
    for byte in frame:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return frame + crc.to_bytes(2, "little")


UNITS = [1, 1, 1, 1, 0, 2, 255]
REGISTERS = [0x58, 0x66, 0x7C, 0x7D, 0x7F, 0x80, 0xCC, 0xCD, 0, 0xFFFF]
WORDS = [0, 1, 2, 16, 32, 64, 128, 9000, 0xFFFF]


def modbus_request(dice: Dice) -> bytes:
    address = dice.of(REGISTERS)
    match dice.below(4):
        case 0:
            words = [dice.of(WORDS) for _ in range(dice.below(19))]
            return struct.pack(f">BHHB{len(words)}H", 16, address, len(words), 2 * len(words), *words)
        case 1:
            return bytes([dice.below(256)]) + dice.noise(10)
    return struct.pack(">BHH", dice.of([3, 4, 6, 1, 8]), address, dice.below(200))


def rtu_frame(dice: Dice) -> bytes:
    return with_crc(bytes([dice.of(UNITS)]) + modbus_request(dice))


def tcp_frame(dice: Dice) -> bytes:
    content = bytes([dice.of(UNITS)]) + modbus_request(dice)
    return struct.pack(">HHH", dice.below(256), 0, len(content)) + content


@bombarded(said(rtu_frame))
def test_the_simulated_az_survives_any_bytes_on_a_serial_line(drawn: tuple[bytes, int]) -> None:
    clock = SimulatedClock()
    simulator = SimulatedOrientalAZ(an_axis(clock), rtu=True)
    for reply in feed(simulator, clock, *drawn):
        assert reply == b"" or with_crc(reply[:-2]) == reply
    assert len(simulator.answer(with_crc(struct.pack(">BBHH", 1, 3, 0xCC, 2)))) == 9


@bombarded(said(tcp_frame))
def test_the_simulated_az_survives_any_bytes_on_the_network(drawn: tuple[bytes, int]) -> None:
    clock = SimulatedClock()
    simulator = SimulatedOrientalAZ(an_axis(clock))
    for reply in feed(simulator, clock, *drawn):
        assert reply == b"" or int.from_bytes(reply[4:6], "big") == len(reply) - 6
    assert len(simulator.answer(struct.pack(">HHHBBHH", 7, 0, 6, 1, 3, 0xCC, 2))) == 13


class DarkDetector:
    """Nothing falls on it."""

    pixels = 1044
    wavelength_coefficients = (350.0, 0.8, -1e-5, 1e-9)
    nonlinearity_coefficients = (1.0, 0.0)

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float, ended: float
    ) -> Any:
        return np.zeros(self.pixels, dtype=np.uint32)


QEPRO_MESSAGES = [
    0x80, 0x90, 0x100, 0x101, 0x110000, 0x110010, 0x110100, 0x110110, 0x110400, 0x110410, 0x110610, 0x100000, 0x100820,
    0x100822, 0x100830, 0x100832, 0x100900, 0x100902, 0x100908, 0x100928, 0x180100, 0x180101, 0x181100, 0x181101,
    0x200000, 0x200100, 0x200110, 0x200300, 0x200310, 0x420000, 0x420001, 0x420003, 0x420004, 0x420010, 0x420011,
]  # fmt: skip


def obp_message(dice: Dice) -> bytes:
    payload = dice.of([b"", dice.noise(1), bytes(dice.below(256) for _ in range(4)), dice.noise(40)])
    flags = dice.of([0, ACK_REQUESTED])
    data = encode(Message(dice.of(QEPRO_MESSAGES), regarding=9, flags=flags, payload=payload))
    at, other = dice.below(70), dice.noise(3) if dice.below(4) == 3 else b""
    return data[:at] + other + data[at + len(other) :]


@bombarded(st.binary(min_size=160, max_size=160).map(lambda drawn: [obp_message(dice) for dice in 3 * [Dice(drawn)]]))
def test_the_simulated_qe_pro_survives_any_bytes(drawn: list[bytes]) -> None:
    simulator = SimulatedQEPro(DarkDetector(), SimulatedClock())
    handle = simulator.open_device(None)
    buffer = array("B", bytes(8192))

    def talk(data: bytes) -> bytes:
        simulator.bulk_write(handle, 0x01, 0, array("B", data), 1000)
        try:
            return buffer[: simulator.bulk_read(handle, 0x81, 0, buffer, 100)].tobytes()
        except usb.core.USBTimeoutError:
            return b""

    for data in drawn:
        reply = talk(data)
        assert reply == b"" or decode(reply).regarding in {0, 9} or data not in reply
    for _ in drawn:  # spectra may still be on their way
        talk(b"")
    assert decode(talk(encode(Message(0x00000100, regarding=11)))[-64:]).payload == b"QEP00001"


WORDS_OF_SCRIPTS = ["at", "from", "every", "times", "s", "#", "0", "-1", "1.5", "9" * 5000, "9" * 400 + "s", "12", "3"]
WORDS_OF_SCRIPTS += ["\N{ARABIC-INDIC DIGIT THREE}", "\n", "0.5 s", *Kind]


def fault_line(dice: Dice) -> str:
    if dice.below(3) == 2:
        return " ".join(dice.of(WORDS_OF_SCRIPTS) for _ in range(dice.below(7)))
    when, kind = dice.of(["at", "every", "from"]), dice.of(list(Kind))
    lasting = dice.of(["", " 0.5 s", " 0s", " " + "9" * 400 + " s"])
    return f"{when} {dice.of([0, 1, 5, '9' * 5000])} {kind}{lasting}{dice.of(['', ' 3 times', ' 0 times', ' # why'])}"


scripts = st.binary(min_size=32, max_size=32).map(
    lambda drawn: "\n".join(fault_line(dice) for dice in 3 * [Dice(drawn)])
)


@bombarded(st.one_of(scripts, scripts, st.text(max_size=40)))
def test_any_text_is_a_fault_script_or_is_refused_with_its_line(text: str) -> None:
    refusal, script = "", FaultScript()
    try:
        script = FaultScript.parse(text)
    except FaultScriptError as error:
        refusal = str(error)
    assert refusal == "" or refusal.startswith("line ")
    assert len(refusal.splitlines()) <= 1
    for fault in script.faults:
        assert fault.at >= 1
        assert fault.times >= 1
        assert 0 <= fault.seconds < math.inf
    assert all(script.due() is not None for _ in range(3))
