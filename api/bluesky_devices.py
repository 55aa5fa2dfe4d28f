"""The bench as devices of bluesky: an unmodified `RunEngine` drives it with its own plans.

    from bluesky import RunEngine
    from bluesky.plans import list_scan
    from api.bluesky_devices import bluesky_bench

    with bluesky_bench(sample="sample-1") as bench:       # or bluesky_bench(load_instrument(FILE))
        RE = RunEngine()
        RE(list_scan([bench.spectrometer], bench.direction, [(20, 0), (20, 20), (20, 40)]))

| device | takes | what it does |
|---|---|---|
| direction | (theta_in, theta_out), degrees | moves both stages at once; refuses what the bench cannot measure |
| sample_stage, detector_stage | angle from the source axis, degrees | moves one stage; may face the source |
| shutter | "open", "closed" | whether the next spectrum is one of light or a dark one |
| integration_time | seconds | of the next spectrum |
| spectrometer | - | one spectrum at each trigger, in raw counts |

All of them stand on `goniometer.bench.instrument`, so limits, forbidden regions and what must not be believed of a
device hold here, too. Nothing is in our database: the documents are the RunEngine's. Needs the extra `bluesky`.
"""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from api.service import open_instrument
from api.settings import InstrumentSettings
from drivers.interfaces import Spectrum
from goniometer.bench.instrument import Instrument
from goniometer.constants import Constants
from goniometer.errors import InputError
from goniometer.geometry import Geometry, from_stages

T = TypeVar("T")
Reading = dict[str, dict[str, Any]]
Shutter = Literal["open", "closed"]


class Done:
    """What bluesky calls a status: whether a command has ended, and how."""

    def __init__(self, future: "Future[Any]") -> None:
        self._future = future

    def add_callback(self, callback: Callable[["Done"], None]) -> None:
        """Call `callback` when the command has ended, at once where it has."""
        self._future.add_done_callback(lambda _: callback(self))

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Why it failed, None where it did not; waits for its end, and raises `TimeoutError` after `timeout` s."""
        return self._future.exception(timeout)

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._future.done()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and not self._future.cancelled() and self._future.exception() is None


class _Line:
    """Commands to one instrument, one after the other, on an event loop in a thread of its own."""

    def __init__(self, loop: asyncio.AbstractEventLoop, instrument: Instrument) -> None:
        self.instrument = instrument
        self.targets: tuple[float | None, float | None] = (None, None)
        """Where the sample and the detector stage were sent; None where nobody knows."""
        self._loop = loop
        self._one = asyncio.Lock()
        self._last: Done | None = None

    def do(self, command: Callable[[], Awaitable[Any]]) -> Done:
        """Begin a command, after those that were begun before."""
        self._last = Done(asyncio.run_coroutine_threadsafe(self._in_turn(command), self._loop))
        return self._last

    async def move(self, targets: tuple[float, float], how: Awaitable[Any]) -> None:
        """Wait for a move to angles of the stages, and remember them."""
        self.targets = (None, None)
        await how
        self.targets = targets

    async def ask(self, question: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """The answer to a question that is asked from another event loop."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(question(), self._loop))

    async def stop(self, *, success: bool) -> None:
        """Bring the bench into its safe state, unless all is done and went well."""
        busy = self._last is not None and not self._last.done
        if busy or not success:
            self.targets = (None, None)
            await self.ask(self.instrument.safe)

    async def _in_turn(self, command: Callable[[], Awaitable[Any]]) -> Any:
        async with self._one:
            return await command()


class _Device:
    """What all devices have in common."""

    parent = None

    def __init__(self, name: str, line: _Line, source: str) -> None:
        self.name = name
        self._line = line
        self._source = source

    def _number(self, units: str) -> dict[str, Any]:
        return {"source": self._source, "dtype": "number", "shape": [], "units": units}

    def read_configuration(self) -> Reading:
        """Nothing."""
        return {}

    def describe_configuration(self) -> Reading:
        """Nothing."""
        return {}

    def __repr__(self) -> str:
        return f"<{self.name} of the goniometer>"


class _Moving(_Device):
    """A device whose stages can be stopped."""

    async def stop(self, success: bool = True) -> None:
        """Stop both stages at once and close the shutter, unless everything is done and went well."""
        await self._line.stop(success=success)

    async def pause(self) -> None:
        """Bring the bench into its safe state; the RunEngine repeats what was interrupted."""
        await self._line.stop(success=False)

    async def resume(self) -> None:
        """Nothing: the next move goes on from anywhere."""


