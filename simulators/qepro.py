"""An Ocean Optics QE Pro on a simulated USB port."""

import math
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.arrays import CountArray
from drivers.errors import ProtocolError
from drivers.obp import ACK, ACK_REQUESTED, HARDWARE_EXCEPTION, INTERNAL_ERROR, NACK, RESPONSE, Message, decode, encode
from simulators.clock import SimulatedClock
from simulators.usb_plug import UsbPlug

SPECTRUM = 0x00100928
SATURATION = 200_000
METADATA = struct.Struct("<LQLHB13x")
INTEGRATION_LIMITS = (8_000, 1_600_000_000)
"""Microseconds."""
BUFFER_SIZE = 50_000
"""Spectra."""
ROOM_TEMPERATURE = 25.0
"""Degrees Celsius, of the detector until the cooler is switched on."""
COOLING_TIME_CONSTANT = 15.0
"""Seconds in which the distance to the set point falls to 1/e."""
STABLE_WITHIN = 0.1
"""Degrees from the set point within which the cooler calls itself stable."""
UNKNOWN_TYPE, WRONG_LENGTH, INVALID_DATA, NOT_READY, NO_SUCH_INFORMATION = 2, 5, 6, 7, 12


class Detector(Protocol):
    """The optics and the sensor behind the electronics."""

    pixels: int
    """1044 for this model."""
    wavelength_coefficients: tuple[float, ...]
    """Polynomial in the pixel index, nanometres; 4 numbers."""
    nonlinearity_coefficients: tuple[float, ...]
    """Polynomial c0 + c1 x + ... in counts; 8 numbers."""

    def read_out(self, integration_time: float, *, shutter_open: bool, lamp_on: bool) -> CountArray:
        """[pixels] raw counts after `integration_time` seconds that end now."""


@dataclass
class QEProFaults:
    """What is wrong with the device; changed while it runs."""

    silent: bool = False
    """It takes requests and never replies."""
    refused: set[int] = field(default_factory=set)
    """Message types that are answered with a NACK ("not ready")."""
    broken: bool = False
    """Every message is answered with a hardware exception."""
    coldest: float = -100.0
    """Degrees Celsius below which the cooler cannot bring the detector."""
    slowness: float = 1.0
    """How many times longer than asked an acquisition takes."""
    stale_spectra: int = 0
    """Spectra of the previous integration time that are delivered in spite of abort and clear."""
    repeated_spectra: int = 0
    """Times that the previous spectrum is delivered again, with its own count."""
    foreign_replies: int = 0
    """Replies to an earlier request that come before the right one."""


