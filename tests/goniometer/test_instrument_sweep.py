"""The moving arm on the wire-level simulators: what a sweep leaves behind when something goes wrong in it."""

import asyncio

import pytest

from drivers.errors import DeviceFault, DriverError, ProtocolError
from goniometer.bench.safety import Forbidden
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry
from tests.goniometer.test_instrument import axes, each_family, laboratory, on_bench, until

__all__ = ["laboratory"]
SHORT = 30.0, -10.0, 10.0, 8.0, 0.2
"""theta_in, from, to, degrees/s, seconds."""


@each_family
def test_an_arm_of_any_family_sweeps_and_is_quick_again_afterwards(laboratory):
    async def work(instrument):
        before = instrument.arm.motion.detector.velocity
        passages, sample = await instrument.sweep(*SHORT)
        assert sample == pytest.approx(30, abs=0.02)
        assert passages[0].start == pytest.approx(20, abs=0.2)
        assert passages[-1].stop == pytest.approx(40, abs=0.2)
        # 1.6 degrees each, and what the ramps cost
        assert 12 <= len(passages) <= 16
        middle = passages[len(passages) // 2]
        assert middle.stop - middle.start == pytest.approx(1.6, abs=0.1)
        assert instrument.arm.motion.detector.velocity == before
        await instrument.arm.goto(Geometry(30.0, 0.0))
        assert axes(laboratory)[1].velocity == pytest.approx(before, rel=1e-4)

    laboratory.bench.mount("embossed")
    on_bench(laboratory, work)


@pytest.mark.parametrize(
    ("laboratory", "fault"), [("smc100", "jam"), ("smc100", "unplug"), ("owis", "unplug")], indirect=["laboratory"]
)
def test_the_arm_is_quick_again_after_a_fault_in_the_middle_of_a_sweep(laboratory, fault):
    async def work(instrument):
        before = instrument.arm.motion.detector.velocity
        arm = axes(laboratory)[1]
        sweep = asyncio.create_task(instrument.sweep(*SHORT))
        await until(lambda: arm.moving() and arm.velocity < 9 and 25 < arm.position() < 35)
        getattr(laboratory.detector_stage, fault)()
        with pytest.raises(DeviceFault if fault == "jam" else DriverError):
            await sweep
        if fault == "unplug":
            laboratory.detector_stage.start()
        laboratory.clock.strolls = False
        await instrument.recover()
        assert instrument.arm.motion.detector.velocity == before
        await instrument.arm.goto(Geometry(30.0, 0.0))
        assert arm.velocity == pytest.approx(before, rel=1e-4)
        assert len((await instrument.sweep(*SHORT))[0]) >= 12

    on_bench(laboratory, work)


def test_a_sweep_never_goes_through_a_forbidden_region(laboratory):
    async def work(instrument):
        before = [axis.position() for axis in axes(laboratory)]
        with pytest.raises(GeometryError, match="forbidden region"):
            await instrument.sweep(30.0, -60.0, 10.0, 8.0, 0.2)
        with pytest.raises(GeometryError, match="not possible"):
            await instrument.sweep(80.0, 0.0, 100.0, 8.0, 0.2)
        assert [axis.position() for axis in axes(laboratory)] == before

    on_bench(laboratory, work, forbidden=(Forbidden((20.0, 40.0), (-20.0, -10.0)),))


def test_a_sweep_with_a_wrong_spectrum_is_an_error_and_the_next_one_is_right(laboratory):
    async def work(instrument):
        arm = axes(laboratory)[1]
        sweep = asyncio.create_task(instrument.sweep(*SHORT))
        await until(lambda: arm.moving() and arm.velocity < 9 and 25 < arm.position() < 35)
        laboratory.spectrometer.faults.other_modes = 1
        with pytest.raises(ProtocolError, match="trigger mode"):
            await sweep
        assert len((await instrument.sweep(*SHORT))[0]) >= 12

    on_bench(laboratory, work)


def test_a_point_where_a_sweep_ends_is_not_exposed_while_the_arm_swings(laboratory):
    async def work(instrument):
        passages, _ = await instrument.sweep(*SHORT)
        rests = passages[-1].spectrum.began + passages[-1].spectrum.integration_time
        await instrument.arm.goto(Geometry(30.0, 10.0))
        assert (await instrument.expose(0.1)).began >= rests + 5.0

    on_bench(laboratory, work, settling=(0.0, 5.0))


def test_an_arm_that_is_held_up_is_noticed(laboratory):
    async def work(instrument):
        laboratory.detector_stage.slow(4.0)
        with pytest.raises(DriverError, match="no spectrum saw the way"):
            await instrument.sweep(*SHORT)

    laboratory.clock.strolls = False
    on_bench(laboratory, work)
