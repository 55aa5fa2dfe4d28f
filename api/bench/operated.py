"""The bench in the hands of operators: what may be done with it when, and what it does now.

    disconnected ── connect ──> connecting ──> ready ── home, jog, expose ──> busy ──> ready
         ^ ^                        │           │ ^
         │ └──────── stop ──────────┘           │ └── the campaign ends ── running <── a campaign
         └────────────── disconnect ────────────┘

*Stop* is obeyed in every phase: whatever is done is cancelled, the stages are stopped and the shutter is closed. All
else that is not possible in a phase is a `Conflict` that says why, and what is.
"""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack, suppress
from dataclasses import asdict
from typing import Any, Literal, TypeVar

from api.bench.messages import Snapshot
from api.bodies.bench import Alarm, BenchPhase, StageView
from api.errors import Conflict
from api.service import diagnose, open_instrument
from api.settings import InstrumentSettings, SpectrometerSettings
from drivers.errors import DriverError
from drivers.interfaces import StagePhase, StageState
from goniometer.bench.instrument import Instrument
from goniometer.errors import BenchUnfit, GoniometerError, InputError
from goniometer.geometry import Geometry, from_stages
from goniometer.storage.records import now
from simulators.bench.laboratory import Laboratory

PATIENCE_WITH_SILENCE = 5.0
"""Seconds for which a stage that does not answer is not asked again, so that it does not hold up who mends it."""
LETTING_GO = 10.0
"""Seconds that a command which was stopped may take to end; the bench is made safe before."""

POSSIBLE: dict[BenchPhase, tuple[str, ...]] = {
    "disconnected": ("connect", "doctor", "stop"),
    "connecting": ("stop",),
    "ready": ("disconnect", "home", "jog", "expose", "stop"),
    "busy": ("stop",),
    "running": ("stop",),
    "stopping": ("stop",),
}
"""Commands that are obeyed in each phase. Those that would change nothing are obeyed, too."""

_STAGES: tuple[Literal["sample", "detector"], ...] = ("sample", "detector")

T = TypeVar("T")
log = logging.getLogger(__name__)


def set_point(settings: InstrumentSettings | None) -> float:
    """Of the cooler, degrees Celsius; None is the simulated bench."""
    return (SpectrometerSettings() if settings is None else settings.spectrometer).cooler_set_point


def conflict(command: str, phase: BenchPhase, doing: str) -> Conflict:
    """Why `command` is not possible in a phase of the bench, and what is."""
    hint = {
        "disconnected": "connect it first",
        "connecting": "wait until it is connected, or stop it",
        "ready": "disconnect it first",
        "busy": "wait for its end, or stop it",
        "running": "a campaign owns it; abort that, or stop it",
        "stopping": "wait until it has stopped",
    }[phase]
    return Conflict(f"The bench cannot {command} while it is {phase} ({doing.rstrip('.')}); {hint}")


