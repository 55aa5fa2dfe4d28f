"""The bench as one object, on the wire-level simulators: what it refuses to believe, and how fast it is safe."""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from drivers.errors import DeviceDisconnected, DeviceFault, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import RotationStage, StagePhase, StageState
from drivers.k10cr1 import K10CR1
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.qepro import COOLING_POLL, QEPro, QEProLight
from drivers.smc100 import SMC100
from goniometer.bench.instrument import Instrument
from goniometer.bench.safety import Forbidden
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry
from simulators.bench.laboratory import COUNTS_PER_DEGREE, simulated_laboratory
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import Fault, FaultScript, Kind
from tests.stage_bench import PATIENCE, give_time

TIMEOUT = 0.2
"""Real seconds that the driver of a stage waits for a reply that does not come, and simulated ones of a QE Pro."""
STEP = 0.01
"""Simulated seconds between two looks of a clock that does not jump."""
SLOWLY = 0.1
"""Real seconds that such a step takes where 100 ms are measured: a busy computer needs some of them itself."""
FOR_EVER = 10**6
"""More requests than any test makes."""


class StrollingClock(SimulatedClock):
    """Simulated time that passes in small steps, long waits only once it strolls, so that others act in between."""

    strolls = False
    pace = 0.0005
    """Real seconds that a step takes at least."""

    async def sleep(self, seconds):
        if not self.strolls and seconds >= COOLING_POLL:  # cooling takes minutes
            await super().sleep(seconds)
            return
        end = self.now() + seconds
        while self.now() < end:
            await asyncio.sleep(self.pace)
            self.advance_to(min(self.now() + STEP, end))


@pytest.fixture
def laboratory(monkeypatch, request):
    monkeypatch.setattr("simulators.bench.laboratory.SimulatedClock", StrollingClock)
    family = getattr(request, "param", "smc100")
    with simulated_laboratory(1, stages=(family, family)) as laboratory:
        laboratory.bench.mount("sample-1")
        yield laboratory


DRIVERS: dict[str, Callable[..., RotationStage]] = {
    "smc100": SMC100,
    "oriental-az": OrientalAZ,
    "owis": partial(OwisPS, axis=1, counts_per_degree=COUNTS_PER_DEGREE),
    "k10cr1": K10CR1,
}
each_family = pytest.mark.parametrize("laboratory", DRIVERS, indirect=True)


def make(laboratory, spectrometer=None, **options):
    """An instrument that is not open yet."""
    clock = laboratory.clock
    qepro = QEPro("QE Pro", clock, usb_backend=laboratory.usb_backend, timeout=TIMEOUT)
    driver = DRIVERS[laboratory.families[0]]
    return Instrument(
        driver("sample stage", laboratory.sample_stage_url, clock, limits=(-5.0, 90.0), timeout=PATIENCE),
        driver("detector stage", laboratory.detector_stage_url, clock, limits=(-90.0, 175.0), timeout=PATIENCE),
        spectrometer(qepro) if spectrometer else qepro,
        QEProLight(qepro),
        clock,
        data=laboratory.data,
        **options,
    )


def on_bench(laboratory, work, **options):
    """Run `work(instrument)` on an open bench."""

    async def run():
        instrument = make(laboratory, **options)
        try:
            await instrument.open()
            laboratory.clock.strolls = True
            await work(instrument)
        finally:
            await instrument.close()

    asyncio.run(run())


async def until(condition):
    """Return when `condition` holds; fail when it never does."""
    async with asyncio.timeout(120):
        while not condition():  # noqa: ASYNC110 - what happens in simulators wakes nobody here
            await asyncio.sleep(0.0005)


def axes(laboratory):
    """What turns behind the wire."""
    return laboratory.bench._axes


