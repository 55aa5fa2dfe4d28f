"""A Newport SMC100 that answers on the wire."""

import re
from collections.abc import Callable

from simulators.motion import Axis
from simulators.wire import ByteServer, WireFaults

NOT_REFERENCED, HOMING, MOVING, READY, DISABLED = "0A", "1E", "28", "32", "3C"
STATE_ERRORS = {NOT_REFERENCED: "H", HOMING: "L", MOVING: "M", READY: "K", DISABLED: "J"}
"""The `TE` code of a command that its state does not allow."""


class SimulatedSMC100:
    """One controller with address 1 and an axis in degrees; it wakes up not referenced, as after power-up."""

    def __init__(self, axis: Axis, *, address: int = 1) -> None:
        self._axis = axis
        self._address = address
        self._server = ByteServer("simulated SMC100", self._receive)
        self._buffer = b""
        self._resting_state = NOT_REFERENCED
        self._last_error = "@"
        self._fault_bits = 0
        self._obstacle: tuple[float, int] | None = None
        self._soft_limits = axis.limits

    @property
    def wire(self) -> WireFaults:
        """What the line does to replies."""
        return self._server.faults

    def start(self) -> str:
        """Begin to listen and return the URL for pyserial."""
        return self._server.start()

    def unplug(self) -> None:
        """Drop the connection; `start` plugs it in again under the same URL."""
        self._server.unplug()

    def close(self) -> None:
        """End the simulator."""
        self._server.close()

    def fail(self, bits: int) -> None:
        """Stop with the error `bits` of the `TS` reply, disabled, until a reset."""
        self._axis.stop()
        self._fault_bits = bits
        self._resting_state = DISABLED

    def fail_beyond(self, angle: float, bits: int) -> None:
        """Fail as soon as somebody looks while the stage is beyond `angle` degrees, once."""
        self._obstacle = (angle, bits)

    def _receive(self, data: bytes) -> bytes:
        """Take bytes as they come and return the replies to the lines they complete."""
        *lines, self._buffer = (self._buffer + data).split(b"\r\n")
        return b"".join(self._answer(line.decode("ascii", errors="replace")) for line in lines)

    def _answer(self, line: str) -> bytes:
        """Reply to one line; whatever follows one command is ignored."""
        match = re.match(r"(\d+)([A-Z]{2})(\?|[-+]?\d*\.?\d*)", line)
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

    def _state(self) -> str:
        if self._obstacle and self._axis.position() > self._obstacle[0]:
            bits, self._obstacle = self._obstacle[1], None
            self.fail(bits)
        if self._axis.homing():
            return HOMING
        return MOVING if self._axis.moving() else self._resting_state

    def _query(self, command: str, parameter: str) -> str | None:
        """The answer to a query, or None when it is none."""
        axis = self._axis
        if command == "TE":
            error, self._last_error = self._last_error, "@"
            return error
        queries: dict[str, Callable[[], str]] = {
            "TS": lambda: f"{self._fault_bits:04X}{self._state()}",
            "TP": lambda: f"{axis.position():.5f}",
            "VE": lambda: " SMC100CC simulated",
        }
        settings: dict[str, Callable[[], str]] = {
            "VA": lambda: f"{axis.velocity:g}",
            "AC": lambda: f"{axis.acceleration:g}",
            "SL": lambda: f"{self._soft_limits[0]:g}",
            "SR": lambda: f"{self._soft_limits[1]:g}",
        }
        if parameter == "?" and command in settings:
            return settings[command]()
        return queries[command]() if command in queries else None

    def _obey(self, command: str, parameter: str) -> str:
        """Carry out a command and return its `TE` code."""
        if command in {"OR", "ST", "RS"}:
            return {"OR": self._home, "ST": self._stop, "RS": self._reset}[command]()
        commands: dict[str, Callable[[float], str]] = {
            "PA": self._move,
            "PR": lambda way: self._move(self._axis.position() + way),
            "MM": self._enable,
            "VA": lambda value: self._set_speed("velocity", value),
            "AC": lambda value: self._set_speed("acceleration", value),
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
        self._axis.home()
        return "@"

    def _stop(self) -> str:
        if self._state() == HOMING:
            self._resting_state = NOT_REFERENCED
        self._axis.stop()
        return "@"

    def _reset(self) -> str:
        self._axis.stop()
        self._resting_state, self._fault_bits = NOT_REFERENCED, 0
        return "@"

    def _move(self, target: float) -> str:
        if self._state() != READY:
            return STATE_ERRORS[self._state()]
        if not self._soft_limits[0] <= target <= self._soft_limits[1]:
            return "G"
        self._axis.move(target)
        return "@"

    def _enable(self, value: float) -> str:
        if value not in {0, 1}:
            return "C"
        if self._state() not in {READY, DISABLED}:
            return STATE_ERRORS[self._state()]
        self._resting_state = READY if value else DISABLED
        return "@"

    def _set_speed(self, name: str, value: float) -> str:
        if value <= 0:
            return "C"
        setattr(self._axis, name, value)
        return "@"

    def _set_soft_limit(self, end: int, value: float) -> str:
        low, high = (self._axis.limits[0], 0.0) if end == 0 else (0.0, self._axis.limits[1])
        if not low <= value <= high:
            return "C"
        self._soft_limits = (value, self._soft_limits[1]) if end == 0 else (self._soft_limits[0], value)
        return "@"
