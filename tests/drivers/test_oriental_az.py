"""The AZ driver moves a stage over Modbus and survives what networks and stages do."""

import asyncio
import socket
from collections.abc import Awaitable, Callable, Iterator

import pytest

from drivers.errors import DeviceDisconnected, DeviceFault, DeviceNotFound, DeviceRefused, DeviceTimeout
from drivers.interfaces import RotationStage, StagePhase
from drivers.oriental_az import OrientalAZ
from simulators.clock import SimulatedClock
from simulators.motion import Axis
from simulators.oriental_az import SimulatedOrientalAZ


class Bench:
    """A simulated stage, and the driver connected to it."""

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.axis = Axis(self.clock, start=-12.0, velocity=1, acceleration=1, limits=(-95, 180))
        self.simulator = SimulatedOrientalAZ(self.axis)
        self.host, self.port = self.simulator.start()
        self.stage = OrientalAZ("detector stage", self.host, self.port, self.clock, timeout=0.3)

    def run(self, scenario: Callable[[OrientalAZ], Awaitable[None]]) -> None:
        async def whole() -> None:
            await self.stage.open()
            await scenario(self.stage)
            await self.stage.close()

        asyncio.run(whole())


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.simulator.close()


def test_it_is_a_rotation_stage(bench: Bench) -> None:
    stage: RotationStage = bench.stage
    assert stage.limits == (-90.0, 175.0)


def test_moves_end_where_they_should_on_both_sides_of_zero_and_take_their_time(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        assert (await stage.state()).phase is StagePhase.READY
        assert await stage.position() == pytest.approx(-12.0)
        begin = bench.clock.now()
        assert await stage.move_to(-72.0) == pytest.approx(-72.0)
        # 60 degrees at 30 degrees/s with ramps at 60 degrees/s^2
        assert bench.clock.now() - begin == pytest.approx(60 / 30 + 30 / 60, abs=0.1)
        assert await stage.move_to(170.0) == pytest.approx(170.0)
        assert bench.axis.position() == pytest.approx(170.0)
        assert "Oriental Motor" in await stage.identity()

    bench.run(scenario)


def test_homing_ends_at_zero(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        await stage.home()
        assert await stage.position() == 0.0

    bench.run(scenario)


def test_nothing_is_sent_for_an_angle_outside_the_limits(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.simulator.silent = True  # a single byte sent would now end in a timeout
        with pytest.raises(DeviceRefused, match=r"detector stage.*-90° to 175°"):
            await stage.move_to(175.1)

    bench.run(scenario)


def test_an_absent_device_is_named_with_its_address(bench: Bench) -> None:
    bench.simulator.close()
    with pytest.raises(DeviceNotFound, match=rf"detector stage.*{bench.host}:{bench.port}"):
        asyncio.run(bench.stage.open())


def test_a_host_that_does_not_exist_is_not_found(bench: Bench) -> None:
    stage = OrientalAZ("detector stage", "no-such-host.invalid", 502, bench.clock, timeout=0.3)
    with pytest.raises(DeviceNotFound, match=r"no-such-host\.invalid:502"):
        asyncio.run(stage.open())


def test_something_that_speaks_no_modbus_is_not_found(bench: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        stage = OrientalAZ("detector stage", *server.getsockname(), bench.clock, timeout=0.1)
        with pytest.raises(DeviceNotFound, match="no AZ driver"):
            asyncio.run(stage.open())


def test_a_wrong_unit_is_not_found(bench: Bench) -> None:
    stage = OrientalAZ("detector stage", bench.host, bench.port, bench.clock, unit=9, timeout=0.3)
    with pytest.raises(DeviceNotFound, match=r"unit 9.*check the address and the unit"):
        asyncio.run(stage.open())


def test_unplugging_is_noticed_and_the_stage_works_again_after_reopening(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.simulator.unplug()
        with pytest.raises(DeviceDisconnected, match="reopen"):
            await stage.position()
        await stage.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await stage.position()
        bench.simulator.start()
        await stage.open()
        assert await stage.move_to(5.0) == pytest.approx(5.0)

    bench.run(scenario)


def test_a_silent_device_is_a_timeout_and_answers_again_later(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.simulator.silent = True
        with pytest.raises(DeviceTimeout, match="no answer"):
            await stage.position()
        bench.simulator.silent = False
        assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario)


def test_a_trigger_whose_reply_is_lost_moves_the_stage_once(bench: Bench) -> None:
    targets: list[float] = []
    move = bench.axis.move

    def counting_move(target: float) -> None:
        targets.append(target)
        move(target)

    bench.axis.move = counting_move  # type: ignore[method-assign]
    bench.simulator.lost_replies_to_motions = 1

    async def scenario(stage: OrientalAZ) -> None:
        assert await stage.move_to(20.0) == pytest.approx(20.0)

    bench.run(scenario)
    assert targets == [20.0]


def test_an_alarm_is_told_in_words_and_homing_resets_it(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.simulator.fail(0x30)
        assert (await stage.state()).message == "alarm 30: overload"
        with pytest.raises(DeviceFault, match="overload"):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == pytest.approx(10.0)

    bench.run(scenario)


def test_an_alarm_in_the_middle_of_a_move_ends_it(bench: Bench) -> None:
    bench.stage.limits = (-90.0, 190.0)

    async def scenario(stage: OrientalAZ) -> None:
        with pytest.raises(DeviceFault, match="software overtravel"):
            await stage.move_to(185.0)

    bench.run(scenario)


def test_a_cancelled_request_does_not_answer_the_next_one(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        for _ in range(20):
            state = asyncio.create_task(stage.state())
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            state.cancel()
            assert await stage.position() == pytest.approx(-12.0)

    bench.run(scenario)


def test_a_stop_ends_a_motion_and_allows_the_next(bench: Bench) -> None:
    async def scenario(stage: OrientalAZ) -> None:
        bench.axis.move(90.0)
        assert (await stage.state()).phase is StagePhase.MOVING
        with pytest.raises(DeviceRefused, match="moving"):
            await stage.move_to(3.0)
        await stage.stop()
        await bench.clock.sleep(5.0)
        assert (await stage.state()).phase is StagePhase.READY
        assert await stage.position() < 90.0
        assert await stage.move_to(3.0) == pytest.approx(3.0)

    bench.run(scenario)
