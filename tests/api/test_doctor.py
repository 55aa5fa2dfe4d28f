"""The doctor: what is wrong with a bench is said before a night is lost to it, and nothing fine is refused."""

import asyncio
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from api.commands.main import _Warnings
from api.service import diagnose, make_bench, open_bench, simulated_settings
from api.settings import InstrumentSettings
from drivers.errors import DeviceNotFound
from drivers.interfaces import StagePhase
from drivers.qepro import QEProLight
from goniometer.bench.doctor import Bench, Finding, examine, release, visit
from goniometer.bench.safety import Forbidden
from goniometer.errors import BenchUnfit
from goniometer.storage.records import Scan
from simulators.bench.laboratory import FAMILIES, Laboratory, simulated_laboratory
from simulators.bench.optics import OFFSET, PIXELS, READ_NOISE, WAVELENGTH_COEFFICIENTS, OpticalBench
from simulators.devices.faults import FaultScript

PAIRS = [("smc100", "oriental-az"), ("owis", "k10cr1"), ("k10cr1", "owis"), ("oriental-az", "smc100")]


@pytest.fixture
def laboratory() -> Iterator[Laboratory]:
    with simulated_laboratory(1) as found:
        yield found


def bench_of(laboratory: Laboratory, timeout: float = 1.0) -> Bench:
    """The drivers for a simulated laboratory, which wait so many real seconds for a reply."""
    settings = simulated_settings(laboratory)
    roles = ("sample", "detector")
    stages = {role: {**getattr(settings.stages, role).model_dump(), "timeout": timeout} for role in roles}
    settings = type(settings).model_validate({**settings.model_dump(), "stages": stages})
    return make_bench(settings, laboratory.clock, laboratory.usb_backend)


def found(bench: Bench, *, home: bool = True) -> dict[str, Finding]:
    """What the doctor says, by device."""
    findings = {finding.device: finding for finding in asyncio.run(visit(bench, home=home))}
    assert list(findings) == ["sample stage", "detector stage", "spectrometer", "light"]
    assert all("\n" not in finding.line() for finding in findings.values())
    return findings


def faulty(findings: dict[str, Finding]) -> list[str]:
    return [device for device, finding in findings.items() if finding.problems]


def figures(finding: Finding) -> dict[str, float]:
    return {figure.name: figure.value for figure in finding.figures}


def threads_end_at(number: int) -> bool:
    """Whether no more than `number` threads are left; one that was told to end gets a moment."""
    deadline = time.monotonic() + 60
    while threading.active_count() > number and time.monotonic() < deadline:
        time.sleep(0.01)
    return threading.active_count() <= number


def test_every_family_of_stages_is_among_those_that_are_examined() -> None:
    assert {family for pair in PAIRS for family in pair} == set(FAMILIES)


@pytest.mark.parametrize("stages", PAIRS, ids=" ".join)
def test_a_bench_that_is_fine_is_called_fine_whatever_its_stages(stages: tuple[str, str]) -> None:
    threads = threading.active_count()
    with simulated_laboratory(1, stages) as laboratory:
        bench = bench_of(laboratory)
        findings = found(bench)
        assert faulty(findings) == []
        for device, stage in (("sample stage", bench.sample_stage), ("detector stage", bench.detector_stage)):
            read = figures(findings[device])
            # a degree from rest to rest takes 2 sqrt(1/a) while the cruising speed is not reached
            fastest = 2 / np.sqrt(stage.acceleration)
            assert fastest * 0.999 <= read["time to turn 1°"] < 3 * fastest
            assert abs(read["position"]) < 0.01
        read = figures(findings["spectrometer"])
        assert abs(read["dark offset"] - OFFSET) < 5
        assert abs(read["noise"] - READ_NOISE) < 0.5  # 8 ms of dark current add next to nothing
        assert read["first wavelength"] == pytest.approx(WAVELENGTH_COEFFICIENTS[0])
        assert not laboratory.spectrometer.shutter_open
    assert threads_end_at(threads)