@pytest.mark.parametrize("integration_time", [0.1, 5.0])  # some pixels are saturated, or all
def test_light_behind_a_shutter_that_does_not_close_is_never_a_dark_signal(laboratory, integration_time):
    async def work(instrument):
        laboratory.bench.mount("mirror")
        await instrument.arm.goto(Geometry(30.0, 30.0))
        assert (await instrument.dark(integration_time)).counts.max() < 5000
        lit = (await instrument.expose(integration_time)).counts
        assert (lit == instrument.saturation).any()
        laboratory.spectrometer.faults.ignored.add(0x00110610)  # it says yes, and the shutter stays open
        with pytest.raises(DeviceFault, match="sees light behind the closed shutter"):
            await instrument.dark(integration_time)

    on_bench(laboratory, work)


# Moves


def test_the_arm_goes_around_a_forbidden_region_on_its_way(laboratory):
    holder = Forbidden(sample=(20.0, 45.0), detector=(-30.0, 70.0))
    seen = []

    async def watch():
        while True:
            seen.append(tuple(axis.position() for axis in axes(laboratory)))
            await asyncio.sleep(0.0005)

    async def work(instrument):
        watching = asyncio.create_task(watch())
        for geometry in (Geometry(60.0, 30.0), Geometry(10.0, 40.0), Geometry(60.0, 20.0)):
            read = await instrument.arm.goto(geometry)
            assert read.theta_in == pytest.approx(geometry.theta_in, abs=0.01)
            assert read.theta_out == pytest.approx(geometry.theta_out, abs=0.01)
        watching.cancel()
        with pytest.raises(GeometryError, match="forbidden region"):
            await instrument.arm.goto(Geometry(30.0, 10.0))

    on_bench(laboratory, work, forbidden=(holder,))
    assert len(seen) > 100
    assert not any(20.0 < sample < 45.0 and -30.0 < detector < 70.0 for sample, detector in seen)
    assert any(sample > 45 for sample, _ in seen)


def test_only_for_stray_light_the_detector_stands_before_the_source(laboratory):
    async def work(instrument):
        await instrument.arm.goto(Geometry(60.0, 30.0))
        with pytest.raises(GeometryError, match="in the beam"):
            await instrument.arm.goto(Geometry(30.0, -30.0))
        read = await instrument.arm.face_source(30.0)
        assert (read.theta_in, read.detector_angle) == pytest.approx((30.0, 0.0), abs=0.01)
        assert axes(laboratory)[1].position() == pytest.approx(0.0, abs=0.01)
        instrument.arm.forbidden = (Forbidden(sample=(55.0, 90.0), detector=(-3.0, 3.0)),)
        with pytest.raises(GeometryError, match="forbidden region"):
            await instrument.arm.face_source(60.0)
        with pytest.raises(GeometryError, match="outside -5 to 90"):
            await instrument.arm.face_source(95.0)

    on_bench(laboratory, work)


def test_a_bench_whose_marks_lie_where_the_arm_must_not_be_is_not_opened(laboratory):
    async def work(_):
        pytest.fail("it was opened")

    with pytest.raises(GeometryError, match="forbidden region"):
        on_bench(laboratory, work, forbidden=(Forbidden(sample=(-5.0, 5.0), detector=(-5.0, 5.0)),))


@pytest.mark.parametrize("is_in_the_way", [True, False])
def test_a_stage_that_lost_its_reference_is_not_homed_through_a_forbidden_region(laboratory, is_in_the_way):
    """The detector stage lost it on its way from 30 to 100 deg, so it may stand anywhere between."""
    low = 5.0 if is_in_the_way else -40.0
    holder = Forbidden(sample=(40.0, 80.0), detector=(low, low + 20.0))

    async def work(instrument):
        sample, detector = axes(laboratory)
        await instrument.arm.goto(Geometry(60.0, -30.0))
        moving = asyncio.create_task(instrument.arm.goto(Geometry(60.0, 40.0)))
        await until(lambda: detector.position() > 50.0)
        laboratory.detector_stage.restart()
        with pytest.raises(DriverError):
            await moving
        await instrument.safe()
        stood = detector.position()
        if is_in_the_way:
            with pytest.raises(GeometryError, match="sample stage 60, detector stage 0 and 60, 100 deg"):
                await instrument.recover()
            assert detector.position() == stood > 50.0
        else:
            await instrument.recover()
            assert detector.position() == 0.0
            assert sample.position() == 60.0

    on_bench(laboratory, work, forbidden=(holder,))