class Direction(_Moving):
    """Incident and reflected direction together."""

    _wanted: tuple[float, float] | None = None

    def check_value(self, value: Sequence[float]) -> None:
        """Raise `GeometryError` where the bench cannot measure at (theta_in, theta_out), degrees."""
        self._line.instrument.arm.check(_geometry(value))

    def set(self, value: Sequence[float]) -> Done:
        """Move to (theta_in, theta_out), degrees; raises `GeometryError` at once where the bench cannot measure."""
        wanted = _geometry(value)
        self._line.instrument.arm.check(wanted)
        self._wanted = wanted.theta_in, wanted.theta_out
        targets = wanted.sample_angle, wanted.detector_angle
        return self._line.do(lambda: self._line.move(targets, self._line.instrument.arm.goto(wanted)))

    async def locate(self) -> dict[str, tuple[float, float] | None]:
        """Where it was sent, None before that, and where it is, both (theta_in, theta_out), degrees."""
        here = await self._here()
        return {"setpoint": self._wanted, "readback": (here.theta_in, here.theta_out)}

    async def read(self) -> Reading:
        """What both stages read now, as angles to the normal of the sample."""
        here, now = await self._here(), time.time()
        return {
            f"{self.name}_theta_in": {"value": here.theta_in, "timestamp": now},
            f"{self.name}_theta_out": {"value": here.theta_out, "timestamp": now},
        }

    def describe(self) -> Reading:
        """Two angles."""
        return {f"{self.name}_{angle}": self._number("deg") for angle in ("theta_in", "theta_out")}

    @property
    def hints(self) -> dict[str, Any]:
        """Both angles are worth a plot."""
        return {"fields": list(self.describe())}

    async def _here(self) -> Geometry:
        return from_stages(*await self._line.ask(self._line.instrument.arm.standing))


class Stage(_Moving):
    """One rotation stage, as an angle from the source axis."""

    def __init__(self, name: str, line: _Line, source: str, axis: int) -> None:
        """`axis` is 0 for the sample stage, 1 for the detector stage."""
        super().__init__(name, line, source)
        self._axis = axis
        self._wanted: float | None = None

    def set(self, value: float) -> Done:
        """Move to `value` degrees; the other stage stays."""
        self._wanted = float(value)
        return self._line.do(lambda: self._go(float(value)))

    async def locate(self) -> dict[str, float | None]:
        """Where it was sent, None before that, and where it is, degrees."""
        return {
            "setpoint": self._wanted,
            "readback": (await self._line.ask(self._line.instrument.arm.standing))[self._axis],
        }

    async def read(self) -> Reading:
        """What the stage reads now."""
        here = await self._line.ask(self._line.instrument.arm.standing)
        return {self.name: {"value": here[self._axis], "timestamp": time.time()}}

    def describe(self) -> Reading:
        """One angle."""
        return {self.name: self._number("deg")}

    @property
    def hints(self) -> dict[str, Any]:
        """It is worth a plot."""
        return {"fields": [self.name]}

    async def _go(self, angle: float) -> None:
        here = await self._line.instrument.arm.standing()
        # a stage that stays is sent where it was sent before, not where it reads now: else it would creep
        sample, detector = (
            angle if axis == self._axis else here[axis] if target is None else target
            for axis, target in enumerate(self._line.targets)
        )
        await self._line.move((sample, detector), self._line.instrument.arm.face_source(sample, detector))


class Setting(_Device):
    """A value that the next spectrum is taken with; it does not touch the bench before."""

    def __init__(self, name: str, line: _Line, value: float | str, check: Callable[[Any], Any], units: str) -> None:
        """`check` returns what a value means and raises `InputError` where it means nothing."""
        super().__init__(name, line, "goniometer")
        self.value: Any = check(value)
        self._check = check
        self._units = units
        self._moment = time.time()

    def check_value(self, value: Any) -> None:
        """Raise `InputError` for a value that cannot be set."""
        self._check(value)

    def set(self, value: Any) -> Done:
        """Take it from the next spectrum on; raises `InputError` for a value that cannot be set."""
        self.value, self._moment = self._check(value), time.time()
        done: Future[None] = Future()
        done.set_result(None)
        return Done(done)

    async def locate(self) -> dict[str, Any]:
        """The value, which is what was set."""
        return {"setpoint": self.value, "readback": self.value}

    def read(self) -> Reading:
        """The value."""
        return {self.name: {"value": self.value, "timestamp": self._moment}}

    def describe(self) -> Reading:
        """A number or a text."""
        kind = "string" if isinstance(self.value, str) else "number"
        units = {"units": self._units} if self._units else {}
        return {self.name: {"source": self._source, "dtype": kind, "shape": []} | units}

    @property
    def hints(self) -> dict[str, Any]:
        """It is worth a plot where it is scanned."""
        return {"fields": [self.name]}