def test_a_stage_without_reference_is_not_moved_unless_it_is_asked_for(laboratory: Laboratory) -> None:
    bench = bench_of(laboratory)
    findings = found(bench, home=False)
    assert faulty(findings) == []
    assert "--home" in findings["sample stage"].line()
    assert "time to turn 1°" not in figures(findings["sample stage"])

    async def phase() -> StagePhase:
        await bench.sample_stage.open()
        state = await bench.sample_stage.state()
        await bench.sample_stage.close()
        return state.phase

    assert asyncio.run(phase()) is StagePhase.NOT_REFERENCED


def test_a_stage_that_restarts_after_homing_lets_no_scan_start(laboratory: Laboratory) -> None:
    bench = bench_of(laboratory)

    async def scenario() -> list[Finding]:
        for device in (bench.sample_stage, bench.detector_stage, bench.spectrometer):
            await device.open()
        await bench.sample_stage.home()
        laboratory.sample_stage.restart()
        try:
            return await examine(bench, referenced=True)
        finally:
            await release(bench)

    lines = [finding.line() for finding in asyncio.run(scenario()) if finding.problems]
    assert len(lines) == 1
    assert "sample stage: has forgotten its reference" in lines[0]


@pytest.mark.parametrize("who", ["sample_stage", "detector_stage", "spectrometer"])
def test_a_bad_line_is_survived_or_reported_and_never_ends_the_doctor(laboratory: Laboratory, who: str) -> None:
    getattr(laboratory, who).script = FaultScript.parse("from 5 every 9 lose-reply\nfrom 7 every 11 corrupt")
    findings = found(bench_of(laboratory, timeout=0.1))
    name = who.replace("_", " ")
    assert set(faulty(findings)) <= {name, "light" if who == "spectrometer" else name}
    assert not laboratory.spectrometer.shutter_open


def test_one_missing_device_hides_no_other_fault(laboratory: Laboratory) -> None:
    laboratory.sample_stage.unplug()
    laboratory.bench.nonlinearity_coefficients = (2.0,) + (0.0,) * 7
    findings = found(bench_of(laboratory))
    assert faulty(findings) == ["sample stage", "spectrometer"]
    assert "cannot open" in findings["sample stage"].line()
    assert "non-linearity" in findings["spectrometer"].line()
    assert figures(findings["detector stage"])["read-back error"] < 0.01


def test_a_missing_spectrometer_is_named_and_the_stages_are_still_examined(laboratory: Laboratory) -> None:
    bench = make_bench(simulated_settings(laboratory), laboratory.clock, None)  # the system's own USB has no QE Pro
    findings = found(bench)
    assert faulty(findings) == ["spectrometer", "light"]


@pytest.mark.parametrize("stages", PAIRS[:2], ids=" ".join)
def test_a_stage_that_takes_ten_times_as_long_is_found_before_the_night(stages: tuple[str, str]) -> None:
    with simulated_laboratory(1, stages) as laboratory:
        laboratory.sample_stage.slow()
        laboratory.detector_stage.slow()
        findings = found(bench_of(laboratory))
    assert faulty(findings) == ["sample stage", "detector stage"]


def test_a_jammed_stage_says_so_and_is_cleared_by_homing(laboratory: Laboratory) -> None:
    assert faulty(found(bench_of(laboratory))) == []
    laboratory.sample_stage.jam()
    findings = found(bench_of(laboratory), home=False)
    assert faulty(findings) == ["sample stage"]
    assert "following error" in findings["sample stage"].line()
    assert "--home" in findings["sample stage"].line()
    assert faulty(found(bench_of(laboratory), home=True)) == []


def saturated(*_: Any, **__: Any) -> Any:
    return np.full(PIXELS, 200_000, dtype=np.uint32)


def without_offset(*_: Any, **__: Any) -> Any:
    return np.random.default_rng().integers(0, 2, PIXELS).astype(np.uint32) // 2


def frozen(*_: Any, **__: Any) -> Any:
    return np.random.default_rng(1).normal(1500, 6, PIXELS).astype(np.uint32)


