"""A line of simulated instruments keeps what real ones keep: the order, the port, and no threads when it is closed."""

import contextlib
import gc
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from simulators.devices.faults import FaultScript, Kind
from simulators.devices.wire import ByteServer, lines


class Counter(ByteServer):
    """Answers each line with its own number and the line; "quiet" has no reply."""

    def __init__(self) -> None:
        super().__init__("counter")
        self.heard: list[bytes] = []
        self.struck: list[str] = []

    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        return lines(data, b"\n")

    def answer(self, request: bytes) -> bytes:
        self.heard.append(request)
        return b"" if request == b"quiet" else b"%d %s\n" % (len(self.heard), request)

    def refuse(self) -> None:
        self.struck.append("refuse")

    def restart(self) -> None:
        self.struck.append("restart")

    def jam(self) -> None:
        self.struck.append("jam")

    def drift(self) -> None:
        self.struck.append("drift")

    def slow(self) -> None:
        self.struck.append("slow")


@pytest.fixture
def counter() -> Iterator[Counter]:
    counter = Counter()
    yield counter
    counter.close()


@pytest.fixture(
    params=[
        "tcp",
        pytest.param("pty", marks=pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")),
    ]
)
def connect(counter: Counter, request: pytest.FixtureRequest) -> Iterator[Callable[[], serial.Serial]]:
    """Opens the line with pyserial, by either way."""
    opened: list[serial.Serial] = []

    def connect() -> serial.Serial:
        url = counter.start() if request.param == "tcp" else counter.start_pty()
        opened.append(serial.serial_for_url(url, timeout=5, exclusive=True))
        return opened[-1]

    yield connect
    for port in opened:
        port.close()


def wait_until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def until_it_opens(url: str) -> serial.Serial:
    deadline = time.monotonic() + 60
    while True:
        try:
            return serial.serial_for_url(url, timeout=5, exclusive=True)
        except serial.SerialException:
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_request_in_portions_is_one_and_two_in_one_write_are_two(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    for portion in (b"he", b"ll", b"o\nquiet\nyou\n"):
        port.write(portion)
        port.flush()
    assert port.readline() == b"1 hello\n"
    assert port.readline() == b"3 you\n"
    assert counter.heard == [b"hello", b"quiet", b"you"]
    assert counter.script.requests == 3


def test_a_delayed_reply_delays_what_follows_and_is_never_overtaken(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    counter.script = FaultScript.parse("at 1 delay 0.1 s\nat 2 split\nat 4 delay 0.05 s")
    port.write(b"a\nb\nc\nd\ne\n")
    assert [port.readline() for _ in range(5)] == [b"1 a\n", b"2 b\n", b"3 c\n", b"4 d\n", b"5 e\n"]


def test_a_lost_request_is_not_acted_on_and_a_lost_reply_is(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    counter.script = FaultScript.parse("at 1 lose-request\nat 2 lose-reply")
    port.write(b"a\nb\nc\n")
    assert port.readline() == b"2 c\n"
    assert counter.heard == [b"b", b"c"]


def test_a_merged_reply_waits_for_the_next(counter: Counter, connect: Callable[[], serial.Serial]) -> None:
    port = connect()
    counter.script = FaultScript.parse("at 1 merge")
    port.write(b"a\n")
    port.timeout = 0.05
    assert port.read(1) == b""
    port.timeout = 5
    port.write(b"b\n")
    assert port.readline() + port.readline() == b"1 a\n2 b\n"


def test_a_stalled_device_neither_answers_nor_acts_until_it_is_over(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    counter.script = FaultScript.parse("at 1 stall 0.2 s")
    port.write(b"a\nb\nquiet\n")
    wait_until(lambda: counter.script.requests >= 3)
    time.sleep(0.3)
    port.write(b"c\n")
    assert port.readline() == b"1 c\n"
    assert counter.heard == [b"c"]
    assert counter.script.requests == 4


def test_an_unplugged_line_breaks_in_mid_reply_and_comes_back_at_the_same_address(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    url = port.portstr
    counter.script = FaultScript.parse("at 2 unplug 1 s")
    port.write(b"a\n")
    assert port.readline() == b"1 a\n"
    port.write(b"hello\nnever\n")
    with pytest.raises(serial.SerialException):
        port.read(len(b"2 hello\n"))
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url, exclusive=True)
    again = until_it_opens(url)
    again.write(b"c\n")
    assert again.readline() == b"3 c\n"
    again.close()
    assert counter.heard == [b"a", b"hello", b"c"], "what follows in the same write is lost with the line"


def test_unplugging_by_hand_lasts_until_it_is_started_again(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    url = connect().portstr
    counter.unplug()
    counter.unplug()
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url, exclusive=True)
    port = connect()
    assert port.portstr == url
    port.write(b"a\n")
    assert port.readline() == b"1 a\n"


def test_faults_of_devices_strike_before_the_request_they_befall(
    counter: Counter, connect: Callable[[], serial.Serial]
) -> None:
    port = connect()
    counter.script = FaultScript.parse("at 1 restart\nat 1 refuse\nat 2 jam\nat 3 drift\nat 3 slow")
    port.write(b"a\n")
    assert port.readline() == b"1 a\n"
    assert counter.struck == ["restart", "refuse"]
    port.write(b"b\nc\n")
    assert port.readline() + port.readline() == b"2 b\n3 c\n"
    assert counter.struck == ["restart", "refuse", "jam", "drift", "slow"]
    assert [(number, fault.kind) for number, fault in counter.script.happened][2:] == [
        (2, Kind.JAM),
        (3, Kind.DRIFT),
        (3, Kind.SLOW),
    ]


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="descriptors are counted as Linux does")
def test_nothing_is_left_behind_by_a_line_that_is_closed_while_replies_wait_and_while_it_is_unplugged() -> None:
    def leftovers() -> tuple[int, set[threading.Thread]]:
        gc.collect()  # what other tests have left behind must not go in between
        return len(os.listdir("/proc/self/fd")), set(threading.enumerate())

    before = leftovers()
    for fault in ("delay 60 s", "unplug 60 s", "stall 60 s"):
        counter = Counter()
        path = counter.start_pty()
        port = serial.serial_for_url(counter.start(), timeout=0.1)
        terminal = serial.serial_for_url(path, timeout=0.1)
        counter.script = FaultScript.parse(f"from 1 {fault}")
        port.write(b"a\n")
        with contextlib.suppress(serial.SerialException):  # the first request may have unplugged it already
            terminal.write(b"b\n")
        time.sleep(0.02)
        counter.close()
        counter.close()
        port.close()
        terminal.close()
        assert not Path(path).parent.exists()
    assert leftovers() == before


def test_a_client_that_goes_away_in_mid_request_disturbs_nobody(counter: Counter) -> None:
    address = ("127.0.0.1", int(counter.start().rpartition(":")[2]))
    with socket.create_connection(address) as gone:
        gone.sendall(b"half a requ")
    with socket.create_connection(address, timeout=5) as client:
        client.sendall(b"a\n")
        assert client.recv(100) == b"1 a\n"