class Spectrometer(_Device):
    """The array spectrometer, in raw counts."""

    def __init__(self, name: str, line: _Line, constants: Constants, settings: tuple[Setting, Setting]) -> None:
        """`settings` are the integration time and the shutter."""
        super().__init__(name, line, constants.spectrometer)
        self._constants = constants
        self._time, self._shutter = settings
        self._last: tuple[Spectrum, Shutter, float] | None = None

    def trigger(self) -> Done:
        """Take one spectrum with the present settings."""
        return self._line.do(self._expose)

    def read(self) -> Reading:
        """The spectrum of the last trigger; raises `InputError` before the first."""
        if self._last is None:
            raise InputError(f"{self.name}: there is no spectrum before the first trigger; trigger it and read then.")
        spectrum, shutter, moment = self._last
        values = {
            "counts": spectrum.counts,
            "total": int(spectrum.counts.sum(dtype="u8")),
            "integration_time": spectrum.integration_time,
            "detector_temperature": spectrum.detector_temperature,
            "shutter": shutter,
        }
        return {f"{self.name}_{name}": {"value": value, "timestamp": moment} for name, value in values.items()}

    def describe(self) -> Reading:
        """The spectrum, the sum of its counts, and how it was taken."""
        pixels = self._constants.wavelengths.size
        counts = self._number("counts") | {"dtype": "array", "shape": [pixels], "dtype_numpy": "<u4", "dims": ["pixel"]}
        keys = {
            "counts": counts,
            "total": self._number("counts") | {"dtype": "integer"},
            "integration_time": self._number("s"),
            "detector_temperature": self._number("degC"),
            "shutter": {"source": self._source, "dtype": "string", "shape": []},
        }
        return {f"{self.name}_{name}": key for name, key in keys.items()}

    def read_configuration(self) -> Reading:
        """What calibration needs to know about the device."""
        values = {
            "wavelengths": self._constants.wavelengths,
            "nonlinearity": self._constants.nonlinearity,
            "saturation": self._constants.saturation,
        }
        return {f"{self.name}_{name}": {"value": value, "timestamp": time.time()} for name, value in values.items()}

    def describe_configuration(self) -> Reading:
        """Wavelengths of the pixels, coefficients of the polynomial by which counts are divided, largest counts."""
        wavelengths, coefficients = self._constants.wavelengths, self._constants.nonlinearity
        array = {"dtype": "array", "dtype_numpy": "<f8"}
        keys = {
            "wavelengths": self._number("nm") | array | {"shape": list(wavelengths.shape), "dims": ["pixel"]},
            "nonlinearity": self._number("1") | array | {"shape": list(coefficients.shape), "dims": ["power"]},
            "saturation": self._number("counts") | {"dtype": "integer"},
        }
        return {f"{self.name}_{name}": key for name, key in keys.items()}

    @property
    def hints(self) -> dict[str, Any]:
        """The sum of the counts is worth a plot."""
        return {"fields": [f"{self.name}_total"]}

    async def _expose(self) -> None:
        seconds, shutter = self._time.value, self._shutter.value
        instrument = self._line.instrument
        take = instrument.dark if shutter == "closed" else instrument.expose
        self._last = await take(seconds), shutter, time.time()


@dataclass(frozen=True)
class BlueskyBench:
    """The devices of an open bench."""

    direction: Direction
    sample_stage: Stage
    detector_stage: Stage
    shutter: Setting
    integration_time: Setting
    spectrometer: Spectrometer


@contextmanager
def bluesky_bench(
    settings: InstrumentSettings | None = None, *, sample: str = "sample-1", seed: int = 0
) -> Iterator[BlueskyBench]:
    """Open the configured bench, or the simulated one with a `sample` on it, and close it in the end.

    The bench lives on an event loop in a thread of its own, whatever loop the RunEngine has. Raises what
    `api.service.open_instrument` raises.
    """
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="goniometer", daemon=True)
    thread.start()

    def wait(coroutine: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result()

    opened = open_instrument(settings, seed)
    try:
        instrument, laboratory = wait(opened.__aenter__())
        try:
            if laboratory is not None:
                laboratory.mount(sample)
            yield _devices(_Line(loop, instrument), wait(instrument.constants()))
        finally:
            wait(opened.__aexit__(None, None, None))
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def _devices(line: _Line, constants: Constants) -> BlueskyBench:
    shortest, longest = line.instrument.integration_limits

    def seconds(value: object) -> float:
        if isinstance(value, int | float) and shortest <= value <= longest:
            return float(value)
        raise InputError(f"{value!r} is no integration time; it lies between {shortest:g} and {longest:g} s.")

    def shutter(value: object) -> object:
        if value in ("open", "closed"):
            return value
        raise InputError(f'{value!r} is no state of the shutter; it is "open" or "closed".')

    time_, light = (
        Setting("integration_time", line, min(max(0.1, shortest), longest), seconds, "s"),
        Setting("shutter", line, "open", shutter, ""),
    )
    stages = " and ".join(constants.stages.values())
    sample, detector = constants.stages.values()
    return BlueskyBench(
        Direction("direction", line, stages),
        Stage("sample_stage", line, sample, 0),
        Stage("detector_stage", line, detector, 1),
        light,
        time_,
        Spectrometer("spectrometer", line, constants, (time_, light)),
    )


def _geometry(value: Sequence[float]) -> Geometry:
    try:
        theta_in, theta_out = map(float, value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{value!r} is no direction; it is (theta_in, theta_out) in degrees.") from error
    return Geometry(theta_in, theta_out)