@pytest.mark.parametrize(
    ("read_out", "words"),
    [(saturated, "saturated"), (without_offset, "zero"), (frozen, "same spectrum")],
)
def test_a_dead_or_blinded_detector_is_found(
    laboratory: Laboratory, monkeypatch: pytest.MonkeyPatch, read_out: Callable[..., Any], words: str
) -> None:
    monkeypatch.setattr(laboratory.bench, "read_out", read_out)
    findings = found(bench_of(laboratory))
    assert faulty(findings) == ["spectrometer"]
    assert words in findings["spectrometer"].line()


@pytest.mark.parametrize("coefficients", [(1050.5, -0.8, 0.0, 0.0), (100.5, 0.8, 0.0, 0.0), (500.5, 0.8, 0.0, 0.0)])
def test_wrong_wavelengths_are_found(laboratory: Laboratory, coefficients: tuple[float, ...]) -> None:
    laboratory.bench.wavelength_coefficients = coefficients
    findings = found(bench_of(laboratory))
    assert "spectrometer" in faulty(findings)
    assert "wavelength" in findings["spectrometer"].line()


def test_a_detector_that_is_not_at_its_set_point_is_found(laboratory: Laboratory) -> None:
    findings = found(replace(bench_of(laboratory), set_point=-12.0))
    assert faulty(findings) == ["spectrometer"]
    assert "°C" in findings["spectrometer"].line()


async def look_at_a_panel(bench: Bench, laboratory: Laboratory) -> None:
    """Put the panel in and the detector where it sees it."""
    laboratory.bench.mount("spectralon")
    for stage, angle in ((bench.sample_stage, 0.0), (bench.detector_stage, 45.0)):
        await stage.open()
        await stage.home()
        await stage.move_to(angle)
        await stage.close()


def test_light_is_reported_where_it_can_be_seen(laboratory: Laboratory) -> None:
    bench = bench_of(laboratory)
    assert "light" not in figures(found(bench)["light"])
    asyncio.run(look_at_a_panel(bench, laboratory))
    # the brightest pixel of the panel gives 2000 counts a second here, a mean pixel less
    assert 20 < figures(found(bench)["light"])["light"] < 200


def test_a_shutter_that_answers_the_wrong_way_round_is_found(laboratory: Laboratory) -> None:
    class Inverted(QEProLight):
        async def set_shutter(self, is_open: bool) -> None:
            await super().set_shutter(not is_open)

    bench = bench_of(laboratory)
    asyncio.run(look_at_a_panel(bench, laboratory))
    findings = found(replace(bench, light=Inverted(bench.spectrometer)))
    assert faulty(findings) == ["light"]
    assert "polarity" in findings["light"].line()


def test_no_stage_is_exercised_into_a_forbidden_region(laboratory: Laboratory, monkeypatch: pytest.MonkeyPatch) -> None:
    right = Forbidden(sample=(0.5, 90.0), detector=(-10.0, 10.0))
    above = Forbidden(sample=(-1.0, 0.4), detector=(0.5, 10.0))
    bench = replace(bench_of(laboratory), forbidden=(right, above))
    turned = []
    move = bench.detector_stage.move_to

    async def watched(angle: float) -> float:
        turned.append(angle)
        return await move(angle)

    monkeypatch.setattr(bench.detector_stage, "move_to", watched)
    findings = found(bench)
    assert faulty(findings) == []
    assert "no room" in findings["sample stage"].line()
    assert turned == [-1.0, 0.0]


async def nobody(_: Scan) -> None:
    raise AssertionError("nobody is there")


def test_where_regions_are_forbidden_no_stage_moves_while_the_other_is_lost(laboratory: Laboratory) -> None:
    region = Forbidden(sample=(60.0, 90.0), detector=(-85.0, -60.0))
    findings = found(replace(bench_of(laboratory), forbidden=(region,)), home=False)  # the sample stage is lost
    assert faulty(findings) == []
    assert "time to turn 1°" not in figures(findings["detector stage"])


def test_no_scan_starts_on_a_bench_that_the_doctor_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OpticalBench, "nonlinearity_coefficients", (2.0,) + (0.0,) * 7)
    threads = threading.active_count()

    async def scenario() -> None:
        async with open_bench(None, 1, nobody):
            raise AssertionError("the bench was handed out")

    with pytest.raises(BenchUnfit) as refused:
        asyncio.run(scenario())
    assert len(refused.value.lines) == 1
    assert "spectrometer: its non-linearity" in str(refused.value)
    assert threads_end_at(threads)


