"""What is special about an SMC100: its own limits and speeds, and answers that name their question."""

import asyncio
import contextlib
from collections.abc import Iterator

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.smc100 import SMC100
from simulators.devices.faults import Fault, FaultScript, Kind
from tests.stage_bench import FAMILIES, Bench, until

LIMITS = (-10.0, 100.0)


@pytest.fixture
def bench() -> Iterator[Bench[SMC100]]:
    bench = Bench(FAMILIES["SMC100"], limits=LIMITS)
    yield bench
    bench.simulator.close()


def test_the_controllers_own_limits_are_reported_in_words(bench: Bench[SMC100]) -> None:
    bench.stage.limits = (-5.0, 120.0)

    async def scenario(stage: SMC100) -> None:
        with pytest.raises(DeviceRefused, match=r"PA110.*out of its own limits"):
            await stage.move_to(110.0)

    bench.run(scenario)


def test_a_process_that_died_in_a_slow_motion_does_not_leave_the_stage_slow_for_ever(bench: Bench[SMC100]) -> None:
    async def slow_down(stage: SMC100) -> None:
        await stage.set_velocity(2.0)

    async def scenario(stage: SMC100) -> None:
        assert stage.velocity == 20.0, "as it is stored in the controller"

    bench.run(slow_down)
    bench.run(scenario, bench.driver())


def test_an_address_that_pyserial_does_not_know_is_not_found(bench: Bench[SMC100]) -> None:
    with pytest.raises(DeviceNotFound, match="nonsense://x"):
        asyncio.run(SMC100("sample stage", "nonsense://x", bench.clock).open())


def test_a_connection_that_has_died_unseen_is_replaced_although_another_stage_holds_it() -> None:
    bench: Bench[SMC100] = Bench(FAMILIES["SMC100"], socket=True)
    other = SMC100("other", bench.url, bench.clock, timeout=0.1)

    async def scenario(stage: SMC100) -> None:
        await other.open()
        # as a terminal server that was switched off and on: what was connected before is never heard again
        for connection in bench.simulator._connections:
            connection.receive = lambda data: None
        with pytest.raises(DeviceTimeout):
            await stage.state()
        await stage.close()
        await stage.open()
        assert await stage.position() == await other.position()
        await other.close()

    try:
        bench.run(scenario)
    finally:
        bench.simulator.close()


def test_noise_on_the_line_is_no_angle(bench: Bench[SMC100]) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("from 1 garbage")
        with pytest.raises(ProtocolError, match="is no answer to"):
            await stage.position()

    bench.run(scenario, bench.driver(timeout=0.3))


LINE_FAULTS = [
    "lose-request",
    "lose-reply",
    "delay 0.13 s",
    "duplicate",
    "corrupt",
    "truncate",
    "garbage",
    "split",
    "merge",
    "foreign",
    "unplug 0.05 s",
    "stall 0.13 s",
]
DEVICE_FAULTS = ["refuse", "restart", "jam", "drift", "slow"]


@pytest.mark.slow
# without shrinking, which would wait for thousands of real timeouts
@settings(max_examples=10, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    st.lists(
        st.builds(
            lambda at, every, fault: f"from {at} every {every} {fault}",
            st.integers(1, 30),
            st.integers(5, 60),
            st.sampled_from(LINE_FAULTS + DEVICE_FAULTS),
        ),
        min_size=1,
        max_size=5,
    ),
    st.integers(0, 1000),
)
def test_no_night_of_faults_leaves_a_wrong_angle_or_a_dead_stage(script: list[str], seed: int) -> None:
    bench: Bench[SMC100] = Bench(FAMILIES["SMC100"], limits=LIMITS)

    async def scenario(stage: SMC100) -> None:
        bench.befall("\n".join(script), seed)
        for target in (30.0, 5.0, 60.0, 0.0):
            try:
                reached = await stage.move_to(target)
            except DriverError:
                # what an operator would try, on a line that is still bad
                with contextlib.suppress(DriverError):
                    await stage.close()
                    await stage.open()
                    await stage.home()
            else:
                assert reached == pytest.approx(target, abs=0.002)
                assert bench.axis.position() == pytest.approx(target, abs=0.002)
        bench.befall("")
        bench.simulator.drift(0.0)
        bench.simulator.slow(1.0)
        bench.simulator.restart()
        await bench.make_ready(stage)
        await stage.home()
        assert await stage.move_to(20.0) == 20.0
        assert bench.axis.position() == 20.0

    try:
        bench.run(scenario)
    finally:
        bench.simulator.close()


def test_a_velocity_that_was_misread_is_never_taken_for_the_stages_own(bench: Bench[SMC100]) -> None:
    async def scenario(stage: SMC100) -> None:
        for seed in range(40):
            await stage.close()
            bench.befall(f"at {4 + seed % 4} corrupt", seed)  # VA? and AC?, each asked twice
            try:
                await stage.open()
            except ProtocolError:
                await bench.make_ready(stage)
            assert (stage.velocity, stage.acceleration) == (20.0, 40.0)

    bench.run(scenario)


def test_a_velocity_that_did_not_get_through_is_noticed(bench: Bench[SMC100]) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.befall("at 1 lose-request")
        with pytest.raises(ProtocolError, match=r"told to move at 5°/s and reads back 20°/s"):
            await stage.set_velocity(5.0)
        assert stage.velocity == 20.0
        await stage.set_velocity(5.0)
        assert stage.velocity == 5.0

    bench.run(scenario)


def test_a_command_that_a_stop_overtakes_never_reaches_the_device(bench: Bench[SMC100]) -> None:
    async def scenario(stage: SMC100) -> None:
        bench.simulator.script = FaultScript([Fault(Kind.LOSE_REPLY, 1)])
        # the question before the move waits for its lost answer in the device's thread, and the move behind it
        waiting = [asyncio.create_task(stage.position()), asyncio.create_task(stage._begin_move(80.0))]
        await until(lambda: bench.simulator.script.requests >= 1)
        await stage.stop()
        with pytest.raises(DeviceRefused, match="was stopped before"):
            await waiting[1]
        await waiting[0]
        assert not bench.axis.moving()
        assert (await stage.move_to(10.0)) == 10.0

    bench.run(scenario, bench.driver(timeout=1.0))
