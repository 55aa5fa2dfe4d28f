"""An OWIS PS 10 or PS 90 that answers on the wire.

The numbers of `?MSG` are from memory; its words are ours.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.devices.wire import ByteServer, lines

NO_MESSAGE = "00 no message"
WRONG_AXIS = "02 no such axis"
WRONG_VALUE = "04 value out of range"
WRONG_COMMAND = "05 unknown command"
WRONG_STATE = "07 not in this state of the axis"
REFUSED = "09 refused"

SEARCH_TIME = 1.0
"""Seconds that a search for the reference takes at least: the switch is left and approached again, slowly."""
RELEASE = 2.0
"""Degrees by which an axis is moved away from its limit switch."""
ZEROING_MODES = range(3, 8)
"""The modes of `REF` after which the counter is 0; the modes 0 to 2 leave it."""


@dataclass
class Drive:
    """One axis and what the controller knows of it."""

    axis: Axis
    velocity: int
    """Of `PVEL`, counts/s."""
    acceleration: int
    """Of `ACC`, counts/s^2."""
    resting: str = "I"
    """The letter of `?ASTAT` while it does not move."""
    zero: float = 0.0
    """Where the counter is 0, degrees of the axis."""
    referenced: bool = False
    absolute: bool = True
    target: int = 0
    """Of `PSET`, counts."""
    search: tuple[int, float] | None = None
    """The mode of a search under way, and the earliest end of it on the clock."""
    releasing: bool = False
    towards_switch: bool = False
    """Whether the motion under way ends at a limit switch."""


class SimulatedOwisPS(ByteServer):
    """A PS 10 (one of `axes`) or a PS 90 (up to nine), numbered from 1; they wake up not initialised.

    `counts_per_degree` holds for all axes, and their speeds at power-up are those that `axes` have when the controller
    is made. `PVEL` and `ACC` are counts/s and counts/s^2.
    """

    def __init__(self, axes: Sequence[Axis], clock: SimulatedClock, *, counts_per_degree: float) -> None:
        super().__init__("simulated OWIS PS")
        self._clock = clock
        self._counts_per_degree = counts_per_degree
        self._stored = [(axis, axis.velocity, axis.acceleration) for axis in axes]
        self._encoder_error = 0.0
        self._slowness = 1.0
        self._wake_up()

    def _wake_up(self) -> None:
        per_degree = self._counts_per_degree
        self._drives = [
            Drive(axis, round(velocity * per_degree), round(acceleration * per_degree), zero=axis.position())
            for axis, velocity, acceleration in self._stored
        ]
        self._message = NO_MESSAGE
        self._terminal_mode = 0
        self._refusing = False

    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Lines end with CR."""
        return lines(data, b"\r")

    def answer(self, request: bytes) -> bytes:
        """Reply to one line; a command has no reply, or OK in terminal mode 2."""
        text = request.decode("ascii", errors="replace").strip()
        reply = self._tell(text) if text.startswith("?") else self._obey(text)
        return f"{reply}\r".encode("ascii") if reply else b""

    def refuse(self) -> None:
        """Do not carry out the next command, and tell so when asked for the message."""
        self._refusing = True

    def restart(self) -> None:
        """Wake up as after switching off and on: not initialised, counters at 0, speeds as stored."""
        for drive in self._drives:
            drive.axis.stop()
        self._wake_up()

    def jam(self) -> None:
        """Stop all axes with a motion error, until they are initialised again."""
        for drive in self._drives:
            drive.axis.stop()
            drive.search, drive.releasing, drive.towards_switch = None, False, False
            drive.resting, drive.referenced = "E", False

    def drift(self, degrees: float = 0.5) -> None:
        """Read `degrees` too much from now on, although the motors go where they should."""
        self._encoder_error = degrees

    def slow(self, factor: float = 10.0) -> None:
        """Let each motion from now on take `factor` times as long as the settings say."""
        self._slowness = factor

    def _tell(self, text: str) -> str:
        """The answer to a question; none, but a message, when there is none."""
        match = re.fullmatch(r"\?([A-Z]+)(\d?)", text)
        if match is None:
            return self._complain(WRONG_COMMAND)
        letters, number = match.groups()
        general: dict[str, Callable[[], str]] = {
            "MSG": self._tell_message,
            "VERSION": lambda: f"PS{10 if len(self._drives) == 1 else 90}-V1.0-simulated",
            "ASTAT": lambda: "".join(self._letter(drive) for drive in self._drives),
        }
        if letters in general:
            return general[letters]()
        questions: dict[str, Callable[[Drive], str]] = {
            "CNT": lambda drive: str(self._counts(drive)),
            "ESTAT": lambda drive: str(self._switches(drive)),
            "REFST": lambda drive: str(int(drive.referenced)),
            "MODE": lambda drive: "ABSOL" if drive.absolute else "RELAT",
            "PSET": lambda drive: str(drive.target),
            "PVEL": lambda drive: str(drive.velocity),
            "ACC": lambda drive: str(drive.acceleration),
        }
        if letters not in questions:
            return self._complain(WRONG_COMMAND)
        drive = self._drive(number)
        if drive is None:
            return self._complain(WRONG_AXIS)
        self._settle(drive)
        return questions[letters](drive)

    def _tell_message(self) -> str:
        message, self._message = self._message, NO_MESSAGE
        return message if self._terminal_mode else message[:2]

    def _obey(self, text: str) -> str:
        """Carry out a command and return OK where the terminal mode wants it."""
        message = REFUSED if self._refusing else self._carry_out(text)
        self._refusing = False
        if message:
            return self._complain(message)
        return "OK" if self._terminal_mode == 2 else ""

    def _carry_out(self, text: str) -> str:
        """What is wrong with a command, or nothing when it was carried out."""
        match = re.fullmatch(r"([A-Z]+)(\d?)(?:=([-+]?\d{1,10}))?", text)
        if match is None:
            return WRONG_COMMAND
        letters, number, parameter = match.groups()
        if letters == "TERM":
            if parameter not in {"0", "1", "2"}:
                return WRONG_VALUE
            self._terminal_mode = int(parameter)
            return ""
        commands: dict[str, Callable[[Drive], str]] = {
            "INIT": self._initialise,
            "MON": self._switch_on,
            "MOFF": self._switch_off,
            "STOP": self._stop,
            "EFREE": self._release,
            "PGO": self._go,
            "ABSOL": lambda drive: self._count_from_zero(drive, True),
            "RELAT": lambda drive: self._count_from_zero(drive, False),
        }
        settings: dict[str, Callable[[Drive, int], str]] = {
            "REF": self._search,
            "PSET": self._set_target,
            "CNT": self._set_counter,
            "PVEL": self._set_velocity,
            "ACC": self._set_acceleration,
        }
        drive = self._drive(number)
        if letters not in (commands if parameter is None else settings):
            return WRONG_COMMAND
        if drive is None:
            return WRONG_AXIS
        self._settle(drive)
        return commands[letters](drive) if parameter is None else settings[letters](drive, int(parameter))

    def _complain(self, message: str) -> str:
        self._message = message
        return ""

    def _drive(self, number: str) -> Drive | None:
        return self._drives[int(number) - 1] if number and 1 <= int(number) <= len(self._drives) else None

    def _settle(self, drive: Drive) -> None:
        """Draw the consequences of a motion that has ended since somebody asked last."""
        if drive.axis.moving():
            return
        drive.releasing = False
        if drive.towards_switch:
            drive.towards_switch, drive.resting = False, "L"
        if drive.search is not None and self._clock.now() >= drive.search[1]:
            mode, drive.search = drive.search[0], None
            drive.referenced = True
            if mode in ZEROING_MODES:
                drive.zero = 0.0

    def _letter(self, drive: Drive) -> str:
        self._settle(drive)
        if drive.resting != "R":  # also while it runs out
            return drive.resting
        if drive.search is not None:
            return "P"
        if drive.axis.moving():
            return "F" if drive.releasing else "T"
        return "R"

    def _counts(self, drive: Drive) -> int:
        return round((drive.axis.position() + self._encoder_error - drive.zero) * self._counts_per_degree)

    def _switches(self, drive: Drive) -> int:
        low, high = drive.axis.limits
        return 0x01 * (drive.axis.position() <= low) | 0x08 * (drive.axis.position() >= high)

    def _set_pace(self, drive: Drive) -> None:
        """Hand the settings to the axis; time stretched by a factor divides the acceleration by its square."""
        drive.axis.velocity = drive.velocity / self._counts_per_degree / self._slowness
        drive.axis.acceleration = drive.acceleration / self._counts_per_degree / self._slowness**2

    def _initialise(self, drive: Drive) -> str:
        drive.axis.stop()
        drive.search, drive.releasing, drive.towards_switch, drive.resting = None, False, False, "R"
        return ""

    def _switch_on(self, drive: Drive) -> str:
        if drive.resting not in {"O", "R"}:
            return WRONG_STATE
        drive.resting = "R"
        return ""

    def _switch_off(self, drive: Drive) -> str:
        if drive.resting not in {"O", "R"}:
            return WRONG_STATE
        drive.axis.stop()
        drive.resting = "O"
        return ""

    def _stop(self, drive: Drive) -> str:
        drive.axis.stop()
        drive.search, drive.releasing, drive.towards_switch = None, False, False
        return ""

    def _release(self, drive: Drive) -> str:
        if self._letter(drive) != "R":
            return WRONG_STATE
        low, high = drive.axis.limits
        if self._switches(drive):
            self._set_pace(drive)
            drive.axis.move(low + RELEASE if drive.axis.position() <= low else high - RELEASE)
            drive.releasing = True
        return ""

    def _search(self, drive: Drive, mode: int) -> str:
        if mode not in range(8):
            return WRONG_VALUE
        if self._letter(drive) != "R":
            return WRONG_STATE
        self._set_pace(drive)
        drive.referenced, drive.search = False, (mode, self._clock.now() + SEARCH_TIME)
        drive.axis.home()
        return ""

    def _go(self, drive: Drive) -> str:
        if self._letter(drive) != "R":
            return WRONG_STATE
        begin = drive.zero if drive.absolute else drive.axis.position()
        target = begin + drive.target / self._counts_per_degree
        low, high = drive.axis.limits
        drive.towards_switch = not low <= target <= high
        self._set_pace(drive)
        drive.axis.move(min(max(target, low), high))
        return ""

    def _count_from_zero(self, drive: Drive, absolute: bool) -> str:
        drive.absolute = absolute
        return ""

    def _set_target(self, drive: Drive, value: int) -> str:
        drive.target = value
        return ""

    def _set_counter(self, drive: Drive, value: int) -> str:
        drive.zero = drive.axis.position() - value / self._counts_per_degree
        return ""

    def _set_velocity(self, drive: Drive, value: int) -> str:
        if value <= 0:
            return WRONG_VALUE
        drive.velocity = value
        return ""

    def _set_acceleration(self, drive: Drive, value: int) -> str:
        if value <= 0:
            return WRONG_VALUE
        drive.acceleration = value
        return ""