@pytest.mark.parametrize("same_angle", [True, False])
def test_a_stage_that_was_switched_off_and_on_between_two_points_is_not_taken_for_one_that_stayed(
    laboratory, same_angle
):
    async def work(instrument):
        await instrument.arm.goto(Geometry(30.0, 10.0))
        laboratory.sample_stage.restart()
        with pytest.raises(DeviceFault, match="sample stage: is not referenced"):
            await instrument.arm.goto(Geometry(30.0 if same_angle else 40.0, 20.0))
        await instrument.recover()
        read = await instrument.arm.goto(Geometry(30.0, 20.0))
        assert read.theta_in == pytest.approx(30.0, abs=0.01)

    on_bench(laboratory, work)


def test_a_stage_that_was_turned_by_hand_between_two_points_is_homed_before_anything_is_measured(laboratory):
    async def work(instrument):
        await instrument.arm.goto(Geometry(30.0, 10.0))
        axis = axes(laboratory)[0]
        axis.move(33.0)
        await laboratory.clock.sleep(5.0)
        assert axis.position() == 33.0
        # a stage without encoder that has lost steps looks the same, and must not be moved back by its own reading
        with pytest.raises(DeviceFault, match=r"sample stage: reads 33\.000° where it was left at 30\.000°; home it"):
            await instrument.arm.goto(Geometry(30.0, 20.0))
        await instrument.recover()
        assert axis.position() == 0.0
        read = await instrument.arm.goto(Geometry(30.0, 20.0))
        assert read.theta_in == pytest.approx(30.0, abs=0.01)

    on_bench(laboratory, work)


class Wrong:
    """A stage in memory that is ready and reads back what it likes."""

    name = "stage"
    limits = (-90.0, 175.0)

    def __init__(self, *readings):
        self.readings = list(readings)

    async def state(self):
        return StageState(StagePhase.READY, self.readings.pop(0))

    async def begin_move(self, _):
        return 0.0

    async def arrive(self, _, __):
        return self.readings.pop(0)

    async def position(self):
        return self.readings.pop(0)


@pytest.mark.parametrize("reading", [30.2, 29.8, 0.0, float("nan")])
def test_a_read_back_that_is_not_where_the_stage_was_sent_is_never_stored(reading):
    instrument = Instrument(Wrong(0.0, reading), Wrong(0.0, 40.0), None, None, SimulatedClock())
    with pytest.raises(DeviceFault, match=r"where it was sent to 30\.000"):
        asyncio.run(instrument.arm.goto(Geometry(30.0, 10.0)))


def test_a_stage_that_reads_two_angles_at_rest_is_not_believed():
    instrument = Instrument(Wrong(0.0, 30.0, 30.0, 30.05), Wrong(0.0, 40.0, 40.0, 50.0), None, None, SimulatedClock())

    async def work():
        await instrument.arm.goto(Geometry(30.0, 10.0))
        with pytest.raises(ProtocolError, match=r"reads 30\.000° and then 30\.050° at rest"):
            await instrument.arm.goto(Geometry(30.0, 20.0))

    asyncio.run(work())


# Spectra


