"""An Ocean Optics QE Pro on a simulated USB port.

What it knows of the trigger modes is that an integration begins with `trigger()` instead of by itself; the modes do
not differ otherwise. The ticks in the metadata are microseconds since it was switched on.
"""

import math
import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.arrays import CountArray
from drivers.errors import ProtocolError
from drivers.obp import ACK, ACK_REQUESTED, HARDWARE_EXCEPTION, INTERNAL_ERROR, NACK, RESPONSE, Message, decode, encode
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import Fault
from simulators.devices.usb_plug import UsbPlug

SATURATION = 200_000
METADATA = struct.Struct("<LQLHB13x")
INTEGRATION_LIMITS = (8_000, 1_600_000_000)
"""Microseconds."""
DEFAULT_INTEGRATION = 100_000
"""Microseconds."""
BUFFER_SIZE = 50_000
"""Spectra."""
GPIO_PINS = 10
SET_POINT = -10.0
"""Degrees Celsius, until another one is set."""
ROOM_TEMPERATURE = 25.0
"""Degrees Celsius, of the detector until the cooler is switched on."""
COOLING_TIME_CONSTANT = 15.0
"""Seconds in which the distance to the set point falls to 1/e."""
STABLE_WITHIN = 0.1
"""Degrees from the set point within which the cooler calls itself stable."""
RIPPLE_PERIOD = 1000.0
"""Of the slow sine that a poor controller adds to the temperature, seconds."""
UNKNOWN_TYPE, WRONG_LENGTH, INVALID_DATA, NOT_READY, NO_SUCH_INFORMATION = 2, 5, 6, 7, 12


class Detector(Protocol):
    """The optics and the sensor behind the electronics."""

    pixels: int
    """1044 for this model."""
    wavelength_coefficients: tuple[float, ...]
    """Polynomial in the pixel index, nanometres; 4 numbers."""
    nonlinearity_coefficients: tuple[float, ...]
    """Polynomial c0 + c1 x + ... in counts; 8 numbers."""

    def read_out(
        self,
        integration_time: float,
        *,
        shutter_open: bool,
        lamp_on: bool,
        sensor_temperature: float,
        ended: float,
    ) -> CountArray:
        """[pixels] raw counts of `integration_time` seconds that ended at the moment `ended`, seconds on the clock.

        `sensor_temperature` in degrees Celsius; a stable cooler gives exactly the same one every time.
        """


@dataclass
class QEProFaults:
    """What is wrong with the device, beside what its `script` does; changed while it runs."""

    refused: set[int] = field(default_factory=set)
    """Message types that are answered with a NACK ("not ready")."""
    unknown: set[int] = field(default_factory=set)
    """Message types that this firmware does not know."""
    ignored: set[int] = field(default_factory=set)
    """Settings that are acknowledged and not made."""
    broken: bool = False
    """Every message is answered with a hardware exception."""
    coldest: float = -100.0
    """Degrees Celsius below which the cooler cannot bring the detector."""
    offset: float = 0.0
    """Degrees by which the cooler misses its set point."""
    ripple: float = 0.0
    """Amplitude, degrees, of a slow wander around the set point, which the cooler itself takes for stable."""
    slowness: float = 1.0
    """How many times longer than asked an acquisition takes."""
    stale_spectra: int = 0
    """Spectra of another integration time that are delivered in spite of abort and clear."""
    repeated_spectra: int = 0
    """Times that the previous spectrum is delivered again, with its own count."""
    other_modes: int = 0
    """Spectra that are delivered of another trigger mode than the one set."""
    lost_spectra: int = 0
    """Spectra that are counted and never stored."""


@dataclass(frozen=True)
class _Request:
    """A message from the host, and what befalls its reply."""

    message: Message
    faults: Sequence[Fault]


