"""What is special about an OWIS PS: commands without replies, answers that say nothing of themselves, many axes."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from itertools import cycle, pairwise

import pytest

from drivers.errors import DeviceDisconnected, DeviceFault, DeviceNotFound, DeviceRefused, ProtocolError
from drivers.interfaces import StagePhase
from drivers.owis import OwisPS, ReferenceMode
from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.devices.owis import SimulatedOwisPS
from tests.stage_bench import FAMILIES, HAS_TERMINALS, Bench, until


@pytest.fixture
def bench() -> Iterator[Bench[OwisPS]]:
    bench: Bench[OwisPS] = Bench(FAMILIES["OWIS PS"], timeout=0.3)
    yield bench
    bench.simulator.close()


def test_a_ps10_is_the_same_with_one_axis() -> None:
    clock = SimulatedClock()
    axis = Axis(clock, start=3.0, velocity=5, acceleration=5, limits=(-20, 100))
    simulator = SimulatedOwisPS([axis], clock, counts_per_degree=200)

    async def scenario() -> None:
        stage = OwisPS("stage", simulator.start(), clock, counts_per_degree=200, timeout=0.3)
        await stage.open()
        await stage.home()
        assert await stage.move_to(33.335) == 33.335
        await stage.close()

    try:
        asyncio.run(scenario())
    finally:
        simulator.close()


def test_a_counter_that_was_never_zeroed_is_no_reference(bench: Bench[OwisPS]) -> None:
    """Somebody else initialised the axis, but did not search for the reference."""

    async def scenario(stage: OwisPS) -> None:
        bench.simulator.answer(b"INIT2")
        assert (await stage.state()).phase is StagePhase.NOT_REFERENCED

    bench.run(scenario, homed=False)


def test_a_way_of_referencing_that_leaves_the_counter_is_not_accepted() -> None:
    with pytest.raises(ValueError, match="2 is not a valid ReferenceMode"):
        ReferenceMode(2)


def test_a_refused_velocity_is_refused_in_the_controllers_words(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.refuse()
        with pytest.raises(DeviceRefused, match=r"PVEL2=7000 and keeps 10000.*'09'"):
            await stage.set_velocity(7.0)
        assert stage.velocity == 10.0
        assert await stage.move_to(30.0) == 30.0

    bench.run(scenario)


@pytest.mark.parametrize("command", ["INIT", "REF", "PSET", "PGO", "PVEL"])
def test_a_command_that_never_arrives_is_an_error_and_not_a_success(bench: Bench[OwisPS], command: str) -> None:
    """Commands have no reply, so that only what the controller shows afterwards can tell."""

    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(20.0)
        answer = bench.simulator.answer
        lost: list[bytes] = []

        def forgetful(request: bytes) -> bytes:
            if request.startswith(command.encode()) and not lost:
                lost.append(request)
                return b""
            return answer(request)

        bench.simulator.answer = forgetful
        if command == "INIT":
            bench.simulator.jam()
        deeds: dict[str, Callable[[], Awaitable[object]]] = {
            "PVEL": lambda: stage.set_velocity(3.0),
            "PSET": lambda: stage.move_to(50.0),
            "PGO": lambda: stage.move_to(50.0),
        }
        with pytest.raises((DeviceRefused, DeviceFault), match="sample stage"):
            await deeds.get(command, stage.home)()
        assert lost
        if command in {"PSET", "PGO"}:
            assert bench.axis.position() == 20.0

    bench.run(scenario)


def test_relative_positions_that_somebody_left_behind_do_not_send_the_stage_elsewhere(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(20.0)
        bench.simulator.answer(b"RELAT2")
        assert await stage.move_to(30.0) == 30.0

    bench.run(scenario)


def test_replies_of_ok_to_commands_do_no_harm(bench: Bench[OwisPS]) -> None:
    bench.simulator.answer(b"TERM=2")

    async def scenario(stage: OwisPS) -> None:
        assert await stage.move_to(30.0) == 30.0
        await stage.set_velocity(4.0)
        assert await stage.move_to(0.0) == 0.0

    bench.run(scenario)


def test_a_stage_on_its_limit_switch_is_freed_by_homing(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        stage.limits = (-5.0, 200.0)
        with pytest.raises(DeviceFault, match="limit switch, high limit switch"):
            await stage.move_to(150.0)
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


def test_motor_off_is_said_and_homing_switches_it_on(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        bench.simulator.answer(b"MOFF2")
        assert (await stage.state()).phase is StagePhase.DISABLED
        with pytest.raises(DeviceRefused, match="disabled; home it first"):
            await stage.move_to(10.0)
        await stage.home()
        assert await stage.move_to(10.0) == 10.0

    bench.run(scenario)


@pytest.mark.parametrize("reply", [b"16\r", b"00001\r"])
def test_an_error_of_the_power_stage_is_named_in_either_dialect(bench: Bench[OwisPS], reply: bytes) -> None:
    async def scenario(stage: OwisPS) -> None:
        answer = bench.simulator.answer
        bench.simulator.answer = lambda request: reply if request == b"?ESTAT2" else answer(request)
        state = await stage.state()
        assert (state.phase, state.message) == (StagePhase.FAULT, "power stage error")
        with pytest.raises(DeviceRefused, match="power stage error"):
            await stage.move_to(10.0)

    bench.run(scenario)


def test_a_stopped_search_is_no_reference(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(80.0)
        under_way = bench.clock.hold()
        homing = asyncio.create_task(stage.home())
        await under_way.wait()
        await stage.stop()
        bench.clock.released.set()
        with pytest.raises(DeviceFault, match="not referenced"):
            await homing

    bench.run(scenario)


def test_an_axis_that_the_controller_does_not_have_is_not_found(bench: Bench[OwisPS]) -> None:
    with pytest.raises(DeviceNotFound, match="no axis 4; it has 3"):
        asyncio.run(bench.driver(axis=4).open())


def test_another_instrument_is_not_taken_for_a_controller(bench: Bench[OwisPS]) -> None:
    bench.simulator.answer = lambda request: b"12345\r"
    with pytest.raises(ProtocolError, match="is no answer to"):
        asyncio.run(bench.stage.open())


def test_a_reply_to_an_earlier_question_is_never_a_position(bench: Bench[OwisPS]) -> None:
    """Every reply comes again before the next one, so that a client that counts lines would be off by one."""

    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        await stage.set_velocity(5.0)
        bench.befall("from 1 duplicate")
        for target in (34.0, 35.0):
            assert await stage.move_to(target) == target
        bench.befall("every 2 foreign", seed=3)
        for _ in range(10):
            try:
                assert await stage.position() == 35.0
            except ProtocolError:
                continue

    bench.run(scenario)


def test_an_encoder_that_trembles_is_read_to_its_tremor(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        await stage.move_to(33.0)
        answer, trembling = bench.simulator.answer, cycle([33001, 32999, 33000])
        bench.simulator.answer = lambda request: b"%d\r" % next(trembling) if request == b"?CNT2" else answer(request)
        assert await stage.position() == pytest.approx(33.0, abs=0.001)

    bench.run(scenario)


@pytest.mark.skipif(not HAS_TERMINALS, reason="Windows has no pseudo-terminals")
def test_both_stages_of_a_bench_may_hang_on_one_controller(bench: Bench[OwisPS]) -> None:
    sample, detector = bench.driver(timeout=0.5), bench.driver(axis=3, timeout=0.5)

    async def scenario() -> None:
        # two openings of one terminal would take each other's replies, so it is opened exclusively, and only once
        await asyncio.gather(sample.open(), detector.open())
        await asyncio.gather(sample.home(), detector.home())
        bench.befall("every 41 lose-reply\nevery 59 foreign")
        for angle in (10.0, 20.0, 30.0):
            angles = await asyncio.gather(sample.move_to(angle), detector.move_to(2 * angle))
            assert list(angles) == [angle, 2 * angle]
        bench.befall("")
        # the one that leaves takes nothing from the other
        await sample.close()
        assert await detector.move_to(5.0) == 5.0
        with pytest.raises(DeviceDisconnected, match="not open"):
            await sample.position()
        await sample.open()
        bench.simulator.unplug()
        for stage in (sample, detector):
            with pytest.raises(DeviceDisconnected):
                await stage.position()
        bench.simulator.start_pty()
        for stage in (sample, detector):
            await stage.close()
            await stage.open()
        assert list(await asyncio.gather(sample.move_to(40.0), detector.move_to(7.0))) == [40.0, 7.0]
        await sample.close()
        await detector.close()

    before = threading.active_count()
    asyncio.run(scenario())
    asyncio.run(until(lambda: threading.active_count() <= before))


def test_no_number_follows_a_number_on_a_line_with_two_axes(
    bench: Bench[OwisPS], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bytes] = []
    answer = bench.simulator.answer

    def listen(request: bytes) -> bytes:
        asked.append(request)
        return answer(request)

    async def scenario(stage: OwisPS) -> None:
        other = bench.driver(axis=3)
        await other.open()
        monkeypatch.setattr(bench.simulator, "answer", listen)
        await asyncio.gather(*(each.state() for each in (stage, other) for _ in range(3)))
        await other.close()

    bench.run(scenario)
    numbers = [request[:5] in {b"?CNT1", b"?CNT3", b"?ESTA", b"?REFS"} for request in asked]
    assert sum(numbers) > 20
    assert not any(first and second for first, second in pairwise(numbers))


def test_a_line_cannot_have_two_baud_rates(bench: Bench[OwisPS]) -> None:
    async def scenario(stage: OwisPS) -> None:
        other = OwisPS("other", bench.url, bench.clock, counts_per_degree=1.0, baudrate=19200)
        with pytest.raises(DeviceNotFound, match="9600 Bd"):
            await other.open()
        assert await stage.move_to(3.0) == 3.0

    bench.run(scenario)