@dataclass
class _Acquisition:
    """A spectrum that was requested and not yet delivered."""

    request: Message
    ends: float
    """Simulated seconds."""


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
        self.lamp_on = False
        """Whether the lamp output is enabled."""
        self.shutter_open = False
        """Whether the shutter output is set to open."""
        self._detector = detector
        self._serial_number = serial_number
        self._acquisitions: deque[_Acquisition] = deque()
        self._count = 0
        self._last_spectrum = b""
        self._integration_us = 100_000
        self._stale_us: int | None = None
        """Integration time of the spectrum that was under way when the time was changed."""
        self._buffer_size = BUFFER_SIZE
        self._set_point = -10.0
        self._cooler_on = False
        self._temperature_then = ROOM_TEMPERATURE
        self._then = clock.now()

    def _forget(self) -> None:
        super()._forget()
        self._acquisitions.clear()

    # temperature

    def _temperature(self) -> float:
        goal = max(self._set_point, self.faults.coldest) if self._cooler_on else ROOM_TEMPERATURE
        fading = math.exp(-(self._clock.now() - self._then) / COOLING_TIME_CONSTANT)
        return goal + (self._temperature_then - goal) * fading

    def _set_cooler(self, *, on: bool, set_point: float) -> None:
        self._temperature_then, self._then = self._temperature(), self._clock.now()
        self._cooler_on, self._set_point = on, set_point

    def _cooler_is_stable(self) -> bool:
        return self._cooler_on and abs(self._temperature() - self._set_point) < STABLE_WITHIN

    # messages

    def _receive(self, data: bytes) -> None:
        """Act on a message from the host and queue the reply; what is no message is ignored."""
        try:
            request = decode(data)
        except ProtocolError:
            return
        if not self.faults.silent:
            self._act_on(request)

    def _act_on(self, request: Message) -> None:
        if self.faults.broken:
            flags = RESPONSE | NACK | HARDWARE_EXCEPTION
            self._queue(encode(Message(request.message_type, request.regarding, flags, INTERNAL_ERROR)))
        elif request.message_type in self.faults.refused:
            self._reply(request, error=NOT_READY)
        elif request.message_type == SPECTRUM:
            ends = self._clock.now() + self._integration_us * 1e-6 * self.faults.slowness
            self._acquisitions.append(_Acquisition(request, ends))
        elif request.message_type in _QUERIES:
            answer = _QUERIES[request.message_type](self, request.payload)
            self._reply(request, answer or b"", error=NO_SUCH_INFORMATION if answer is None else 0)
        elif request.message_type in _SETTINGS:
            layout, obey = _SETTINGS[request.message_type]
            if len(request.payload) != struct.calcsize(layout):
                self._reply(request, error=WRONG_LENGTH)
            elif not obey(self, *struct.unpack(layout, request.payload)):
                self._reply(request, error=INVALID_DATA)
            elif request.flags & ACK_REQUESTED:
                self._reply(request, acknowledge=True)
        else:
            self._reply(request, error=UNKNOWN_TYPE)

    def _reply(self, request: Message, payload: bytes = b"", *, error: int = 0, acknowledge: bool = False) -> None:
        flags = RESPONSE | (NACK if error else 0) | (ACK if acknowledge else 0)
        while self.faults.foreign_replies:
            self.faults.foreign_replies -= 1
            self._queue(encode(Message(request.message_type, request.regarding - 1, RESPONSE | ACK, 0, payload)))
        self._queue(encode(Message(request.message_type, request.regarding, flags, error, payload)))

    def _abort(self) -> bool:
        """Drop what is being integrated; the host that waited for it is told."""
        while self._acquisitions:
            self._reply(self._acquisitions.popleft().request, error=NOT_READY)
        return True

    def _clear(self) -> bool:
        self._stale_us = None
        return True

    def _set_integration_time(self, microseconds: int) -> bool:
        if not INTEGRATION_LIMITS[0] <= microseconds < INTEGRATION_LIMITS[1]:
            return False
        if microseconds != self._integration_us:
            # the device integrates all the time, so one spectrum of the old time is under way
            self._stale_us = self._integration_us
            self._integration_us = microseconds
        return True

    def _prepare_reply(self, deadline: float) -> bool:
        if not self._acquisitions or self._acquisitions[0].ends > max(deadline, self._clock.now()):
            return False
        acquisition = self._acquisitions.popleft()
        self._clock.advance_to(acquisition.ends)
        self._deliver(acquisition)
        return True

    def _deliver(self, acquisition: _Acquisition) -> None:
        """Queue the spectrum that has just been integrated."""
        microseconds = self._integration_us
        if self._stale_us is not None:
            microseconds, self._stale_us = self._stale_us, None
        elif self.faults.stale_spectra:
            self.faults.stale_spectra -= 1
            microseconds = INTEGRATION_LIMITS[0] + (microseconds == INTEGRATION_LIMITS[0])
        if self.faults.repeated_spectra and self._last_spectrum:
            self.faults.repeated_spectra -= 1
            self._reply(acquisition.request, self._last_spectrum)
            return
        self._count += 1
        counts = self._detector.read_out(microseconds * 1e-6, shutter_open=self.shutter_open, lamp_on=self.lamp_on)
        metadata = METADATA.pack(self._count, round(self._clock.now() * 1e6), microseconds, 0, 0)
        self._last_spectrum = metadata + np.minimum(counts, SATURATION).astype("<u4").tobytes()
        self._reply(acquisition.request, self._last_spectrum)


def _coefficient(coefficients: tuple[float, ...], payload: bytes) -> bytes | None:
    """The coefficient whose index is in `payload`, or None when there is none."""
    return struct.pack("<f", coefficients[payload[0]]) if len(payload) == 1 and payload[0] < len(coefficients) else None


_QUERIES: dict[int, Callable[[SimulatedQEPro, bytes], bytes | None]] = {
    0x00000100: lambda sim, _: sim._serial_number.encode("ascii"),
    0x00000101: lambda sim, _: struct.pack("<B", len(sim._serial_number)),
    0x00110000: lambda sim, _: struct.pack("<L", sim._integration_us),
    0x00100900: lambda sim, _: struct.pack("<L", 0),
    0x00100908: lambda sim, _: struct.pack("<B", not sim._acquisitions),
    0x00100820: lambda sim, _: struct.pack("<L", BUFFER_SIZE),
    0x00100822: lambda sim, _: struct.pack("<L", sim._buffer_size),
    0x00180100: lambda sim, _: struct.pack("<B", len(sim._detector.wavelength_coefficients)),
    0x00180101: lambda sim, payload: _coefficient(sim._detector.wavelength_coefficients, payload),
    0x00181100: lambda sim, _: struct.pack("<B", len(sim._detector.nonlinearity_coefficients)),
    0x00181101: lambda sim, payload: _coefficient(sim._detector.nonlinearity_coefficients, payload),
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
    0x00110110: ("<B", lambda sim, mode: mode <= 3),
    0x00100000: ("<", SimulatedQEPro._abort),
    0x00100830: ("<", SimulatedQEPro._clear),
    0x00100832: ("<L", _set_buffer_size),
    0x00110410: ("<B", _switch("lamp_on")),
    0x00110610: ("<B", _switch("shutter_open")),
    0x00420010: ("<B", _enable_cooler),
    0x00420011: ("<f", _set_set_point),
}
"""Layout of the payload of each setting, and what to do, which returns whether the value was valid."""
