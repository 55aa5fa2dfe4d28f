"""What is wrong with a bench, device by device, found by reading and by gentle exercise.

It knows the device interfaces only. A stage that knows its reference is turned by a degree and back; the
spectrometer reads two dark spectra; lamp and shutter are switched. Nothing is stored, and nothing is left moving.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.interfaces import Light, RotationStage, Spectrometer, Spectrum, StagePhase
from drivers.travel import travel_time
from goniometer.bench.safety import Forbidden, safe_path
from goniometer.errors import GeometryError

EXERCISE = 1.0
"""Degrees by which a stage is turned."""
READ_BACK = 0.05
"""Degrees by which a stage may read back another angle than it was sent to."""
DELAY = 1.0
"""Seconds that a motion may take beyond one and a half times what velocity and acceleration tell: replies take time."""
WAVELENGTHS = 150.0, 1200.0
"""Nanometres between which every pixel of a spectrometer for this bench must lie."""
NONLINEARITY = 0.2
"""How far the correction may be from 1 anywhere below saturation."""
LIGHT_TIME = 0.1
"""Seconds of the two exposures that tell open from closed shutter."""
CERTAIN = 5.0
"""Standard errors beyond which open and closed shutter differ."""


@dataclass(frozen=True)
class Figure:
    """Something that was read."""

    name: str
    value: float
    unit: str
    """Empty for a number without unit."""

    def __str__(self) -> str:
        space = "" if self.unit in {"", "°"} else " "
        return f"{self.name} {self.value:.4g}{space}{self.unit}"


@dataclass(frozen=True)
class Finding:
    """What was found about one device."""

    device: str
    identity: str = ""
    """What it calls itself; empty where it did not get as far."""
    figures: tuple[Figure, ...] = ()
    remarks: tuple[str, ...] = ()
    """What could not be examined, and why; no fault."""
    problems: tuple[str, ...] = ()
    """What is wrong and what to do; empty for a device that is fine."""

    def line(self) -> str:
        """The finding in one line."""
        if self.problems:
            told = "; ".join(problem.removeprefix(f"{self.device}: ") for problem in self.problems)
            return f"{self.device}: {told}"
        facts = [self.identity, ", ".join(str(figure) for figure in self.figures), *self.remarks]
        return f"{self.device}: fine: " + "; ".join(fact for fact in facts if fact)


@dataclass(frozen=True)
class Bench:
    """The devices of a bench, and what is expected of them."""

    sample_stage: RotationStage
    detector_stage: RotationStage
    spectrometer: Spectrometer
    light: Light
    clock: Clock
    set_point: float
    """Of the spectrometer's cooler, degrees Celsius."""
    tolerance: float
    """By which the detector may be warmer or colder, degrees Celsius."""
    forbidden: tuple[Forbidden, ...] = ()
    """Where the stages must not go."""


@dataclass
class _Notes:
    """A finding while it is being made."""

    device: str
    identity: str = ""
    figures: list[Figure] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def read(self, name: str, value: float, unit: str = "") -> None:
        """Note a figure."""
        self.figures.append(Figure(name, float(value), unit))


async def visit(
    bench: Bench,
    *,
    home: bool = False,
    absent: Mapping[str, DriverError] | None = None,
    tell: Callable[[float, str], None] = lambda *_: None,
) -> list[Finding]:
    """Open all devices at once, `examine` those that answer, make the bench safe and close them all.

    Those that are `absent`, by name, are not tried; why they are is their finding. `tell` is told which part is done,
    0 to 1, and what is done next.
    """
    absent = dict(absent or {})
    devices = (bench.sample_stage, bench.detector_stage, bench.spectrometer)
    tried = 0

    async def connect(device: RotationStage | Spectrometer) -> None:
        try:
            if device.name not in absent:
                await device.open()
        except DriverError as error:
            absent[device.name] = error
        nonlocal tried
        tried += 1
        tell(tried / 6, f"Opened {tried} of 3 devices" if tried < 3 else "Examining all devices")

    tell(0.0, "Opening all devices")
    try:
        async with asyncio.TaskGroup() as group:
            for device in devices:
                group.create_task(connect(device))
        return await examine(bench, home=home, referenced=home, absent=absent)
    finally:
        await release(bench)