NOWHERE = {
    "stages": {
        "sample": {"driver": "k10cr1", "serial_number": "nowhere-1"},
        "detector": {"driver": "oriental-az", "url": "tcp://127.0.0.1:9"},
    }
}
"""A bench of which nothing is there."""


def test_an_adapter_that_is_not_plugged_in_stops_a_run_and_hides_nothing_from_the_doctor() -> None:
    settings = InstrumentSettings.model_validate(NOWHERE)

    async def scenario() -> None:
        async with open_bench(settings, 1, nobody):
            raise AssertionError("the bench was handed out")

    with pytest.raises(DeviceNotFound, match="nowhere-1"):
        asyncio.run(scenario())
    findings = asyncio.run(diagnose(settings))
    assert [bool(finding.problems) for finding in findings] == [True] * 4
    assert "nowhere-1" in findings[0].line()
    assert "127.0.0.1:9" in findings[1].line()


@pytest.mark.parametrize("stages", PAIRS[1:], ids=" ".join)
def test_the_simulated_bench_opens_with_stages_of_any_family(stages: tuple[str, str]) -> None:
    async def scenario() -> list[str]:
        async with open_bench(None, 1, nobody, stages) as (instrument, _):
            return list((await instrument.constants()).stages)

    assert asyncio.run(scenario()) == ["sample stage", "detector stage"]


def test_the_doctor_ends_in_the_safe_state_when_it_is_interrupted(laboratory: Laboratory) -> None:
    bench = bench_of(laboratory)
    threads = threading.active_count()

    async def scenario() -> None:
        exposing = asyncio.Event()

        class Watched(QEProLight):
            async def set_shutter(self, is_open: bool) -> None:
                await super().set_shutter(is_open)
                if is_open:
                    exposing.set()
                    await asyncio.sleep(60)

        watched = replace(bench, light=Watched(bench.spectrometer))
        task = asyncio.ensure_future(visit(watched))
        await asyncio.wait_for(exposing.wait(), 30)
        assert laboratory.spectrometer.shutter_open
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(scenario())
    assert not laboratory.spectrometer.shutter_open
    assert threads_end_at(threads)


def test_a_newcomer_gets_four_lines_and_a_script_gets_json(cli: Any, tmp_path: Any) -> None:
    told = cli("doctor", cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert [line.split(":")[0] for line in told.stdout.splitlines()] == [
        "sample stage",
        "detector stage",
        "spectrometer",
        "light",
    ]
    (tmp_path / "i.toml").write_text(
        '[stages]\nsample = {driver = "smc100", url = "socket://127.0.0.1:9"}\n'
        'detector = {driver = "oriental-az", url = "tcp://127.0.0.1:9"}\n'
    )
    done = cli("doctor", "--instrument", "i.toml", "--json", cwd=tmp_path)
    assert done.returncode == 1
    content = json.loads(done.stdout)
    assert content["fit"] is False
    assert [bool(finding["problems"]) for finding in content["findings"]] == [True] * 4
    assert "Traceback" not in done.stderr


def test_what_drivers_warn_of_is_one_line_on_stderr_and_spoils_no_json(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("a driver")  # that of the drivers has a handler where a test was the command line before
    handler = _Warnings(logging.WARNING)
    log.addHandler(handler)
    try:
        try:
            raise OSError("gone")
        except OSError:
            log.warning("sample stage: no reply to %r; asking again", b"1TS\r\n", exc_info=True)
        log.info("nobody needs to know")
    finally:
        log.removeHandler(handler)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == "warning: sample stage: no reply to b'1TS\\r\\n'; asking again\n"


def test_the_doctor_of_the_simulated_bench_homes_on_request() -> None:
    findings = asyncio.run(diagnose(None, home=True, families=("owis", "k10cr1")))
    assert [finding.problems for finding in findings] == [()] * 4