class SimulatedQEPro(UsbPlug):
    """A pyusb backend with one QE Pro plugged in."""

    def __init__(
        self,
        detector: Detector,
        clock: SimulatedClock,
        *,
        serial_number: str = "QEP00001",
        packet_size: int = 512,
    ) -> None:
        super().__init__(clock, name=serial_number, vendor=0x2457, product=0x4004, packet_size=packet_size)
        self.faults = QEProFaults()
        self.gpio_inputs = 0
        """Levels that are applied to the pins from outside, one bit each."""
        self._detector = detector
        self._serial_number = serial_number
        self._temperature_then, self._then = ROOM_TEMPERATURE, clock.now()
        self._cooler_on, self._set_point = False, SET_POINT
        self._wake_up()

    def _wake_up(self) -> None:
        """Everything as after switching on."""
        self.lamp_on = False
        """Whether the lamp output is enabled."""
        self.shutter_open = False
        """Whether the shutter output is set to open."""
        self.gpio_outputs, self.gpio_values = 0, 0
        """Which pins are outputs, and the levels that they drive, one bit each."""
        self._switched_on = self._clock.now()
        self._count = 0
        self._last_spectrum = b""
        self._integration_us = DEFAULT_INTEGRATION
        self._trigger_mode = 0
        self._stale_us: int | None = None
        """Integration time of the spectrum that was under way when the time was changed."""
        self._buffer: deque[bytes] = deque()
        self._buffer_size = BUFFER_SIZE
        self._filling = False
        """Whether spectra are acquired into the buffer until it is full."""
        self._waiting: deque[_Request] = deque()
        """Requests for a spectrum that is still to be taken."""
        self._began: float | None = None
        """When the integration under way began, simulated seconds."""
        self._refusing = False

    # what can happen to it

    def trigger(self) -> None:
        """Give a pulse on the trigger input; it starts an integration that waits for one."""
        with self._lock:
            self._settle()
            if self._trigger_mode and self._began is None and self._wanted():
                self._began = self._clock.now()

    def restart(self) -> None:
        """Lose all settings, with the cooler and the lamp off; the connection stays, so that the host cannot tell."""
        with self._lock:
            self._set_cooler(on=False, set_point=SET_POINT)
            self.faults.broken = False
            self._forget()
            self._wake_up()

    def refuse(self) -> None:
        """Answer the next setting with a NACK, and do not make it."""
        self._refusing = True

    def jam(self) -> None:
        """Answer everything with a hardware exception, until restarted."""
        self.faults.broken = True

    def drift(self) -> None:
        """Let the detector get a degree warmer than its set point."""
        self._set_cooler(on=self._cooler_on, set_point=self._set_point)
        self.faults.offset = 1.0

    def slow(self) -> None:
        """Let acquisitions take ten times as long as asked."""
        self.faults.slowness = 10.0

    @property
    def integrating(self) -> bool:
        """Whether an integration is under way or waits for its trigger."""
        with self._lock:
            self._settle()
            return self._wanted()

    # temperature

    def _temperature(self, moment: float | None = None) -> float:
        """Degrees Celsius of the detector at a `moment`, seconds, or now."""
        moment = self._clock.now() if moment is None else moment
        wander = math.sin(2 * math.pi * moment / RIPPLE_PERIOD) if self._cooler_on else 0.0
        return self._controlled(moment) + self.faults.ripple * wander

    def _controlled(self, moment: float | None = None) -> float:
        """Degrees Celsius without the ripple; the controller holds it exactly once it is near."""
        moment = self._clock.now() if moment is None else moment
        goal = max(self._set_point + self.faults.offset, self.faults.coldest) if self._cooler_on else ROOM_TEMPERATURE
        fading = math.exp(-max(moment - self._then, 0.0) / COOLING_TIME_CONSTANT)
        distance = (self._temperature_then - goal) * fading
        return goal if self._cooler_on and abs(distance) < STABLE_WITHIN else goal + distance

    def _set_cooler(self, *, on: bool, set_point: float) -> None:
        self._temperature_then, self._then = self._controlled(), self._clock.now()
        self._cooler_on, self._set_point = on, set_point

    def _cooler_is_stable(self) -> bool:
        return self._cooler_on and abs(self._controlled() - self._set_point) < STABLE_WITHIN

    # messages

    def _receive(self, data: bytes, faults: Sequence[Fault]) -> None:
        """Act on a message from the host and queue the reply; what is no message is ignored."""
        try:
            request = _Request(decode(data), faults)
        except ProtocolError:
            return
        self._settle()
        self._act_on(request)
        self._settle()

    def _act_on(self, request: _Request) -> None:
        message_type, payload = request.message.message_type, request.message.payload
        if self.faults.broken:
            flags = RESPONSE | NACK | HARDWARE_EXCEPTION
            reply = Message(message_type, request.message.regarding, flags, INTERNAL_ERROR)
            self._queue(encode(reply), request.faults)
        elif message_type in self.faults.refused:
            self._reply(request, error=NOT_READY)
        elif message_type in self.faults.unknown:
            self._reply(request, error=UNKNOWN_TYPE)
        elif message_type == 0x00100928:
            self._waiting.append(request)
        elif message_type in _QUERIES:
            answer = _QUERIES[message_type](self, payload)
            self._reply(request, answer or b"", error=NO_SUCH_INFORMATION if answer is None else 0)
        elif message_type in _SETTINGS:
            self._set(request, *_SETTINGS[message_type])
        else:
            self._reply(request, error=UNKNOWN_TYPE)

    def _set(self, request: _Request, layout: str, obey: Callable[..., bool]) -> None:
        payload = request.message.payload
        if self._refusing:
            self._refusing = False
            self._reply(request, error=NOT_READY)
        elif len(payload) != struct.calcsize(layout):
            self._reply(request, error=WRONG_LENGTH)
        elif request.message.message_type not in self.faults.ignored and not obey(
            self, *struct.unpack(layout, payload)
        ):
            self._reply(request, error=INVALID_DATA)
        elif request.message.flags & ACK_REQUESTED:
            self._reply(request, acknowledge=True)

    def _reply(self, request: _Request, payload: bytes = b"", *, error: int = 0, acknowledge: bool = False) -> None:
        flags = RESPONSE | (NACK if error else 0) | (ACK if acknowledge else 0)
        message = Message(request.message.message_type, request.message.regarding, flags, error, payload)
        self._queue(encode(message), request.faults)

    def _forget(self) -> None:
        """A host that is gone waits for nothing; what goes into the buffer goes on."""
        super()._forget()
        self._waiting.clear()

    # acquisition

    def _wanted(self) -> bool:
        return bool(self._waiting) or (self._filling and len(self._buffer) < self._buffer_size)

    def _ends(self) -> float:
        """When the integration under way ends, simulated seconds; never while it waits for a trigger."""
        if self._began is None:
            return math.inf
        return self._began + self._integration_us * 1e-6 * self.faults.slowness

    def _settle(self) -> None:
        """Do what the time that has passed brought: end integrations, begin the next ones, deliver."""
        while True:
            while self._waiting and self._buffer:
                self._reply(self._waiting.popleft(), self._buffer.popleft())
            if not self._wanted():
                self._began = None
                return
            if self._began is None and not self._trigger_mode:
                self._began = self._clock.now()
            # a nanosecond, lest rounding put the end behind the moment for which the host has waited
            if self._ends() > self._clock.now() + 1e-9:
                return
            ended, self._began = self._ends(), None
            if not self._trigger_mode:
                self._began = ended  # back to back
            self._buffer += self._take_spectrum(ended)

    def _prepare_reply(self, deadline: float) -> bool:
        self._settle()
        while self._waiting and not self._coming and self._ends() <= deadline:
            self._clock.advance_to(self._ends())
            self._settle()
        return bool(self._coming)

    def _take_spectrum(self, ended: float) -> list[bytes]:
        """The spectrum whose integration ended at that moment, seconds on the clock; none when it gets lost."""
        microseconds, mode, faults = self._integration_us, self._trigger_mode, self.faults
        if self._stale_us is not None:
            microseconds, self._stale_us = self._stale_us, None
        elif faults.stale_spectra:
            faults.stale_spectra -= 1
            microseconds = INTEGRATION_LIMITS[0] + (microseconds == INTEGRATION_LIMITS[0])
        if faults.repeated_spectra and self._last_spectrum:
            faults.repeated_spectra -= 1
            return [self._last_spectrum]
        if faults.other_modes:
            faults.other_modes -= 1
            mode = 3 - mode
        self._count += 1
        counts = self._detector.read_out(
            microseconds * 1e-6,
            shutter_open=self.shutter_open,
            lamp_on=self.lamp_on,
            sensor_temperature=round(self._temperature(ended), 2),
            ended=ended,
        )
        if faults.lost_spectra:
            faults.lost_spectra -= 1
            return []
        tick = round((ended - self._switched_on) * 1e6)
        metadata = METADATA.pack(self._count, tick, microseconds, 0, mode)
        self._last_spectrum = metadata + np.minimum(counts, SATURATION).astype("<u4").tobytes()
        return [self._last_spectrum]

    def _abort(self) -> bool:
        """Drop what is being integrated; the host that waited for it is told."""
        while self._waiting:
            self._reply(self._waiting.popleft(), error=NOT_READY)
        self._filling, self._began = False, None
        return True

    def _clear(self) -> bool:
        self._stale_us = None
        self._buffer.clear()
        return True

    def _acquire(self) -> bool:
        self._filling = True
        return True

    def _set_integration_time(self, microseconds: int) -> bool:
        if not INTEGRATION_LIMITS[0] <= microseconds < INTEGRATION_LIMITS[1]:
            return False
        if microseconds != self._integration_us:
            # the device integrates all the time, so one spectrum of the old time is under way
            self._stale_us = self._integration_us
            self._integration_us = microseconds
        return True


