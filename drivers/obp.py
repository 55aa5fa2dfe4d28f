"""Ocean Binary Protocol: how messages to and from Ocean Optics spectrometers are packed.

A message is a 44-byte header, a payload, a 16-byte checksum and a 4-byte footer, little-endian. A payload of
up to 16 bytes travels inside the header instead.
"""

import hashlib
import struct
from dataclasses import dataclass

from drivers.errors import ProtocolError

RESPONSE, ACK, ACK_REQUESTED, NACK, HARDWARE_EXCEPTION = 0x01, 0x02, 0x04, 0x08, 0x10
"""Flags of a message."""

ERRORS = {
    1: "it does not know the protocol",
    2: "it does not know the message type",
    3: "the checksum was wrong",
    4: "the message was too large",
    5: "the payload had the wrong length",
    6: "the payload was invalid",
    7: "it is not ready",
    8: "it does not know the checksum type",
    9: "it was reset",
    10: "too many interfaces are in use",
    11: "it is out of memory",
    12: "it does not have that information",
    13: "it has an internal error",
    255: "it will answer later",
}
"""Error numbers of a message, in words."""

INTERNAL_ERROR, DEFERRED = 13, 255

HEADER = struct.Struct("<HHHHLL6sBB16sL")
_TAIL = struct.Struct("<16sL")
_START, _PROTOCOL, _FOOTER = 0xC0C1, 0x1100, 0xC2C3C4C5
START = struct.pack("<HH", _START, _PROTOCOL)
"""The bytes with which every message begins."""
_LARGEST_IMMEDIATE = 16
_LARGEST_PAYLOAD = 1 << 20
_NO_CHECKSUM, _MD5 = 0, 1


@dataclass(frozen=True)
class Message:
    """One message, either way."""

    message_type: int
    """What it asks or answers."""
    regarding: int = 0
    """A number that the host chooses and the device repeats in its reply."""
    flags: int = 0
    """Sum of the flags above."""
    error: int = 0
    """Error number; 0 when there is none."""
    payload: bytes = b""
    """Up to 1 MiB."""


def encode(message: Message) -> bytes:
    """The bytes of `message`, without a checksum."""
    immediate = message.payload if len(message.payload) <= _LARGEST_IMMEDIATE else b""
    payload = b"" if immediate else message.payload
    header = HEADER.pack(
        _START,
        _PROTOCOL,
        message.flags,
        message.error,
        message.message_type,
        message.regarding,
        b"",
        _NO_CHECKSUM,
        len(immediate),
        immediate,
        len(payload) + _TAIL.size,
    )
    return header + payload + _TAIL.pack(b"", _FOOTER)


def total_length(start: bytes) -> int:
    """Bytes that a message has altogether, told from its first 44 bytes or more. Raises `ProtocolError`."""
    if len(start) < HEADER.size:
        raise ProtocolError(f"a message has at least {HEADER.size} bytes, but only {len(start)} came")
    begin, *_, remaining = HEADER.unpack_from(start)
    if begin != _START:
        raise ProtocolError(f"a message begins with {_START:#06x}, not {begin:#06x}")
    if not _TAIL.size <= remaining <= _TAIL.size + _LARGEST_PAYLOAD:
        raise ProtocolError(f"a header announces {remaining} bytes; {_TAIL.size} or more were expected")
    return HEADER.size + int(remaining)


def decode(data: bytes) -> Message:
    """The message in `data`, which holds exactly one. Raises `ProtocolError` when it is malformed."""
    if total_length(data) != len(data):
        raise ProtocolError(f"a message of {total_length(data)} bytes was announced, but {len(data)} came")
    _, protocol, flags, error, message_type, regarding, _, checksum_type, length, immediate, _ = HEADER.unpack_from(
        data
    )
    checksum, footer = _TAIL.unpack_from(data, len(data) - _TAIL.size)
    payload = data[HEADER.size : -_TAIL.size]
    if protocol != _PROTOCOL:
        raise ProtocolError(f"a message has protocol version {protocol:#06x}; {_PROTOCOL:#06x} was expected")
    if footer != _FOOTER:
        raise ProtocolError(f"a message ends with {footer:#010x}; {_FOOTER:#010x} was expected")
    if checksum_type not in {_NO_CHECKSUM, _MD5}:
        raise ProtocolError(f"a message has a checksum of type {checksum_type}; {_NO_CHECKSUM} or {_MD5} was expected")
    if checksum_type == _MD5 and checksum != hashlib.md5(data[: -_TAIL.size], usedforsecurity=False).digest():
        raise ProtocolError("a message does not match its checksum; check the USB cable")
    if length > _LARGEST_IMMEDIATE or (length and payload):
        raise ProtocolError("a message has data both in its header and behind it")
    return Message(message_type, regarding, flags, error, payload or immediate[:length])
