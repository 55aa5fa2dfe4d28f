"""Newport SMC100CC/PP single-axis motion controller.

ASCII at 57600 8N1: the axis address, a two-letter command, a parameter, CR LF. Only queries are answered, with
their own address and letters in front; whether a command was accepted is asked with `TE`. Positions are
degrees when the stage is a rotation stage.

The answer to `VE` (revision) was not checked on a device; it is only shown.
"""

import logging
import math
import re

from drivers.clock import Clock
from drivers.errors import DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.serial_port import ATTEMPTS, Query, SerialPort, line
from drivers.stage import AT_REST, DIRECTLY, Mounting, Stage

log = logging.getLogger(__name__)

END = b"\r\n"
"""Of every line, either way."""
NUMBER = rb"\s*[-+]?\d{1,20}(\.\d*)?([eE][-+]?\d{1,2})?\s*"
"""How a number is written; "nan" is none, nor is one so long that it would be infinite."""
ANSWERS = {
    "TS": rb"[0-9A-Fa-f]{6}",
    "TP": NUMBER,
    "VA": NUMBER,
    "AC": NUMBER,
    "TE": rb"[@A-Z]",
    "VE": rb"[ -~]*",
}
"""What stands behind the address and letters of an answer; one that looks otherwise was spoilt on the line."""
SAME_SPEED = 1e-3
"""Relative difference between a velocity and the same one as the controller writes it."""
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


class SMC100(Stage):
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
        mounting: Mounting = DIRECTLY,
        timeout: float = 1.0,
    ) -> None:
        super().__init__(name, clock, limits=limits, mounting=mounting)
        self._url = url
        self._address = address
        self._told = False
        """Whether a velocity was set, so that the one which the controller has stored does not count."""
        self._port = SerialPort(
            name,
            url,
            baudrate=57600,
            timeout=timeout,
            missing=line(END),
            # every other answer begins with other letters
            unmistakable=self._query("VE"),
        )

    async def open(self) -> None:
        """Connect, check that an SMC100 answers and learn how fast it moves.

        Raises `DeviceNotFound` when nothing answers and `ProtocolError` when something else does.
        """
        await self._port.open()
        try:
            await self.state()
            await self._ask("TE")  # forget an error that somebody else left behind
            self.velocity = await self._ask_setting("VA") / self._mounting.scale
            self.acceleration = await self._ask_setting("AC") / self._mounting.scale
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

    async def home(self) -> None:
        """Find the reference mark and return when it is found; a fault is cleared first.

        Raises `DeviceFault` or `DeviceTimeout` when it is not found.
        """
        await super().home()
        # a reset, or whoever switched the controller off before, has brought back the velocity that it has stored
        if self._told:
            await self.set_velocity(self.velocity)
        else:  # what it had when it was opened may be what a process that died in a slow motion has left
            self.velocity = await self._ask_setting("VA") / self._mounting.scale

    async def stop(self) -> None:
        """Stop moving at once; a stage that is not moving is left as it is."""
        stop = f"{self._address}ST".encode("ascii") + END
        self._port.send_now(stop)
        # it does no harm twice, and the first may be lost; some states, in which nothing moves, refuse it: forget that
        query = self._query("TE")
        await self._port.ask(Query(stop + query.request, query.wanted))

    async def _read_state(self) -> StageState:
        reply = await self._ask("TS")
        bits, code = int(reply[:4], 16), int(reply[4:], 16)
        position = await self._read_position()
        if bits:
            words = ", ".join(text for bit, text in FAULTS.items() if bits & bit)
            return StageState(StagePhase.FAULT, position, words or f"unknown error bits {bits:#06x}")
        for codes, phase in PHASES:
            if code in codes:
                return StageState(phase, position)
        raise ProtocolError(f"{self.name}: {code:02X} is no state of an SMC100")

    async def _read_position(self) -> float:
        """It must come twice: an answer to an earlier question looks like this one's."""
        now = await self._ask_number("TP")
        for attempt in range(ATTEMPTS):
            before, now = now, await self._ask_number("TP")
            if abs(now - before) <= AT_REST or await self._moves():
                return now
            if attempt == 0:
                continue  # a motion that ended in between does this, too
            log.warning("%s: reads %.5f° and then %.5f° at rest; asking again", self.name, before, now)
        raise ProtocolError(f"{self.name}: never reads the same position twice at rest; check the cable and the brake")

    async def _moves(self) -> bool:
        code = int((await self._ask("TS"))[4:], 16)
        return any(code in codes and phase in {StagePhase.MOVING, StagePhase.HOMING} for codes, phase in PHASES)

    async def _set_velocity(self, velocity: float) -> None:
        self._told = True
        await self._command(f"VA{velocity:.5f}")
        taken = await self._ask_setting("VA")
        if not math.isclose(taken, velocity, rel_tol=SAME_SPEED):
            message = f"{self.name}: was told to move at {velocity:g}°/s and reads back {taken:g}°/s; set it again"
            raise ProtocolError(message)

    async def _begin_homing(self) -> None:
        """A controller that has already found its mark, or stands in a fault, is reset: it searches only once."""
        if (await self.state()).phase is not StagePhase.NOT_REFERENCED:
            await self._reset()
        await self._command("OR")

    async def _begin_move(self, reading: float) -> None:
        await self._command(f"PA{reading:.5f}")

    async def _reset(self) -> None:
        """Start the controller again; it is silent meanwhile, and its reference is lost."""
        await self._port.send(f"{self._address}RS".encode("ascii") + END)
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
        before = f"{self._address}{command}".encode("ascii") + END
        query = self._query("TE")
        # once: asking tells and forgets the error, so that a second answer would say that all was well
        reply = self._text(await self._port.ask(Query(before + query.request, query.wanted), attempts=1), "TE")
        if reply != "@":
            reason = REFUSALS.get(reply, f"error {reply!r}")
            raise DeviceRefused(f"{self.name}: the SMC100 refused {command}: {reason}")

    async def _ask(self, letters: str, parameter: str = "") -> str:
        return self._text(await self._port.ask(self._query(letters, parameter), ATTEMPTS), letters)

    async def _ask_number(self, letters: str, parameter: str = "") -> float:
        return float(await self._ask(letters, parameter))

    async def _ask_setting(self, letters: str) -> float:
        """A setting above 0. It must come twice, because a digit that was spoilt on the line is a digit still."""
        first, second = await self._ask_number(letters, "?"), await self._ask_number(letters, "?")
        if not first == second > 0:
            raise ProtocolError(
                f"{self.name}: the SMC100 says that {letters} is {first:g}, then {second:g};"
                " the same number above 0 was expected twice; check the cable"
            )
        return first

    def _query(self, letters: str, parameter: str = "") -> Query:
        """A query; its answer begins with the same address and letters, and goes on as it should."""
        prefix = f"{self._address}{letters}".encode("ascii")
        answer = re.compile(prefix + ANSWERS[letters] + END)
        return Query(prefix + parameter.encode("ascii") + END, lambda reply: answer.fullmatch(reply) is not None)

    def _text(self, reply: bytes, letters: str) -> str:
        """What stands behind the address and letters of an answer."""
        text = reply.removesuffix(END).decode("ascii", errors="backslashreplace")
        return text.removeprefix(f"{self._address}{letters}")