def _coefficient(coefficients: tuple[float, ...], payload: bytes) -> bytes | None:
    """The coefficient whose index is in `payload`, or None when there is none."""
    return struct.pack("<f", coefficients[payload[0]]) if len(payload) == 1 and payload[0] < len(coefficients) else None


def _levels(sim: SimulatedQEPro) -> int:
    return (sim.gpio_values & sim.gpio_outputs) | (sim.gpio_inputs & ~sim.gpio_outputs)


_QUERIES: dict[int, Callable[[SimulatedQEPro, bytes], bytes | None]] = {
    0x00000080: lambda _, __: struct.pack("<B", 3),
    0x00000090: lambda _, __: struct.pack("<H", 0x0104),
    0x00000100: lambda sim, _: sim._serial_number.encode("ascii"),
    0x00000101: lambda sim, _: struct.pack("<B", len(sim._serial_number)),
    0x00110000: lambda sim, _: struct.pack("<L", sim._integration_us),
    0x00110100: lambda sim, _: struct.pack("<B", sim._trigger_mode),
    0x00110400: lambda sim, _: struct.pack("<B", sim.lamp_on),
    0x00100900: lambda sim, _: struct.pack("<L", len(sim._buffer)),
    0x00100908: lambda sim, _: struct.pack("<B", not sim._wanted()),
    0x00100820: lambda sim, _: struct.pack("<L", BUFFER_SIZE),
    0x00100822: lambda sim, _: struct.pack("<L", sim._buffer_size),
    0x00180100: lambda sim, _: struct.pack("<B", len(sim._detector.wavelength_coefficients)),
    0x00180101: lambda sim, payload: _coefficient(sim._detector.wavelength_coefficients, payload),
    0x00181100: lambda sim, _: struct.pack("<B", len(sim._detector.nonlinearity_coefficients)),
    0x00181101: lambda sim, payload: _coefficient(sim._detector.nonlinearity_coefficients, payload),
    0x00200000: lambda _, __: struct.pack("<B", GPIO_PINS),
    0x00200100: lambda sim, _: struct.pack("<L", sim.gpio_outputs),
    0x00200300: lambda sim, _: struct.pack("<L", _levels(sim)),
    0x00420000: lambda sim, _: struct.pack("<B", sim._cooler_on),
    0x00420001: lambda sim, _: struct.pack("<f", sim._set_point),
    0x00420003: lambda sim, _: struct.pack("<B", sim._cooler_is_stable()),
    0x00420004: lambda sim, _: struct.pack("<f", sim._temperature()),
}
"""Message types that are answered with data, or with None for information that there is not."""


