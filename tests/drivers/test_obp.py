"""Messages are packed as Ocean Optics' own clients pack them."""

import hashlib

import pytest
from seabreeze.pyseabreeze.protocol import OBPProtocol

from drivers.errors import ProtocolError
from drivers.obp import ACK_REQUESTED, Message, decode, encode, total_length


@pytest.mark.parametrize("payload", [b"", b"\x01", bytes(range(16)), bytes(range(17)), bytes(4208)])
def test_messages_are_byte_for_byte_those_of_seabreeze(payload: bytes) -> None:
    seabreeze = OBPProtocol.__new__(OBPProtocol)  # packing needs no transport
    theirs = seabreeze._construct_outgoing_message(0x00110010, payload, request_ack=True, regarding=5)
    ours = encode(Message(0x00110010, 5, ACK_REQUESTED, 0, payload))
    assert ours == theirs
    assert seabreeze._extract_message_data(ours) == payload
    assert decode(ours) == Message(0x00110010, 5, ACK_REQUESTED, 0, payload)


def with_checksum(message: Message) -> bytes:
    data = bytearray(encode(message))
    data[22] = 1
    data[-20:-4] = hashlib.md5(data[:-20]).digest()
    return bytes(data)


def test_a_flipped_bit_is_noticed_when_the_device_sends_checksums() -> None:
    data = bytearray(with_checksum(Message(1, payload=bytes(100))))
    assert decode(bytes(data)).payload == bytes(100)
    data[60] ^= 1
    with pytest.raises(ProtocolError, match="checksum"):
        decode(bytes(data))


@pytest.mark.parametrize(
    ("position", "value", "reason"),
    [(0, 0, "begins with"), (3, 0x20, "version"), (-1, 0, "ends with"), (40, 3, "announces"), (23, 17, "data both")],
)
def test_a_malformed_message_is_refused_with_the_reason(position: int, value: int, reason: str) -> None:
    data = bytearray(encode(Message(1, payload=b"x")))
    data[position] = value
    with pytest.raises(ProtocolError, match=reason):
        decode(bytes(data))


def test_a_torn_message_is_refused() -> None:
    data = encode(Message(1, payload=bytes(100)))
    assert total_length(data[:64]) == len(data) == 164
    with pytest.raises(ProtocolError, match="164 bytes was announced, but 163 came"):
        decode(data[:-1])
    with pytest.raises(ProtocolError, match="only 10"):
        decode(data[:10])