async def release(bench: Bench) -> None:
    """Stop both stages, close the shutter and disconnect, whatever of it is open.

    A device that fails meanwhile is no obstacle to the others, and nothing is said about it: it was what failed before.
    """
    stages = (bench.sample_stage, bench.detector_stage)
    await _quietly(*(stage.stop() for stage in stages))
    await _quietly(bench.light.set_shutter(False))
    await _quietly(*(device.close() for device in (*stages, bench.spectrometer)))


async def _quietly(*actions: Awaitable[None]) -> None:
    """Do all at once; what devices raise is dropped."""
    for result in await asyncio.gather(*actions, return_exceptions=True):
        if isinstance(result, BaseException) and not isinstance(result, DriverError):
            raise result


async def examine(
    bench: Bench, *, home: bool = False, referenced: bool = False, absent: Mapping[str, DriverError] | None = None
) -> list[Finding]:
    """Examine the open devices of `bench`: sample stage, detector stage, spectrometer, light.

    Stages that do not know their reference are left where they are unless `home`, which also clears faults of stages;
    where they should be `referenced`, not to be is a fault. `absent` tells, by name, why a device is not open; that is
    then all that is found about it. Leaves stages where they were, the shutter closed and the lamp on. What a device
    raises is its finding.
    """
    stages = (bench.sample_stage, bench.detector_stage)
    absent = dict(absent or {})
    if home:
        for stage in reversed(stages):  # the arm first, as whenever it is not known where the stages stand
            if stage.name not in absent:
                await _home(stage, absent)
    findings = []
    for stage, other in (stages, stages[::-1]):
        beside = None if other.name in absent else other
        findings.append(await _find(stage.name, absent, partial(_stage, bench, stage, beside, referenced)))
    spectrometer = bench.spectrometer
    findings.append(await _find(spectrometer.name, absent, partial(_spectrometer, bench)))
    if spectrometer.name in absent:
        findings.append(Finding("light", problems=("was not examined, as the spectrometer is not open",)))
    else:
        findings.append(await _find("light", absent, partial(_light, bench)))
    return findings


async def _find(
    name: str, absent: Mapping[str, DriverError], examination: Callable[[_Notes], Awaitable[None]]
) -> Finding:
    """What `examination` notes, an error that ends it included."""
    notes = _Notes(name)
    try:
        if name in absent:
            raise absent[name]
        await examination(notes)
    except DriverError as error:
        notes.problems.append(str(error))
    return Finding(name, notes.identity, tuple(notes.figures), tuple(notes.remarks), tuple(notes.problems))


async def _home(stage: RotationStage, failed: dict[str, DriverError]) -> None:
    """Home `stage` where it needs it; why that failed is written down in `failed`."""
    try:
        if (await stage.state()).phase in {StagePhase.NOT_REFERENCED, StagePhase.FAULT, StagePhase.DISABLED}:
            await _or_stop(stage, stage.home())
    except DriverError as error:
        failed[stage.name] = error


async def _stage(
    bench: Bench, stage: RotationStage, other: RotationStage | None, referenced: bool, notes: _Notes
) -> None:
    notes.identity = await stage.identity()
    state = await stage.state()
    if state.phase is StagePhase.NOT_REFERENCED and referenced:
        notes.problems.append("has forgotten its reference since it was homed; check its power supply, then home it")
    elif state.phase is StagePhase.NOT_REFERENCED:
        notes.remarks.append("not referenced, so it was not moved (--home searches for its mark)")
    elif state.phase is StagePhase.FAULT:
        notes.problems.append(f"reports a fault: {state.message}; clear its cause, then try again with --home")
    elif state.phase is not StagePhase.READY:
        notes.problems.append(f"is {state.phase.value}, not ready; wait, or switch its motor on with --home")
    else:
        notes.read("position", state.position, "°")
        target = await _target(bench, stage, other, state.position, notes)
        if target is not None:
            await _or_stop(stage, _exercise(stage, state.position, target, bench.clock, notes))


