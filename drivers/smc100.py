"""Newport SMC100CC/PP single-axis motion controller.

ASCII at 57600 8N1: the axis address, a two-letter command, a parameter, CR LF. Only queries are answered, with
their own address and letters in front; whether a command was accepted is asked with `TE`. Positions are
degrees when the stage is a rotation stage.

The answer to `VE` (revision) was not checked on a device; it is only shown.
"""

import re

from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.serial_port import SerialPort
from drivers.travel import check_arrival, check_limits, longest_travel, travel_time, wait_for_rest

HOMING_TIME = 120.0
"""Seconds that a search for the reference mark may take."""
HOMING_POLL = 0.5
"""Seconds between two questions while it searches."""
RESET_TIME = 15.0
"""Seconds that the controller may take to start again after a reset."""

REFUSALS = {
    "A": "it does not know the command",
    "B": "the controller address is wrong",
    "C": "a parameter is missing or out of range",
    "D": "the command is not allowed",
    "E": "the search for the reference mark has already begun",
    "G": "the displacement is out of its own limits",
    "H": "the stage has not been homed; home it first",
    "I": "the command is not allowed while it is being configured",
    "J": "the stage is disabled",
    "K": "the command is not allowed while it is ready",
    "L": "the command is not allowed while it is homing",
    "M": "the command is not allowed while it is moving",
    "S": "its internal communication timed out",
}
"""What `TE` says, in words; "@" means no error."""

FAULTS = {
    0x001: "negative end of run",
    0x002: "positive end of run",
    0x004: "peak current limit",
    0x008: "RMS current limit",
    0x010: "short circuit",
    0x020: "following error",
    0x040: "homing timeout",
    0x080: "wrong stage",
    0x100: "DC voltage too low",
    0x200: "80 W output power exceeded",
}
"""The error bits of `TS`, in words."""

PHASES = (
    (range(0x0A, 0x12), StagePhase.NOT_REFERENCED),
    (range(0x14, 0x15), StagePhase.DISABLED),
    (range(0x1E, 0x20), StagePhase.HOMING),
    (range(0x28, 0x29), StagePhase.MOVING),
    (range(0x32, 0x36), StagePhase.READY),
    (range(0x3C, 0x3F), StagePhase.DISABLED),
    (range(0x46, 0x48), StagePhase.MOVING),
)
"""The state codes of `TS`; 0x14 is the configuration state, 0x46 and 0x47 are jogging."""


