"""Whatever bytes come from USB, a reply is the right one or an error says why not."""

import errno
from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
import usb.util
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceDisconnected, DeviceTimeout, DriverError, ProtocolError
from drivers.obp import RESPONSE, Message, decode, encode
from drivers.usb_link import UsbLink

QUESTION = 0x00000100


class Pipe:
    """A USB device whose answer to each request is what a test says."""

    def __init__(self, answers: list[list[bytes | Exception]]) -> None:
        self.answers = answers
        self.requests: list[Message] = []
        self.coming: deque[bytes | Exception] = deque()

    def set_configuration(self) -> None: ...

    def get_active_configuration(self) -> dict[tuple[int, int], object]:
        return {(0, 0): SimpleNamespace()}

    def clear_halt(self, endpoint: int) -> None: ...

    def write(self, endpoint: int, data: bytes, timeout: int) -> int:
        request = decode(data)
        self.requests.append(request)
        for part in self.answers.pop(0) if self.answers else []:
            number = request.regarding.to_bytes(4, "little")
            self.coming.append(part.replace(b"ASKED", number) if isinstance(part, bytes) else part)
        return len(data)

    def read(self, endpoint: int, size: int, timeout: int) -> bytes:
        if not self.coming:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        part = self.coming.popleft()
        if isinstance(part, Exception):
            raise part
        if len(part) > size:
            self.coming.appendleft(part[size:])
        return part[:size]


def answer(payload: bytes, regarding: int | None = None) -> bytes:
    """A reply; without a number it gets that of the request to which it comes."""
    data = encode(Message(QUESTION, regarding or 0, RESPONSE, 0, payload))
    return data if regarding else data[:12] + b"ASKED" + data[16:]


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> Any:
    return lambda *answers: make_link(Pipe(list(answers)), monkeypatch)


def make_link(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> tuple[UsbLink, Pipe]:
    monkeypatch.setattr(usb.util, "claim_interface", lambda *_: None)
    monkeypatch.setattr(usb.util, "find_descriptor", lambda *_, **__: SimpleNamespace(wMaxPacketSize=64))
    return UsbLink("device", pipe, 0.1), pipe


def test_replies_to_earlier_requests_are_skipped_but_not_for_ever(link: Any) -> None:
    opened, pipe = link([*[answer(b"old", 7)] * 7, answer(b"new")])
    assert opened.ask(QUESTION) == b"new"
    opened, pipe = link(*[[*[answer(b"old", 7)] * 8, answer(b"new")]] * 3)
    with pytest.raises(ProtocolError, match="8 other requests"):
        opened.ask(QUESTION)
    assert len(pipe.requests) == 3


def test_a_query_is_repeated_under_another_number_and_a_command_is_not(link: Any) -> None:
    opened, pipe = link([], [answer(b"x" * 40)[:50]], [answer(b"here")])
    assert opened.ask(QUESTION) == b"here"
    assert len({request.regarding for request in pipe.requests}) == 3
    opened, pipe = link([])
    with pytest.raises(DeviceTimeout):
        opened.command(QUESTION)
    assert len(pipe.requests) == 1


def test_the_reply_to_a_program_that_ran_before_is_not_taken(link: Any) -> None:
    assert link()[0].send(QUESTION).regarding != link()[0].send(QUESTION).regarding


@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE, errno.EPROTO])
def test_a_transfer_that_the_bus_spoilt_is_repeated(link: Any, number: int) -> None:
    opened, _ = link([usb.core.USBError("spoilt", -1, number)], [answer(b"here")])
    assert opened.ask(QUESTION) == b"here"


def test_a_device_that_is_gone_is_not_asked_again(link: Any) -> None:
    opened, pipe = link([usb.core.USBError("gone", -4, errno.ENODEV)], [answer(b"here")])
    with pytest.raises(DeviceDisconnected, match="plug it in"):
        opened.ask(QUESTION)
    assert len(pipe.requests) == 1


@given(
    noise=st.lists(st.binary(max_size=90), max_size=3),
    cuts=st.lists(st.integers(1, 200), max_size=5),
    torn=st.integers(0, 120),
    payload=st.binary(min_size=1, max_size=60).filter(lambda b: b"ASKED" not in b),
)
def test_no_bytes_around_a_reply_change_it(noise: list[bytes], cuts: list[int], torn: int, payload: bytes) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        pipe = Pipe([[b"".join(noise) + answer(payload)[:torn]], [answer(payload)]])
        opened, _ = make_link(pipe, monkeypatch)
        read = pipe.read
        sizes = deque(cuts)

        def cut(endpoint: int, size: int, timeout: int) -> bytes:
            return read(endpoint, min(size, sizes.popleft()) if sizes else size, timeout)

        pipe.read = cut
        try:
            assert opened.ask(QUESTION) == payload
        except DriverError:
            assert len(pipe.requests) == 3