async def _or_stop(stage: RotationStage, motion: Awaitable[None]) -> None:
    """Wait for `motion`; where it fails the stage is stopped before anything else is examined."""
    try:
        await motion
    except DriverError:
        with suppress(DriverError):
            await stage.stop()
        raise


async def _target(
    bench: Bench, stage: RotationStage, other: RotationStage | None, start: float, notes: _Notes
) -> float | None:
    """An angle near `start` to which the stage may turn, degrees; where there is none the reason is noted."""
    low, high = stage.limits
    near = min(max(start, low), high)
    if abs(near - start) > READ_BACK:
        notes.remarks.append(f"stands outside its limits of {low:g}° to {high:g}°, so it was not moved")
        return None
    targets = [angle for angle in (near + EXERCISE, near - EXERCISE) if low <= angle <= high]
    if bench.forbidden:
        beside = None if other is None else await _standing(other)
        if beside is None:
            notes.remarks.append("not moved, as it is not known where the other stage stands and regions are forbidden")
            return None
        targets = [angle for angle in targets if _is_free(bench, stage, (near, angle), beside)]
    if not targets:
        notes.remarks.append(f"not moved, as there is no room for {EXERCISE:g}° where it stands")
        return None
    return targets[0]


async def _standing(stage: RotationStage) -> float | None:
    """The angle at which `stage` rests, degrees; None where it does not know. Its faults are found in its own turn."""
    with suppress(DriverError):
        state = await stage.state()
        if state.phase is StagePhase.READY:
            return state.position
    return None


def _is_free(bench: Bench, stage: RotationStage, way: tuple[float, float], beside: float) -> bool:
    """Whether `stage` may turn from one angle to another while the other one stands at `beside`; all degrees."""
    start, end = ((angle, beside) if stage is bench.sample_stage else (beside, angle) for angle in way)
    try:
        safe_path(start, end, bench.forbidden)
    except GeometryError:
        return False
    return True


async def _exercise(stage: RotationStage, start: float, target: float, clock: Clock, notes: _Notes) -> None:
    """Turn to `target` and back, and judge what is read back and how long the quicker way took."""
    low, high = stage.limits
    errors, durations = [], []
    for angle in (target, min(max(start, low), high)):
        began = clock.now()
        errors.append(abs(await stage.move_to(angle) - angle))
        durations.append(clock.now() - began)
    expected = travel_time(EXERCISE, stage.velocity, stage.acceleration)
    notes.read(f"time to turn {EXERCISE:g}°", min(durations), "s")
    notes.read("read-back error", max(errors), "°")
    if max(errors) > READ_BACK:
        notes.problems.append(
            f"reads back {max(errors):.3f}° beside where it was sent; it should be at most {READ_BACK:g}°: check its "
            "coupling and what it carries"
        )
    # the quicker one, as a reply that was lost once makes no stage slow
    if min(durations) > 1.5 * expected + DELAY:
        notes.problems.append(
            f"takes {min(durations):.2f} s for {EXERCISE:g}°, which should take {expected:.2f} s at "
            f"{stage.velocity:g}°/s; look for friction or a wrong velocity or scale"
        )