class OperatedBench:
    """The bench of one service; every method must be called in the event loop in which it was made."""

    def __init__(
        self, settings: InstrumentSettings | None, changed: Callable[[], None], alarm: Alarm | None = None
    ) -> None:
        """`settings` of None are the simulated bench; `changed` is called when there is something new to tell.

        `alarm` is what went wrong before.
        """
        self.settings = settings
        self.phase: BenchPhase = "disconnected"
        self.doing = "Nothing is connected."
        self.alarm = alarm
        """What went wrong with the bench last; None once something went right again."""
        self.stages: tuple[StageView, ...] = ()
        self.temperature: float | None = None
        """Of the detector as last read, degrees Celsius."""
        self.instrument: Instrument | None = None
        self.laboratory: Laboratory | None = None
        """Around a simulated bench that is connected."""
        self._changed = changed
        self._open: AsyncExitStack | None = None
        self._work: asyncio.Task[Any] | None = None
        self._wavelengths: Any = None
        self._silent_until = 0.0

    @property
    def standing(self) -> Geometry | None:
        """Where the arm stands as last read; None where that is not known."""
        angles = [stage.angle for stage in self.stages]
        if len(angles) == 2 and angles[0] is not None and angles[1] is not None:
            return from_stages(angles[0], angles[1])
        return None

    @property
    def shutter(self) -> Literal["open", "closed", "unknown"]:
        """As far as it is known."""
        is_open = None if self.instrument is None else self.instrument.shutter_open
        return "unknown" if is_open is None else "open" if is_open else "closed"

    async def connect(self, seed: int = 0) -> None:
        """Open all devices, switch the lamp on, find the reference marks; nothing where that is done.

        `seed` is that of a simulated bench. Raises `Conflict`, `DriverError` and `BenchUnfit`.
        """
        if self.phase == "ready":
            return
        self._check("connect")
        await self._do("connecting", "Opening all devices and finding the reference marks.", self._connect(seed))

    async def disconnect(self) -> None:
        """Make the bench safe and close all devices; nothing where that is done. Raises `Conflict`."""
        if self.phase == "disconnected":
            return
        self._check("disconnect")
        await self._close()

    async def home(self) -> None:
        """Find both reference marks again. Raises `Conflict`, `GeometryError` and `DriverError`."""
        instrument = self._ready("home")
        await self._do("busy", "Finding the reference marks.", instrument.arm.home())

    async def jog(self, sample: float | None, detector: float | None) -> None:
        """Turn the stages to these angles, degrees from the source axis; None leaves one where it is.

        Raises `Conflict`, `GeometryError` before anything moves, and `DriverError`.
        """
        instrument = self._ready("jog")

        async def work() -> None:
            here = [state.position for state in await instrument.arm.states()]
            to = (here[0] if sample is None else sample, here[1] if detector is None else detector)
            await instrument.arm.face_source(*to)

        told = " and ".join(
            f"the {name} stage to {angle:g}°"
            for name, angle in (("sample", sample), ("detector", detector))
            if angle is not None
        )
        await self._do("busy", f"Turning {told}.", work())

    async def expose(self, integration_time: float, *, dark: bool) -> None:
        """Read one spectrum that is shown and not kept; seconds, with the shutter closed if `dark`.

        Raises `Conflict`, `InputError` and `DriverError`.
        """
        instrument = self._ready("expose")
        low, high = instrument.integration_limits
        if not low <= integration_time < high:
            raise InputError(f"integration_time: {integration_time:g} s is not possible; give {low:g} s to {high:g} s")
        take = instrument.dark if dark else instrument.expose
        await self._do("busy", f"Exposing for {integration_time:g} s.", take(integration_time))

    async def doctor(self, *, home: bool, tell: Callable[[float, str], None]) -> dict[str, Any]:
        """Examine every device of the bench, which must not be connected. Raises `Conflict`.

        `tell` is told which part is done, 0 to 1, and what is done next.
        """
        self._check("doctor")
        findings = await self._do("busy", "Examining every device.", diagnose(self.settings, home=home, tell=tell))
        return {
            "fit": not any(finding.problems for finding in findings),
            "findings": [asdict(finding) | {"line": finding.line()} for finding in findings],
        }

    async def run(self, doing: str, work: Coroutine[Any, Any, T]) -> T:
        """Let a campaign have the bench, which is ready. Raises what `work` raises, and `Conflict`."""
        if self.phase != "ready":
            work.close()
            raise self._conflict("run a campaign")
        return await self._do("running", doing, work)

    async def stop(self) -> None:
        """Cancel whatever is done, stop the stages and close the shutter, at once and in every phase."""
        work, instrument = self._work, self.instrument
        if work is not None:
            self._enter("stopping", "Being stopped.")
            work.cancel()
        try:
            if instrument is not None:
                await instrument.safe()
        except DriverError as error:
            self._raise_alarm(error)
            raise
        finally:
            if work is not None:
                _, going_on = await asyncio.wait({work}, timeout=LETTING_GO)
                for task in going_on:  # a cancellation that comes with a reply may get lost
                    task.cancel()
                await asyncio.wait({work}, timeout=LETTING_GO)
            elif instrument is not None:
                self._enter("ready", "It was stopped.")

    async def park(self) -> None:
        """Stop everything and close all devices."""
        with suppress(DriverError):  # the device may be what failed; the others are closed all the same
            await self.stop()
        await self._close()

    async def look(self) -> None:
        """Ask the devices what they do now; a campaign is not disturbed."""
        instrument = self.instrument
        clock = asyncio.get_running_loop().time()
        if instrument is None or clock < self._silent_until:
            return
        try:
            states = await instrument.arm.states()
            if self.phase == "ready":
                self.temperature = round(await instrument.temperature(), 2)
        except DriverError:
            self._silent_until = clock + PATIENCE_WITH_SILENCE
            self.stages = self._views(instrument, (None, None))
            return
        spectrum = instrument.last_spectrum
        if self.phase != "ready" and spectrum is not None:
            self.temperature = round(spectrum.detector_temperature, 2)
        if self.instrument is instrument:  # else it was closed meanwhile
            self.stages = self._views(instrument, states)

    def snapshot(self) -> Snapshot | None:
        """The last spectrum; None where there is none yet."""
        instrument = self.instrument
        if instrument is None or instrument.last_spectrum is None or self._wavelengths is None:
            return None
        spectrum, standing = instrument.last_spectrum, self.standing
        return Snapshot(
            spectrum.count,
            self._wavelengths,
            spectrum.counts,
            spectrum.integration_time,
            instrument.saturation,
            self.shutter,
            None if standing is None else standing.theta_in,
            None if standing is None else standing.theta_out,
            spectrum.detector_temperature,
            now(),
        )

    def _views(
        self, instrument: Instrument, states: tuple[StageState | None, StageState | None]
    ) -> tuple[StageView, ...]:
        return tuple(
            StageView(
                name=name,
                angle=None if state is None or state.phase is StagePhase.NOT_REFERENCED else state.position,
                phase="unknown" if state is None else state.phase.value,
                moving=state is not None and state.phase in {StagePhase.MOVING, StagePhase.HOMING},
                limits=limits,
            )
            for name, state, limits in zip(_STAGES, states, instrument.arm.limits, strict=True)
        )

    def _ready(self, command: str) -> Instrument:
        self._check(command)
        assert self.instrument is not None  # it is ready
        return self.instrument

    def _check(self, command: str) -> None:
        if command not in POSSIBLE[self.phase]:
            raise self._conflict(command)

    def _conflict(self, command: str) -> Conflict:
        return conflict(command, self.phase, self.doing)

    def _enter(self, phase: BenchPhase, doing: str) -> None:
        self.phase, self.doing = phase, doing
        self._changed()

    async def _do(self, phase: BenchPhase, doing: str, work: Coroutine[Any, Any, T]) -> T:
        """Do `work` in a task that `stop` can cancel; afterwards the bench is ready, or what it became."""
        self._enter(phase, doing)
        self._work = task = asyncio.ensure_future(work)
        ended = "Ready."
        try:
            await asyncio.wait({task})
            if task.cancelled():
                ended = "It was stopped."
                raise Conflict(ended)
            result = task.result()
            self.alarm = None
            return result
        except asyncio.CancelledError:
            task.cancel()
            await asyncio.wait({task}, timeout=LETTING_GO)
            raise
        except (DriverError, GoniometerError) as error:
            ended = str(error)
            if isinstance(error, DriverError | BenchUnfit):
                self._raise_alarm(error)
            raise
        finally:
            self._work = None
            self._enter("disconnected" if self._open is None else "ready", ended)

    def _raise_alarm(self, error: DriverError | BenchUnfit) -> None:
        self.alarm = Alarm(text=str(error), since=now())
        log.error("%s", error)

    async def _connect(self, seed: int) -> None:
        async with AsyncExitStack() as opening:
            instrument, self.laboratory = await opening.enter_async_context(open_instrument(self.settings, seed))
            self._wavelengths = await instrument.wavelengths()
            self._open = opening.pop_all()
            self.instrument = instrument
        await self.look()

    async def _close(self) -> None:
        opened, self._open = self._open, None
        self.instrument, self.stages, self.temperature = None, (), None
        if opened is not None:
            self._enter("stopping", "Closing all devices.")
            await opened.aclose()
        self.laboratory = None
        self._enter("disconnected", "Nothing is connected.")
