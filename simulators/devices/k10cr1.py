"""A Thorlabs K10CR1 that answers on the wire."""

import struct
from collections.abc import Callable

from drivers import apt
from drivers.k10cr1 import ACCELERATION_UNITS, COUNTS_PER_DEGREE, ENABLED, REFERENCED, SEARCHING, VELOCITY_UNITS
from simulators.devices.motion import Axis
from simulators.devices.wire import ByteServer

FASTEST, STEEPEST = 10.0, 20.0
"""Degrees per second, and per second squared, above which nothing is set."""
SWITCH = -4.0
"""Degrees at which the switch stands by which it finds its zero."""
SLOW_HOMING = apt.HomingSetting(direction=2, switch=1, velocity=73291, offset=round(-SWITCH * COUNTS_PER_DEGREE))
"""How it searches when nobody has set anything: at a hundredth of a degree per second."""
OWN_BACKLASH = apt.BacklashSetting(round(COUNTS_PER_DEGREE))
"""By how much it passes its target on the way back when nobody has set anything."""
MOVING_EITHER_WAY = 0x30
"""Status bits that it sets both, whichever way it goes."""
CONNECTED = 0x100
MOTION_ERROR = 0x4000
REQUEST_ENABLED, TELL_ENABLED = 0x0211, 0x0212
REQUEST_POSITION, TELL_POSITION = 0x0411, 0x0412
REQUEST_BITS, TELL_BITS = 0x0429, 0x042A
START_UPDATES = 0x0011
COMMANDS = {
    apt.SET_ENABLED: 0,
    apt.SET_VELOCITY: apt.VELOCITY_DATA.size,
    apt.SET_HOMING: apt.HOMING_DATA.size,
    apt.SET_BACKLASH: apt.BACKLASH_DATA.size,
    apt.HOME: 0,
    apt.MOVE_TO: apt.MOVE_DATA.size,
}
"""What it may refuse, and how many bytes of data each has; it is deaf to one that has another number of them."""
MOTION_DATA = struct.Struct("<HlHHL")
"""Of what it sends unasked when a motion has ended: channel, position, velocity, unused, status bits."""