class Liar:
    """A spectrometer whose spectra are changed on the way."""

    def __init__(self, honest, change):
        self.honest = honest
        self.change = change
        self.first = None

    def __getattr__(self, name):
        return getattr(self.honest, name)

    async def expose(self, integration_time):
        spectrum = await self.honest.expose(integration_time)
        self.first, first = self.first or spectrum, self.first
        return spectrum if first is None else self.change(spectrum, first)

    async def sequence(self, integration_time, scans):
        return [await self.expose(integration_time) for _ in range(scans)]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda s, _: replace(s, integration_time=0.2), ProtocolError, "0.2 s where 0.1 s were asked"),
        (lambda s, _: replace(s, counts=s.counts[:1000]), ProtocolError, "1044 pixels were expected"),
        (lambda s, first: replace(s, count=first.count), ProtocolError, "twice"),
        (lambda s, _: replace(s, detector_temperature=-7.0), DeviceFault, "at -7.0 °C, and was at -10"),
        (lambda s, _: replace(s, detector_temperature=float("nan")), DeviceFault, "cooler"),
    ],
)
def test_a_spectrum_that_cannot_be_the_one_that_was_asked_for_is_never_handed_on(laboratory, change, error, words):
    async def work(instrument):
        assert (await instrument.expose(0.1)).counts.shape == (1044,)
        with pytest.raises(error, match=words):
            await instrument.expose(0.1)
        with pytest.raises(error, match=words):
            await instrument.dark(0.1)

    on_bench(laboratory, work, spectrometer=lambda honest: Liar(honest, change))


# The safe state


async def moving(instrument):
    await instrument.arm.goto(Geometry(80.0, 80.0))


async def homing(instrument):
    stages = instrument.arm.stages
    await asyncio.gather(*(stage.move_to(40.0) for stage in stages))
    for stage in stages:
        await stage._begin_homing()
    instrument.homes = True
    await instrument.clock.sleep(60.0)


async def exposing(instrument):
    await instrument.expose(20.0)


async def paused(instrument):
    await instrument.clock.sleep(1000.0)


def started(laboratory, instrument, work):
    """Whether what a test interrupts is under way."""
    if work is moving:
        return all(axis.moving() for axis in axes(laboratory))
    if work is homing:
        return hasattr(instrument, "homes")
    return work is paused or laboratory.spectrometer.shutter_open


@each_family
@pytest.mark.parametrize("cancelled", [True, False])
@pytest.mark.parametrize("work", [moving, homing, exposing, paused])
def test_from_every_state_the_stages_are_told_to_stop_within_100_ms_and_the_shutter_is_closed(
    laboratory, work, cancelled
):
    clock = laboratory.clock

    async def interrupt(instrument):
        task = asyncio.create_task(work(instrument))
        await until(lambda: started(laboratory, instrument, work))
        await asyncio.sleep(0.01)
        clock.pace = SLOWLY
        told = [note_stop(axis, clock) for axis in axes(laboratory)]
        closed = asyncio.create_task(note_closing(laboratory))
        hurrying = asyncio.create_task(hurry_on(laboratory, told)) if work in {moving, homing} else None
        begun = clock.now()
        if cancelled:
            task.cancel()
        await instrument.safe()
        for stops in told:
            # a controller need not pass on to a motor at rest that it must stop
            assert stops or work not in {moving, homing}
            assert all(stop - begun <= 0.1 for stop in stops[:1])
        assert await closed - begun <= 0.1
        assert not any(axis.moving() for axis in axes(laboratory))
        assert not laboratory.spectrometer.shutter_open
        assert laboratory.spectrometer.lamp_on
        if hurrying is not None:
            await hurrying
        clock.pace = StrollingClock.pace
        task.cancel()
        with contextlib.suppress(DriverError, asyncio.CancelledError):
            await task
        positions = [axis.position() for axis in axes(laboratory)]
        await clock.sleep(1.0)
        assert [axis.position() for axis in axes(laboratory)] == positions

    on_bench(laboratory, interrupt)


def note_stop(axis, clock):
    """A list into which is written when the axis is told to stop."""
    stop, told = axis.stop, []

    def noted():
        told.append(clock.now())
        stop()

    axis.stop = noted
    return told


async def hurry_on(laboratory, told):
    """Go on at the usual pace once all are told to stop and the shutter is closed: nothing is measured any more."""
    await until(lambda: all(told) and not laboratory.spectrometer.shutter_open)
    laboratory.clock.pace = StrollingClock.pace


