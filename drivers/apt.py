"""Frames of Thorlabs' binary APT protocol, as far as a K10CR1 speaks it.

A message is a header of six bytes, little-endian: a number of 16 bits that says which message it is, then either two
parameters of a byte each or the length of the data that follow, then who it is for (its highest bit says that data
follow) and who sent it. There is no checksum and no terminator. So a frame is taken for one only when its number, its
length and both addresses fit together, which bytes from the middle of another frame, or noise, hardly ever do.

The numbers are those of Thorlabs' "APT Controllers Host-Controller Communications Protocol".
"""

import struct
from dataclasses import dataclass

HOST, DEVICE = 0x01, 0x50
"""Addresses of this computer and of a controller that has a USB plug of its own."""
LONG = 0x80
"""In the address of the recipient: data follow the header."""
HEADER = struct.Struct("<HHBB")
"""Number, length of the data (or two parameters), recipient, sender."""
CHANNEL = 1
"""The only one that a K10CR1 has."""
ENABLE, DISABLE = 1, 2
"""Parameters of `SET_ENABLED`."""
PROFILED = 2
"""Parameter of `STOP`: brake with the set acceleration; 1 would cut the pulses at full speed."""

REQUEST_INFO, INFO = 0x0005, 0x0006
STOP_UPDATES = 0x0012
"""Send no status unasked."""
REFUSED = 0x0081
"""The controller does not do what it was told, and says why."""
SET_ENABLED = 0x0210
SET_VELOCITY, REQUEST_VELOCITY, VELOCITY = 0x0413, 0x0414, 0x0415
SET_HOMING, REQUEST_HOMING, HOMING = 0x0440, 0x0441, 0x0442
HOME, HOMED = 0x0443, 0x0444
SET_BACKLASH, REQUEST_BACKLASH, BACKLASH = 0x043A, 0x043B, 0x043C
MOVE_TO, COMPLETED = 0x0453, 0x0464
STOP, STOPPED = 0x0465, 0x0466
REQUEST_STATUS, STATUS = 0x0480, 0x0481

INFO_DATA = struct.Struct("<L8sH4B60sHHH")
"""Serial number, model, type, firmware (minor, interim, major, unused), internal, hardware, modification, channels."""
REFUSED_DATA = struct.Struct("<HH64s")
"""Number of the message that is refused (0 when it is none), code, words."""
VELOCITY_DATA = struct.Struct("<H3l")
"""Channel, initial velocity (always 0), acceleration, velocity."""
HOMING_DATA = struct.Struct("<3H2l")
"""Channel, direction, limit switch, velocity, distance of the zero from the switch."""
BACKLASH_DATA = struct.Struct("<Hl")
"""Channel, distance by which a target is passed on the way back."""
MOVE_DATA = struct.Struct("<Hl")
"""Channel, target."""
STATUS_DATA = struct.Struct("<HlLL")
"""Channel, position, count of an encoder where there is one, status bits."""

LENGTHS = {
    INFO: (INFO_DATA.size,),
    REFUSED: (REFUSED_DATA.size,),
    VELOCITY: (VELOCITY_DATA.size,),
    HOMING: (HOMING_DATA.size,),
    BACKLASH: (BACKLASH_DATA.size,),
    HOMED: (0,),
    COMPLETED: (0, STATUS_DATA.size),
    STOPPED: (0, STATUS_DATA.size),
    STATUS: (STATUS_DATA.size,),
}
"""Bytes of data in the messages that a K10CR1 sends; whatever else it sends is passed over as noise."""


def short(number: int, first: int = 0, second: int = 0) -> bytes:
    """A message to the controller that has only two parameters, each one byte."""
    return HEADER.pack(number, first | second << 8, DEVICE, HOST)


def long(number: int, data: bytes) -> bytes:
    """A message to the controller with data."""
    return HEADER.pack(number, len(data), DEVICE | LONG, HOST) + data


def missing(data: bytes) -> int:
    """How many bytes a frame from the controller still lacks that begins with `data`; 0 when it is whole.

    -1 when no frame begins like this, so that its first byte belongs to something else.
    """
    if len(data) < HEADER.size:
        return HEADER.size - len(data)
    number, length, recipient, sender = HEADER.unpack_from(data)
    length = int(length) if recipient & LONG else 0
    if recipient not in {HOST, HOST | LONG} or sender != DEVICE or length not in LENGTHS.get(number, ()):
        return -1
    return HEADER.size + length - len(data)


def number_of(frame: bytes) -> int:
    """Which message a frame is."""
    return int.from_bytes(frame[:2], "little")


@dataclass(frozen=True)
class Info:
    """What a controller says of itself."""

    serial_number: int
    model: str
    firmware: str

    @classmethod
    def read(cls, frame: bytes) -> "Info":
        """From an `INFO` frame."""
        serial, model, _type, minor, interim, major, *_ = INFO_DATA.unpack_from(frame, HEADER.size)
        name = model.rstrip(b"\0 ").decode("ascii", errors="backslashreplace")
        return cls(serial, name, f"{major}.{interim}.{minor}")


@dataclass(frozen=True)
class Status:
    """Where a motor is and what it does."""

    position: int
    """Counts."""
    bits: int

    @classmethod
    def read(cls, frame: bytes) -> "Status":
        """From a `STATUS` frame."""
        _channel, position, _encoder, bits = STATUS_DATA.unpack_from(frame, HEADER.size)
        return cls(position, bits)


@dataclass(frozen=True)
class VelocitySetting:
    """How fast a motor is set to move, in the controller's units."""

    acceleration: int
    velocity: int

    @classmethod
    def read(cls, frame: bytes) -> "VelocitySetting":
        """From a `VELOCITY` frame."""
        _channel, _initial, acceleration, velocity = VELOCITY_DATA.unpack_from(frame, HEADER.size)
        return cls(acceleration, velocity)

    def data(self) -> bytes:
        """As data of `SET_VELOCITY`."""
        return VELOCITY_DATA.pack(CHANNEL, 0, self.acceleration, self.velocity)


@dataclass(frozen=True)
class HomingSetting:
    """How a motor is set to search for its reference mark, in the controller's units."""

    direction: int
    """1 forwards, 2 backwards."""
    switch: int
    """1 the one at the backward end, 4 the one at the forward end."""
    velocity: int
    offset: int
    """Counts from the switch to the zero."""

    @classmethod
    def read(cls, frame: bytes) -> "HomingSetting":
        """From a `HOMING` frame."""
        _channel, *setting = HOMING_DATA.unpack_from(frame, HEADER.size)
        return cls(*setting)

    def data(self) -> bytes:
        """As data of `SET_HOMING`."""
        return HOMING_DATA.pack(CHANNEL, self.direction, self.switch, self.velocity, self.offset)


@dataclass(frozen=True)
class BacklashSetting:
    """By how much a motor passes its target on the way back, in counts; 0 where it goes straight to it."""

    distance: int

    @classmethod
    def read(cls, frame: bytes) -> "BacklashSetting":
        """From a `BACKLASH` frame."""
        _channel, distance = BACKLASH_DATA.unpack_from(frame, HEADER.size)
        return cls(distance)

    def data(self) -> bytes:
        """As data of `SET_BACKLASH`."""
        return BACKLASH_DATA.pack(CHANNEL, self.distance)