class SimulatedK10CR1(ByteServer):
    """One mount and an axis in degrees; it wakes up counting from where it stands, as after power-up.

    The axis keeps the speed that it has when the mount is made for every restart. When a motion has ended, the mount
    says so in front of its next reply. Like the real one it is deaf to what it does not know, and does not mind being
    told to move without knowing where it is.
    """

    def __init__(self, axis: Axis, *, serial_number: int = 55000001) -> None:
        super().__init__("simulated K10CR1")
        self._axis = axis
        self._serial_number = serial_number
        self._stored_speed = apt.VelocitySetting(
            acceleration=round(axis.acceleration * ACCELERATION_UNITS), velocity=round(axis.velocity * VELOCITY_UNITS)
        )
        self._slowness = 1.0
        self._wake_up()

    def _wake_up(self) -> None:
        self._zero = self._axis.position()
        self._speed = self._stored_speed
        self._homing_setting = SLOW_HOMING
        self._backlash = OWN_BACKLASH
        self._beyond: float | None = None
        self._enabled = True
        self._referenced = False
        self._searching = False
        self._error = 0
        self._refusing = False
        self._updating = False
        self._due: int | None = None

    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Frames for the mount; what belongs to none is passed over."""
        requests = []
        while len(data) >= apt.HEADER.size:
            _number, length, recipient, sender = apt.HEADER.unpack_from(data)
            size = apt.HEADER.size + (length if recipient & apt.LONG else 0)
            if recipient & ~apt.LONG != apt.DEVICE or sender != apt.HOST or size > 255:
                data = data[1:]
            elif len(data) < size:
                break
            else:
                requests.append(data[:size])
                data = data[size:]
        return requests, data

    def answer(self, request: bytes) -> bytes:
        """Act on one message, and reply to it with what has happened meanwhile in front."""
        self._look()
        number = apt.number_of(request)
        if number in COMMANDS and self._refusing:
            self._refusing = False
            words = b"refused by a fault script"
            return self._unasked() + _long(apt.REFUSED, apt.REFUSED_DATA.pack(number, 1, words))
        queries: dict[int, Callable[[], bytes]] = {
            apt.REQUEST_INFO: self._info,
            apt.REQUEST_STATUS: self._status,
            apt.REQUEST_VELOCITY: lambda: _long(apt.VELOCITY, self._speed.data()),
            apt.REQUEST_HOMING: lambda: _long(apt.HOMING, self._homing_setting.data()),
            apt.REQUEST_BACKLASH: lambda: _long(apt.BACKLASH, self._backlash.data()),
            REQUEST_ENABLED: lambda: _short(TELL_ENABLED, apt.ENABLE if self._enabled else apt.DISABLE),
            REQUEST_POSITION: lambda: _long(TELL_POSITION, struct.pack("<Hl", apt.CHANNEL, self._counts())),
            REQUEST_BITS: lambda: _long(TELL_BITS, struct.pack("<HL", apt.CHANNEL, self._bits())),
        }
        commands: dict[int, Callable[[bytes], None]] = {
            apt.SET_ENABLED: self._enable,
            apt.SET_VELOCITY: self._set_velocity,
            apt.SET_HOMING: self._set_homing,
            apt.SET_BACKLASH: self._set_backlash,
            apt.HOME: self._home,
            apt.MOVE_TO: self._move,
            apt.STOP: self._stop,
            START_UPDATES: lambda request: self._update(True),
            apt.STOP_UPDATES: lambda request: self._update(False),
        }
        if number in commands and len(request) == apt.HEADER.size + COMMANDS.get(number, 0):
            commands[number](request)
        unasked = self._unasked()
        return unasked + queries[number]() if number in queries else unasked

    def refuse(self) -> None:
        """Answer the next command with message 0x0081, and do not carry it out."""
        self._refusing = True

    def restart(self) -> None:
        """Wake up as after switching off and on: not homed, counting from where it stands, with slow homing."""
        self._axis.stop()
        self._wake_up()

    def jam(self) -> None:
        """Stop with a motion error until it is disabled and enabled, or switched off and on."""
        self._axis.stop()
        self._searching, self._beyond = False, None
        self._due = None
        self._error = MOTION_ERROR

    def drift(self, degrees: float = 0.5) -> None:
        """Read `degrees` too much until it is homed, as if steps had been lost."""
        self._zero -= degrees

    def slow(self, factor: float = 10.0) -> None:
        """Let each motion from now on take `factor` times as long as the settings say."""
        self._slowness = factor

    def _look(self) -> None:
        """Notice what has ended since the last time."""
        if self._beyond is not None and not self._axis.moving():
            target, self._beyond = self._beyond, None
            self._axis.move(target)
        if self._searching and not self._axis.moving():
            if self._axis.position() != 0.0:
                self._axis.home()  # it has found the switch, and goes from there to its zero
                return
            self._searching = False
            self._zero = 0.0
            self._referenced = True
            self._due = apt.HOMED

    def _unasked(self) -> bytes:
        """What it sends without being asked."""
        told = b""
        if self._due is not None and not self._axis.moving():
            number, self._due = self._due, None
            data = MOTION_DATA.pack(apt.CHANNEL, self._counts(), 0, 0, self._bits())
            told = _short(number) if number == apt.HOMED else _long(number, data)
        return told + self._status() if self._updating else told

    def _counts(self) -> int:
        return round((self._axis.position() - self._zero) * COUNTS_PER_DEGREE)

    def _bits(self) -> int:
        return (
            CONNECTED
            | (MOVING_EITHER_WAY if self._axis.moving() else 0)
            | (SEARCHING if self._searching else 0)
            | (REFERENCED if self._referenced else 0)
            | (ENABLED if self._enabled else 0)
            | self._error
        )

    def _info(self) -> bytes:
        data = apt.INFO_DATA.pack(self._serial_number, b"K10CR1", 16, 2, 0, 1, 0, b"", 1, 0, 1)
        return _long(apt.INFO, data)

    def _status(self) -> bytes:
        return _long(apt.STATUS, apt.STATUS_DATA.pack(apt.CHANNEL, self._counts(), 0, self._bits()))

    def _update(self, on: bool) -> None:
        self._updating = on

    def _enable(self, request: bytes) -> None:
        self._enabled = request[3] == apt.ENABLE
        if not self._enabled:
            self._axis.stop()
            self._searching, self._beyond = False, None
            self._error = 0

    def _set_velocity(self, request: bytes) -> None:
        asked = apt.VelocitySetting.read(request)
        if asked.velocity > 0 and asked.acceleration > 0:
            self._speed = apt.VelocitySetting(
                acceleration=min(asked.acceleration, round(STEEPEST * ACCELERATION_UNITS)),
                velocity=min(asked.velocity, round(FASTEST * VELOCITY_UNITS)),
            )

    def _set_homing(self, request: bytes) -> None:
        asked = apt.HomingSetting.read(request)
        if asked.velocity > 0:
            self._homing_setting = asked

    def _set_backlash(self, request: bytes) -> None:
        self._backlash = apt.BacklashSetting.read(request)

    def _home(self, request: bytes) -> None:
        if self._ready_to_move(self._homing_setting.velocity):
            self._referenced = False
            self._searching, self._beyond = True, None
            self._axis.move(max(SWITCH, self._axis.limits[0]))

    def _move(self, request: bytes) -> None:
        _channel, counts = apt.MOVE_DATA.unpack_from(request, apt.HEADER.size)
        target = counts / COUNTS_PER_DEGREE + self._zero
        if not self._ready_to_move(self._speed.velocity):
            return
        self._searching, self._beyond = False, None
        first = target
        if target < self._axis.position() and self._backlash.distance:
            first, self._beyond = target - self._backlash.distance / COUNTS_PER_DEGREE, target
        if self._axis.limits[0] <= first <= self._axis.limits[1]:
            self._axis.move(first)
            self._due = apt.COMPLETED
        else:
            self.jam()  # something stands in the way there

    def _stop(self, request: bytes) -> None:
        if self._axis.moving():
            self._axis.stop()
            self._searching, self._beyond = False, None
            self._due = apt.STOPPED

    def _ready_to_move(self, velocity: int) -> bool:
        """Let the axis move at `velocity` of the mount's units, if it may move."""
        self._axis.velocity = velocity / VELOCITY_UNITS / self._slowness
        self._axis.acceleration = self._speed.acceleration / ACCELERATION_UNITS / self._slowness**2
        return self._enabled and not self._error


def _short(number: int, state: int = 0) -> bytes:
    """A message from the mount about its channel, with one more parameter."""
    return apt.HEADER.pack(number, apt.CHANNEL | state << 8, apt.HOST, apt.DEVICE)


def _long(number: int, data: bytes) -> bytes:
    """A message from the mount with data."""
    return apt.HEADER.pack(number, len(data), apt.HOST | apt.LONG, apt.DEVICE) + data