class SMC100:
    """A `RotationStage` on an SMC100.

    `url` is pyserial's, `address` the controller's number on its chain, `limits` the lowest and highest angle
    that may be commanded (degrees), `timeout` the longest wait for a reply (seconds).
    """

    def __init__(
        self,
        name: str,
        url: str,
        clock: Clock,
        *,
        address: int = 1,
        limits: tuple[float, float] = (-5.0, 90.0),
        timeout: float = 1.0,
    ) -> None:
        self.name = name
        self.limits = limits
        self._url = url
        self._clock = clock
        self._address = address
        self._velocity = 0.0
        self._acceleration = 0.0
        self._port = SerialPort(name, url, baudrate=57600, timeout=timeout, terminator=b"\r\n")

    async def open(self) -> None:
        """Connect, check that an SMC100 answers and learn how fast it moves.

        Raises `DeviceNotFound` when nothing answers and `ProtocolError` when something else does.
        """
        await self._port.open()
        try:
            await self.state()
            await self._ask("TE")  # forget an error that somebody else left behind
            self._velocity = await self._ask_number("VA", "?")
            self._acceleration = await self._ask_number("AC", "?")
        except DeviceTimeout as error:
            await self.close()
            message = f"{self.name}: no SMC100 with address {self._address} answers at {self._url}"
            raise DeviceNotFound(message + "; check its power, its cable and the address") from error
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        await self._port.close()

    async def identity(self) -> str:
        """Maker and what the controller says of itself."""
        return f"Newport {(await self._ask('VE')).strip()}"

    async def state(self) -> StageState:
        """What the stage is doing now; a fault is shown in the controller's words."""
        reply = await self._ask("TS")
        if not re.fullmatch("[0-9A-Fa-f]{6}", reply):
            raise ProtocolError(f"{self.name}: {reply!r} is no SMC100 state; six hexadecimal digits were expected")
        bits, code = int(reply[:4], 16), int(reply[4:], 16)
        position = await self.position()
        if bits:
            words = ", ".join(text for bit, text in FAULTS.items() if bits & bit)
            return StageState(StagePhase.FAULT, position, words or f"unknown error bits {bits:#06x}")
        for codes, phase in PHASES:
            if code in codes:
                return StageState(phase, position)
        raise ProtocolError(f"{self.name}: {code:02X} is no state of an SMC100")

    async def home(self) -> None:
        """Find the reference mark and return when it is found.

        A controller that has already found it, or stands in a fault, is reset first: it searches only once.
        Raises `DeviceFault` or `DeviceTimeout` when the search fails.
        """
        if (await self.state()).phase is not StagePhase.NOT_REFERENCED:
            await self._reset()
        await self._command("OR")
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=0.0, at_most=HOMING_TIME, poll=HOMING_POLL
        )
        if state.phase is not StagePhase.READY:
            raise DeviceFault(f"{self.name}: is {state.phase.value}, not ready, after homing; home it again")

    async def move_to(self, angle: float) -> float:
        """Move to `angle` degrees, wait until the stage rests there, and return the angle it reads back.

        Raises `DeviceRefused` outside `limits` before anything is sent, or with the controller's own reason;
        `DeviceFault` when it stops elsewhere; `DeviceTimeout` when it does not arrive.
        """
        check_limits(self.name, angle, self.limits)
        expected = travel_time(angle - await self.position(), self._velocity, self._acceleration)
        await self._command(f"PA{angle:.5f}")
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=expected, at_most=longest_travel(expected)
        )
        check_arrival(self.name, angle, state.position)
        return state.position

    async def position(self) -> float:
        """Angle now, degrees."""
        return await self._ask_number("TP")

    async def stop(self) -> None:
        """Stop moving at once; a stage that is not moving is left as it is."""
        try:
            await self._command("ST")
        except DeviceRefused:
            # some states refuse a stop; that is a failure only if something moves
            if (await self.state()).phase in {StagePhase.MOVING, StagePhase.HOMING}:
                raise

    async def _reset(self) -> None:
        """Start the controller again; it is silent meanwhile, and its reference is lost."""
        await self._port.send(f"{self._address}RS\r\n".encode("ascii"))
        begin = self._clock.now()
        while self._clock.now() - begin < RESET_TIME:
            await self._clock.sleep(0.5)
            try:
                if (await self.state()).phase is StagePhase.NOT_REFERENCED:
                    return
            except DeviceTimeout:
                continue
        raise DeviceTimeout(f"{self.name}: did not come back within {RESET_TIME:g} s of a reset; switch it off and on")

    async def _command(self, command: str) -> None:
        """Send a command and ask whether it was accepted, in one write. Raises `DeviceRefused`."""
        reply = await self._exchange(f"{self._address}{command}\r\n", "TE", "")
        if reply != "@":
            reason = REFUSALS.get(reply, f"error {reply!r}")
            raise DeviceRefused(f"{self.name}: the SMC100 refused {command}: {reason}")

    async def _ask(self, query: str, parameter: str = "") -> str:
        return await self._exchange("", query, parameter)

    async def _ask_number(self, query: str, parameter: str = "") -> float:
        reply = await self._ask(query, parameter)
        try:
            return float(reply)
        except ValueError:
            message = f"{self.name}: the SMC100 answered {reply!r} to {query}; a number was expected"
            raise ProtocolError(message) from None

    async def _exchange(self, before: str, query: str, parameter: str) -> str:
        """Send `before` and a query, and return the answer without the address and letters in front of it."""
        prefix = f"{self._address}{query}"
        line = await self._port.ask(f"{before}{prefix}{parameter}\r\n".encode("ascii"))
        reply = line.decode("ascii", errors="backslashreplace")
        if not reply.startswith(prefix):
            raise ProtocolError(f"{self.name}: {reply!r} is no answer to {prefix}; check that this is an SMC100's line")
        return reply.removeprefix(prefix)