async def _spectrometer(bench: Bench, notes: _Notes) -> None:
    device = bench.spectrometer
    notes.identity = await device.identity()
    wavelengths = await device.wavelengths()
    notes.problems += _wrong_wavelengths(wavelengths)
    notes.read("first wavelength", wavelengths[0], "nm")
    notes.read("last wavelength", wavelengths[-1], "nm")
    coefficients = await device.nonlinearity()
    notes.problems += _wrong_nonlinearity(coefficients, device.saturation)
    if np.array_equal(coefficients, [1.0]):
        notes.remarks.append("its non-linearity was never characterised and is not corrected")
    with suppress(DriverError):  # a shutter that refuses is a finding about the light
        await bench.light.set_shutter(False)
    shortest = device.integration_limits[0]
    first, second = await device.expose(shortest), await device.expose(shortest)
    difference = second.counts.astype(float) - first.counts.astype(float)
    notes.read("dark offset", np.median(first.counts), "counts")
    notes.read("noise", np.std(difference) / np.sqrt(2), "counts")
    notes.read("detector temperature", second.detector_temperature, "°C")
    notes.problems += _wrong_darks(first, second, shortest, len(wavelengths), device.saturation)
    if not abs(second.detector_temperature - bench.set_point) <= bench.tolerance:
        notes.problems.append(
            f"its detector is at {second.detector_temperature:.1f} °C, not within {bench.tolerance:g} °C of "
            f"{bench.set_point:g} °C; wait until it is, or choose a warmer cooler_set_point"
        )


def _wrong_wavelengths(wavelengths: FloatArray) -> list[str]:
    """What is wrong with [pixels] wavelengths, nm."""
    low, high = WAVELENGTHS
    if np.all(np.diff(wavelengths) > 0) and low <= wavelengths[0] and wavelengths[-1] <= high:
        return []
    return [
        f"its wavelengths, {wavelengths[0]:g} nm to {wavelengths[-1]:g} nm, do not increase from pixel to pixel within "
        f"{low:g} nm to {high:g} nm; have its wavelength coefficients restored"
    ]


def _wrong_nonlinearity(coefficients: FloatArray, saturation: int) -> list[str]:
    """What is wrong with [coefficients] of the polynomial by which dark-subtracted counts are divided."""
    divisor = np.polynomial.polynomial.polyval(np.linspace(0, saturation, 101), coefficients)
    if np.all(np.abs(divisor - 1) <= NONLINEARITY):
        return []
    return [
        f"its non-linearity polynomial reaches {divisor[np.argmax(np.abs(divisor - 1))]:g} below saturation where it "
        f"must stay within {NONLINEARITY:g} of 1; have its non-linearity coefficients restored"
    ]


def _wrong_darks(first: Spectrum, second: Spectrum, asked: float, pixels: int, saturation: int) -> list[str]:
    """What is wrong with two dark spectra of `asked` seconds, taken one after the other."""
    wrong = []
    if first.count == second.count or np.array_equal(first.counts, second.counts):
        wrong.append("it delivers the same spectrum twice; switch it off and on")
    for spectrum in (first, second):
        if abs(spectrum.integration_time - asked) > 1e-6:
            wrong.append(
                f"it integrates {spectrum.integration_time:g} s where {asked:g} s were set; switch it off and on"
            )
        if len(spectrum.counts) != pixels:
            wrong.append(f"it delivers {len(spectrum.counts)} counts for {pixels} wavelengths; switch it off and on")
        if np.median(spectrum.counts) == 0:
            wrong.append("its dark spectrum is zero, without offset; check the detector's power and its offset setting")
        if spectrum.counts.max() >= saturation:
            wrong.append("its dark spectrum is saturated; look for light that enters beside the shutter")
    return list(dict.fromkeys(wrong))  # both spectra may have the same fault


async def _light(bench: Bench, notes: _Notes) -> None:
    """Lamp on, shutter open and closed. A burning lamp is not switched off: it would have to warm up again."""
    await bench.light.set_lamp(True)
    await bench.light.set_shutter(True)
    try:
        lit = await bench.spectrometer.expose(LIGHT_TIME)
    finally:
        await bench.light.set_shutter(False)
    dark = await bench.spectrometer.expose(LIGHT_TIME)
    difference = lit.counts.astype(float) - dark.counts.astype(float)
    signal, error = difference.mean(), difference.std() / np.sqrt(difference.size)
    if signal > CERTAIN * error:
        notes.read("light", signal, "counts")
    elif signal < -CERTAIN * error:
        notes.problems.append("it is brighter behind the closed shutter than behind the open one; swap its polarity")
    else:
        notes.remarks.append("lamp and shutter obey; whether light arrives shows only with something bright mounted")