async def note_closing(laboratory):
    """When the shutter is closed."""
    await until(lambda: not laboratory.spectrometer.shutter_open)
    return laboratory.clock.now()


@each_family
def test_stages_whose_replies_never_come_are_stopped_within_100_ms_while_their_drivers_wait(laboratory):
    clock = laboratory.clock

    async def ticking():
        while True:
            await asyncio.sleep(SLOWLY)
            clock.advance_to(clock.now() + STEP)

    async def interrupt(instrument):
        move = asyncio.create_task(instrument.arm.goto(Geometry(80.0, 80.0)))
        await until(lambda: all(axis.moving() for axis in axes(laboratory)))
        for stage in (laboratory.sample_stage, laboratory.detector_stage):
            stage.script = FaultScript([Fault(Kind.LOSE_REPLY, at=1, times=FOR_EVER)])
        give_time(TIMEOUT, *instrument.arm.stages)
        await until(lambda: laboratory.sample_stage.script.happened and laboratory.detector_stage.script.happened)
        time_passes = asyncio.create_task(ticking())
        told = [note_stop(axis, clock) for axis in axes(laboratory)]
        begun = clock.now()
        move.cancel()
        with pytest.raises(DeviceTimeout):
            await instrument.safe()
        assert all(stops[0] - begun <= 0.1 for stops in told)
        assert not laboratory.spectrometer.shutter_open
        await clock.sleep(1.0)
        assert not any(axis.moving() for axis in axes(laboratory))
        time_passes.cancel()
        for stage in (laboratory.sample_stage, laboratory.detector_stage):
            stage.script = FaultScript()
        give_time(PATIENCE, *instrument.arm.stages)
        await instrument.recover()
        await instrument.arm.goto(Geometry(20.0, 20.0))

    on_bench(laboratory, interrupt)


def test_each_device_is_made_safe_also_when_the_others_are_gone(laboratory):
    async def work(instrument):
        await instrument.expose(0.01)
        laboratory.sample_stage.unplug()
        laboratory.detector_stage.unplug()
        with pytest.raises(DriverError):
            await instrument.safe()
        assert not laboratory.spectrometer.shutter_open

    on_bench(laboratory, work)


def test_a_motion_that_reaches_a_stage_after_the_stop_is_stopped_as_well(laboratory):
    async def work(instrument):
        axis = axes(laboratory)[0]
        stop = axis.stop

        def stop_and_go_on():
            axis.stop = stop
            stop()
            axis.move(80.0)

        axis.stop = stop_and_go_on
        await instrument.safe()
        assert not axis.moving()
        assert axis.position() < 5.0

    on_bench(laboratory, work)


def test_a_stage_that_cannot_be_stopped_is_told_and_not_waited_for_for_ever(laboratory):
    async def work(instrument):
        moving_on = asyncio.create_task(instrument.arm.goto(Geometry(80.0, 80.0)))
        axis = axes(laboratory)[0]
        await until(axis.moving)
        axis.stop = lambda: None
        axis.moving = lambda: True
        moving_on.cancel()
        laboratory.clock.pace = 0.0
        with pytest.raises(DeviceTimeout, match="sample stage: is still moving 5 s after it was stopped"):
            await instrument.safe()

    on_bench(laboratory, work)


def test_closing_lets_go_of_every_device_also_when_one_of_them_fails(laboratory):
    async def work():
        instrument = make(laboratory)
        await instrument.open()
        close = instrument.arm.stages[0].close

        async def failing():
            await close()
            raise DeviceDisconnected("sample stage: gone.")

        instrument.arm.stages[0].close = failing
        with pytest.raises(DeviceDisconnected):
            await instrument.close()
        again = make(laboratory)
        await again.open()
        assert np.isfinite((await again.expose(0.01)).detector_temperature)
        await again.close()

    asyncio.run(work())