def _switch(name: str) -> Callable[..., bool]:
    def obey(sim: SimulatedQEPro, value: int) -> bool:
        if value > 1:
            return False
        setattr(sim, name, bool(value))
        return True

    return obey


def _masked(name: str) -> Callable[..., bool]:
    def obey(sim: SimulatedQEPro, value: int, mask: int) -> bool:
        if mask >> GPIO_PINS:
            return False
        setattr(sim, name, (getattr(sim, name) & ~mask) | (value & mask))
        return True

    return obey


def _set_trigger_mode(sim: SimulatedQEPro, mode: int) -> bool:
    if mode <= 3:
        sim._trigger_mode, sim._began = mode, None
    return mode <= 3


def _enable_cooler(sim: SimulatedQEPro, value: int) -> bool:
    if value <= 1:
        sim._set_cooler(on=bool(value), set_point=sim._set_point)
    return value <= 1


def _set_set_point(sim: SimulatedQEPro, value: float) -> bool:
    sim._set_cooler(on=sim._cooler_on, set_point=value)
    return True


def _set_buffer_size(sim: SimulatedQEPro, size: int) -> bool:
    if 1 <= size <= BUFFER_SIZE:
        sim._buffer_size = size
    return 1 <= size <= BUFFER_SIZE


_SETTINGS: dict[int, tuple[str, Callable[..., bool]]] = {
    0x00110010: ("<L", SimulatedQEPro._set_integration_time),
    0x00110110: ("<B", _set_trigger_mode),
    0x00100000: ("<", SimulatedQEPro._abort),
    0x00100830: ("<", SimulatedQEPro._clear),
    0x00100832: ("<L", _set_buffer_size),
    0x00100902: ("<", SimulatedQEPro._acquire),
    0x00110410: ("<B", _switch("lamp_on")),
    0x00110610: ("<B", _switch("shutter_open")),
    0x00200110: ("<LL", _masked("gpio_outputs")),
    0x00200310: ("<LL", _masked("gpio_values")),
    0x00420010: ("<B", _enable_cooler),
    0x00420011: ("<f", _set_set_point),
}
"""Layout of the payload of each setting, and what to do, which returns whether the value was valid."""
