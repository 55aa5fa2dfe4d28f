"""A Newport SMC100 that answers on the wire."""

import re
from collections.abc import Callable

from simulators.devices.motion import Axis
from simulators.devices.wire import ByteServer, lines

NOT_REFERENCED, HOMING, MOVING, READY, DISABLED = "0A", "1E", "28", "32", "3C"
STATE_ERRORS = {NOT_REFERENCED: "H", HOMING: "L", MOVING: "M", READY: "K", DISABLED: "J"}
"""The `TE` code of a command that its state does not allow."""
SPEEDS = 1e-6, 1e12
"""Degrees per second, and per second squared, between which a velocity or an acceleration must lie; from memory."""
FOLLOWING_ERROR = 0x20
"""The error bit of `TS` for a motor that does not follow."""


class SimulatedSMC100(ByteServer):
    """One controller and an axis in degrees; it wakes up not referenced, as after power-up.

    The speed that the axis has when the controller is made is the stored one, to which each restart returns. After
    a restart the reading counts from where the stage stands, until the reference mark is found.
    """

    def __init__(self, axis: Axis, *, address: int = 1) -> None:
        super().__init__("simulated SMC100")
        self._axis = axis
        self._address = address
        self._stored_speed = axis.velocity, axis.acceleration
        self._encoder_error = 0.0
        self._counts_from = 0.0
        self._slowness = 1.0
        self._wake_up()

    def _wake_up(self) -> None:
        self._velocity, self._acceleration = self._stored_speed
        self._soft_limits = self._axis.limits
        self._resting_state = NOT_REFERENCED
        self._fault_bits = 0
        self._last_error = "@"
        self._refusing = False

    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Lines end with CR LF."""
        return lines(data, b"\r\n")

    def answer(self, request: bytes) -> bytes:
        """Reply to one line; a command has no reply, and whatever follows it in its line is ignored."""
        line = request.decode("ascii", errors="replace")
        match = re.match(r"(\d{1,2})([A-Z]{2})(\?|[-+]?\d*\.?\d*)", line)
        if match is None:
            self._last_error = "A"
            return b""
        address, command, parameter = match.groups()
        if int(address) != self._address:
            return b""
        reply = self._query(command, parameter)
        if reply is None:
            error = self._obey(command, parameter)
            if error != "@":
                self._last_error = error  # remembered until it is asked for
            return b""
        return f"{address}{command}{reply}\r\n".encode("ascii")

    def refuse(self) -> None:
        """Refuse the next command as one that is not allowed (D)."""
        self._refusing = True

    def restart(self) -> None:
        """Wake up as after switching off and on: not referenced, with the stored speed and limits."""
        self._axis.stop()
        self._counts_from = self._axis.position()
        self._wake_up()

    def jam(self) -> None:
        """Stop with a following error, disabled, until a restart or a reset."""
        self._axis.stop()
        self._fault_bits = FOLLOWING_ERROR
        self._resting_state = DISABLED

    def drift(self, degrees: float = 0.5) -> None:
        """Read `degrees` too much from now on, although the motor goes where it should."""
        self._encoder_error = degrees

    def slow(self, factor: float = 10.0) -> None:
        """Let each motion from now on take `factor` times as long as the settings say."""
        self._slowness = factor

    def _state(self) -> str:
        if self._axis.homing():
            return HOMING
        return MOVING if self._axis.moving() else self._resting_state

    def _query(self, command: str, parameter: str) -> str | None:
        """The answer to a query, or None when it is none."""
        if command == "TE":
            error, self._last_error = self._last_error, "@"
            return error
        queries: dict[str, Callable[[], str]] = {
            "TS": lambda: f"{self._fault_bits:04X}{self._state()}",
            "TP": lambda: f"{self._reading():.5f}",
            "VE": lambda: " SMC100CC simulated",
        }
        settings: dict[str, Callable[[], str]] = {
            "VA": lambda: f"{self._velocity:g}",
            "AC": lambda: f"{self._acceleration:g}",
            "SL": lambda: f"{self._soft_limits[0]:g}",
            "SR": lambda: f"{self._soft_limits[1]:g}",
        }
        if parameter == "?" and command in settings:
            return settings[command]()
        return queries[command]() if command in queries else None

    def _obey(self, command: str, parameter: str) -> str:
        """Carry out a command and return its `TE` code."""
        if self._refusing:
            self._refusing = False
            return "D"
        if command in {"OR", "ST", "RS"}:
            return {"OR": self._home, "ST": self._stop, "RS": self._reset}[command]()
        commands: dict[str, Callable[[float], str]] = {
            "PA": self._move,
            "PR": lambda way: self._move(self._reading() + way),
            "MM": self._enable,
            "VA": self._set_velocity,
            "AC": self._set_acceleration,
            "SL": lambda value: self._set_soft_limit(0, value),
            "SR": lambda value: self._set_soft_limit(1, value),
        }
        if command not in commands:
            return "A"
        try:
            return commands[command](float(parameter))
        except ValueError:
            return "C"

    def _home(self) -> str:
        state = self._state()
        if state != NOT_REFERENCED:
            return "E" if state == HOMING else STATE_ERRORS[state]
        self._resting_state = READY
        self._set_pace()
        self._axis.home()
        return "@"

    def _stop(self) -> str:
        if self._state() == HOMING:
            self._resting_state = NOT_REFERENCED
        self._axis.stop()
        return "@"

    def _reset(self) -> str:
        self.restart()
        return "@"

    def _move(self, target: float) -> str:
        if self._state() != READY:
            return STATE_ERRORS[self._state()]
        if not self._soft_limits[0] <= target <= self._soft_limits[1]:
            return "G"
        self._set_pace()
        self._axis.move(target)
        return "@"

    def _enable(self, value: float) -> str:
        if value not in {0, 1}:
            return "C"
        if self._state() not in {READY, DISABLED}:
            return STATE_ERRORS[self._state()]
        self._resting_state = READY if value else DISABLED
        return "@"

    def _set_velocity(self, value: float) -> str:
        if not SPEEDS[0] < value < SPEEDS[1]:
            return "C"
        self._velocity = value
        return "@"

    def _set_acceleration(self, value: float) -> str:
        if not SPEEDS[0] < value < SPEEDS[1]:
            return "C"
        self._acceleration = value
        return "@"

    def _set_pace(self) -> None:
        """Hand the settings to the axis; time stretched by a factor divides the acceleration by its square."""
        self._axis.velocity = self._velocity / self._slowness
        self._axis.acceleration = self._acceleration / self._slowness**2

    def _reading(self) -> float:
        """What the encoder says, degrees."""
        referenced = self._resting_state != NOT_REFERENCED and not self._axis.homing()
        return self._axis.position() + self._encoder_error - (0.0 if referenced else self._counts_from)

    def _set_soft_limit(self, end: int, value: float) -> str:
        low, high = (self._axis.limits[0], 0.0) if end == 0 else (0.0, self._axis.limits[1])
        if not low <= value <= high:
            return "C"
        self._soft_limits = (value, self._soft_limits[1]) if end == 0 else (self._soft_limits[0], value)
        return "@"
