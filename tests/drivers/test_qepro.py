"""The QE Pro driver delivers the spectrum that was asked for, or says why not."""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from drivers.arrays import CountArray
from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    DriverError,
    ProtocolError,
)
from drivers.interfaces import Light, Spectrometer, Spectrum
from drivers.qepro import QEPro, QEProLight
from drivers.qepro_wire import Gpio, TriggerMode
from simulators.bench.imperfections import Imperfections
from simulators.bench.optics import OpticalBench
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from simulators.devices.qepro import SimulatedQEPro


class Glow:
    """A detector whose counts tell the integration time, the moment, the shutter and the lamp."""

    pixels = 1044
    wavelength_coefficients = (345.25, 0.8, -1e-5, -2e-9)

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock
        self.temperatures: list[float] = []
        self.nonlinearity_coefficients: tuple[float, ...] = (0.875, 2.0**-20, 0, 0, 0, 0, 0, 0)

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float, ended: float
    ) -> CountArray:
        counts = np.full(self.pixels, 1000 + 1000 * integration_time + 100 * shutter_open + 200 * lamp_on)
        counts[0] = round(100 * self.clock.now())
        self.temperatures.append(sensor_temperature)
        return counts.astype(np.uint32)


class HoldingClock(SimulatedClock):
    """A clock that can be told to let long waits take real time, so that there is time to cancel them."""

    hold = False

    async def sleep(self, seconds: float) -> None:
        if self.hold and seconds > 100:
            await asyncio.sleep(30)
        await super().sleep(seconds)


class Bench:
    """A simulated spectrometer, and the driver connected to it."""

    def __init__(self, packet_size: int = 512, **settings: float) -> None:
        self.clock = HoldingClock()
        self.detector = Glow(self.clock)
        self.simulator = SimulatedQEPro(self.detector, self.clock, packet_size=packet_size)
        self.spectrometer = QEPro("spectrometer", self.clock, usb_backend=self.simulator, **settings)

    def run(self, scenario: Callable[[QEPro], Awaitable[None]]) -> None:
        async def whole() -> None:
            await self.spectrometer.open()
            await scenario(self.spectrometer)
            await self.spectrometer.close()

        asyncio.run(whole())


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_it_is_a_spectrometer_and_a_light(bench: Bench) -> None:
    spectrometer: Spectrometer = bench.spectrometer
    light: Light = QEProLight(bench.spectrometer)
    assert spectrometer.saturation == 200_000
    assert isinstance(light, QEProLight)


@pytest.mark.parametrize("packet_size", [512, 64])
def test_spectra_of_changing_integration_times_are_those_that_were_asked_for(packet_size: int) -> None:
    bench = Bench(packet_size)

    async def scenario(spectrometer: QEPro) -> None:
        for seconds in (0.1, 0.1, 2.0, 0.008, 2.0):
            begin = bench.clock.now()
            spectrum = await spectrometer.expose(seconds)
            assert spectrum.integration_time == seconds
            assert spectrum.counts.shape == (1044,)
            assert spectrum.counts[1] == round(1000 + 1000 * seconds)
            assert bench.clock.now() - begin == pytest.approx(seconds, abs=1e-6)

    bench.run(scenario)


def test_the_detector_is_cold_before_anything_is_measured(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        assert bench.clock.now() > 30
        assert (await spectrometer.expose(0.1)).detector_temperature == pytest.approx(-10, abs=0.1)

    bench.run(scenario)


def test_wavelengths_and_nonlinearity_are_the_devices_own(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        pixel = 1043
        expected = 345.25 + 0.8 * pixel - 1e-5 * pixel**2 - 2e-9 * pixel**3
        wavelengths = await spectrometer.wavelengths()
        assert wavelengths.shape == (1044,)
        assert wavelengths[0] == 345.25
        assert wavelengths[pixel] == pytest.approx(expected, abs=1e-4)
        np.testing.assert_array_equal(await spectrometer.nonlinearity(), [0.875, 2.0**-20, 0, 0, 0, 0, 0, 0])
        assert await spectrometer.identity() == "Ocean Optics QE Pro QEP00001 (hardware 3, firmware 0x0104)"

    bench.run(scenario)


def test_a_device_that_was_never_characterised_does_not_turn_spectra_into_infinities(bench: Bench) -> None:
    bench.detector.nonlinearity_coefficients = (0.0,) * 8

    async def scenario(spectrometer: QEPro) -> None:
        np.testing.assert_array_equal(await spectrometer.nonlinearity(), [1.0])

    bench.run(scenario)


def test_lamp_and_shutter_change_what_is_seen(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        light = QEProLight(spectrometer)
        await light.set_lamp(True)
        assert (await spectrometer.expose(1.0)).counts[1] == 2200
        await light.set_shutter(True)
        assert (await spectrometer.expose(1.0)).counts[1] == 2300
        await light.set_lamp(False)
        await light.set_shutter(False)
        assert (await spectrometer.expose(1.0)).counts[1] == 2000

    bench.run(scenario)


@pytest.mark.parametrize("fault", ["stale_spectra", "repeated_spectra"])
def test_stale_spectra_are_discarded_and_a_device_that_sends_nothing_else_is_given_up(bench: Bench, fault: str) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        await spectrometer.expose(0.1)
        setattr(bench.simulator.faults, fault, 2)
        begin = bench.clock.now()
        spectrum = await spectrometer.expose(5.0 if fault == "stale_spectra" else 0.1)
        assert spectrum.counts[0] == round(100 * bench.clock.now())
        assert bench.clock.now() > begin
        setattr(bench.simulator.faults, fault, 1000)
        with pytest.raises(ProtocolError, match="4 stale spectra"):
            await spectrometer.expose(0.1)

    bench.run(scenario)


@pytest.mark.parametrize("seconds", [0.0079, 1600.0, float("nan")])
def test_an_impossible_integration_time_is_refused_with_the_limits(bench: Bench, seconds: float) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.jam()  # a message sent would now end in a fault
        with pytest.raises(DeviceRefused, match=r"0\.008 s to 1600 s"):
            await spectrometer.expose(seconds)

    bench.run(scenario)


def test_a_refused_setting_is_not_ignored(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        await spectrometer.expose(0.1)
        bench.simulator.faults.refused = {0x00110010}
        with pytest.raises(DeviceRefused, match="0x00110010: it is not ready"):
            await spectrometer.expose(0.2)
        bench.simulator.faults.refused = set()
        assert (await spectrometer.expose(0.2)).integration_time == 0.2

    bench.run(scenario)


def test_an_acquisition_ten_times_too_long_is_waited_for_or_given_up(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.faults.slowness = 10
        assert (await spectrometer.expose(0.1)).integration_time == 0.1
        begin = bench.clock.now()
        with pytest.raises(DeviceTimeout, match="no answer"):
            await spectrometer.expose(20.0)
        assert bench.clock.now() - begin < 30
        bench.simulator.faults.slowness = 1
        assert (await spectrometer.expose(20.0)).integration_time == 20.0

    bench.run(scenario)


def test_a_cancelled_exposure_leaves_the_next_one_right(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        for turns in range(12):
            exposure = asyncio.create_task(spectrometer.expose(300.0))
            for _ in range(turns):
                await asyncio.sleep(0.0003)
            exposure.cancel()
            await asyncio.gather(exposure, return_exceptions=True)
            begin = bench.clock.now()
            spectrum = await spectrometer.expose(0.5)
            assert spectrum.counts[1] == 1500
            assert bench.clock.now() - begin < 301

    bench.run(scenario)


def test_a_silent_device_is_a_timeout_and_answers_again_later(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.script = FaultScript.parse("from 1 lose-request")
        with pytest.raises(DeviceTimeout, match="no answer on USB"):
            await spectrometer.expose(0.1)
        bench.simulator.script = FaultScript()
        assert (await spectrometer.expose(0.1)).integration_time == 0.1

    bench.run(scenario)


def test_a_hardware_fault_is_told_apart_from_a_refusal(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.jam()
        with pytest.raises(DeviceFault, match="internal error"):
            await spectrometer.expose(0.1)

    bench.run(scenario)


def test_a_cooler_that_never_gets_cold_is_given_up(bench: Bench) -> None:
    bench.simulator.faults.coldest = 5.0
    with pytest.raises(DeviceTimeout, match=r"5\.0 °C.*-10 °C"):
        asyncio.run(bench.spectrometer.open())
    assert 600 < bench.clock.now() < 700


def test_a_missing_device_is_named_with_what_was_found(bench: Bench) -> None:
    spectrometer = QEPro("spectrometer", bench.clock, serial_number="QEP99999", usb_backend=bench.simulator)
    with pytest.raises(DeviceNotFound, match=r"QEP99999.*found: QEP00001"):
        asyncio.run(spectrometer.open())
    bench.simulator.unplug()
    with pytest.raises(DeviceNotFound, match="found: none"):
        asyncio.run(bench.spectrometer.open())


def is_right(spectrum: Spectrum, seconds: float, begin: float, light: int) -> bool:
    """Whether it was taken after `begin`, with this integration time and this light."""
    return (
        spectrum.integration_time == seconds
        and spectrum.counts[0] >= round(100 * (begin + seconds)) - 1
        and spectrum.counts[1] == round(1000 + 1000 * seconds) + light
        and spectrum.detector_temperature == pytest.approx(-10, abs=0.5)
    )


FAULTS = (
    "lose-request",
    "lose-reply",
    "delay 0.3 s",
    "delay 3 s",
    "duplicate",
    "corrupt",
    "truncate",
    "garbage",
    "split",
    "merge",
    "foreign",
    "unplug 0.3 s",
    "stall 0.3 s",
    "refuse",
    "restart",
    "jam",
    "slow",
    "drift",
)
STEP = 11
"""Only every so many messages are struck, to save time."""


@pytest.mark.parametrize("fault", FAULTS)
def test_whatever_befalls_a_message_no_wrong_spectrum_comes_and_the_device_can_be_used_again(fault: str) -> None:
    async def work(bench: Bench, light: QEProLight) -> None:
        spectrometer, clock = bench.spectrometer, bench.clock
        await spectrometer.open()
        await light.set_lamp(True)
        for seconds in (0.1, 0.2):
            begin = clock.now()
            assert is_right(await spectrometer.expose(seconds), seconds, begin, 200)
        await light.set_shutter(True)
        begin = clock.now()
        for number, spectrum in enumerate(await spectrometer.sequence(0.2, 3)):
            assert is_right(spectrum, 0.2, begin + 0.2 * number, 300)

    async def strike(at: int) -> bool:
        bench = Bench(64 if at % 2 else 512, timeout=1.0)
        light = QEProLight(bench.spectrometer)
        script = bench.simulator.script = FaultScript.parse(f"at {at} {fault}", seed=at)
        try:
            await work(bench, light)
        except DriverError:
            bench.simulator.script = FaultScript()
            bench.simulator.restart()
            bench.simulator.faults.slowness, bench.simulator.faults.offset = 1.0, 0.0
            await bench.clock.sleep(1.0)
            await work(bench, light)
        await bench.spectrometer.close()
        return bool(script.happened)

    at = 1 + FAULTS.index(fault) % 8
    while asyncio.run(strike(at)):
        at += STEP
    assert at > 60


def test_a_sequence_is_what_repeated_exposures_would_have_been() -> None:
    class Still:
        def true_positions(self, moments: np.ndarray) -> np.ndarray:
            return np.full(moments.shape, 40.0)

    def spectra(take: Callable[[QEPro], Awaitable[list[Spectrum]]]) -> np.ndarray:
        clock = SimulatedClock()
        optics = OpticalBench(
            clock, seed=3, sample_axis=Still(), detector_axis=Still(), imperfections=Imperfections(lamp_drift=0.1)
        )
        optics.mount("spectralon")
        spectrometer = QEPro("spectrometer", clock, usb_backend=SimulatedQEPro(optics, clock))

        async def whole() -> list[Spectrum]:
            await spectrometer.open()
            await QEProLight(spectrometer).set_lamp(True)
            await QEProLight(spectrometer).set_shutter(True)
            result = await take(spectrometer)
            await spectrometer.close()
            return result

        return np.array([spectrum.counts for spectrum in asyncio.run(whole())])

    async def one_by_one(spectrometer: QEPro) -> list[Spectrum]:
        return [await spectrometer.expose(5.0) for _ in range(4)]

    together, apart = spectra(lambda spectrometer: spectrometer.sequence(5.0, 4)), spectra(one_by_one)
    np.testing.assert_array_equal(together, apart)
    assert not np.array_equal(together[0], together[1])


def test_spectra_that_are_collected_later_tell_when_they_began(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        single = await spectrometer.expose(0.2)
        assert single.began == pytest.approx(bench.clock.now() - 0.2)
        begin = bench.clock.now()
        begun = await spectrometer.begin_sequence(0.5, 8)
        assert bench.clock.now() == begin, "it does not wait"
        await bench.clock.sleep(2.3)  # longer than some of them, and shorter than all
        spectra = await spectrometer.collect_sequence(begun)
        assert bench.clock.now() == pytest.approx(begin + 4.0)
        assert [s.began for s in spectra] == pytest.approx([begin + 0.5 * i for i in range(8)], abs=1e-5)
        assert [s.count - spectra[0].count for s in spectra] == list(range(8))
        bench.simulator.faults.slowness = 1.1
        begun = await spectrometer.begin_sequence(0.5, 3)
        begin = bench.clock.now()
        began = [s.began for s in await spectrometer.collect_sequence(begun)]
        assert began == pytest.approx([begin, begin + 0.55, begin + 1.1], abs=1e-5), "its own ticks count"

    bench.run(scenario)


def test_a_wrong_spectrum_of_those_collected_later_is_an_error_and_not_taken_again(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        for fault in ("stale_spectra", "repeated_spectra", "other_modes"):
            begun = await spectrometer.begin_sequence(0.5, 3)
            setattr(bench.simulator.faults, fault, 1)
            begin = bench.clock.now()
            with pytest.raises(ProtocolError, match="spectr"):
                await spectrometer.collect_sequence(begun)
            assert bench.clock.now() == pytest.approx(begin + 1.5)
            assert len(await spectrometer.sequence(0.5, 2)) == 2, "the device can be used again"

    bench.run(scenario)


def test_a_sequence_with_a_hole_is_not_taken_for_a_whole_one(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        for fault in ("stale_spectra", "repeated_spectra", "other_modes"):
            setattr(bench.simulator.faults, fault, 1)
            spectra = await spectrometer.sequence(0.3, 3)
            counts = [spectrum.count for spectrum in spectra]
            assert counts == list(range(counts[0], counts[0] + 3))
            assert all(spectrum.counts[1] == 1300 for spectrum in spectra)
        read_out, taken = bench.detector.read_out, []

        def lose_the_second(*arguments: float, **settings: Any) -> CountArray:
            taken.append(arguments)
            bench.simulator.faults.lost_spectra = int(len(taken) == 2)
            return read_out(*arguments, **settings)

        bench.detector.read_out = lose_the_second
        counts = [spectrum.count for spectrum in await spectrometer.sequence(0.3, 3)]
        assert counts == list(range(counts[0], counts[0] + 3))
        assert len(taken) == 7, "three that were kept and one that was lost, then three anew"
        with pytest.raises(DeviceRefused, match="1 to 50000"):
            await spectrometer.sequence(0.3, 50_001)
        bench.simulator.slow()
        with pytest.raises(DeviceTimeout, match="spectrum 1 of 3"):
            await spectrometer.sequence(5.0, 3)

    bench.run(scenario)


def test_a_restarted_device_is_not_measured_with_until_it_is_opened_again(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        await QEProLight(spectrometer).set_lamp(True)
        await spectrometer.expose(0.1)
        bench.simulator.restart()
        for _ in range(2):
            with pytest.raises(DeviceFault, match="was restarted; reopen it"):
                await spectrometer.expose(0.1)
        await spectrometer.open()
        assert (await spectrometer.expose(0.1)).counts[1] == 1100, "the lamp is off after a restart"

    bench.run(scenario)


def test_a_spectrum_of_a_detector_that_got_warm_is_not_delivered(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        assert set(bench.detector.temperatures) == {-10.0}, "a stable cooler always gives the same dark current"
        bench.simulator.drift()
        await bench.clock.sleep(60)
        with pytest.raises(DeviceFault, match=r"-9\.00 °C instead of -10 °C"):
            await spectrometer.expose(0.1)
        with pytest.raises(DeviceFault, match="thrown away"):
            await spectrometer.sequence(0.1, 2)
        bench.simulator.faults.offset = 0.0
        await spectrometer.wait_until_cold()
        assert await spectrometer.temperature() == pytest.approx(-10, abs=0.1)
        await spectrometer.expose(0.1)

    bench.run(scenario)


@pytest.mark.parametrize(("setting", "what"), [(0x00420011, "cooler set point"), (0x00420010, "cooler")])
def test_a_cooler_that_says_yes_and_does_nothing_is_noticed(setting: int, what: str) -> None:
    bench = Bench(cooler_set_point=-15.0)
    bench.simulator.faults.ignored = {setting}
    with pytest.raises(DeviceFault, match=f"acknowledged a {what} of"):
        asyncio.run(bench.spectrometer.open())


@pytest.mark.parametrize("setting", [0x00110010, 0x00100832])
def test_an_integration_time_or_buffer_size_that_is_not_made_is_noticed(bench: Bench, setting: int) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.faults.ignored = {setting}
        with pytest.raises(DeviceFault, match="reads back"):
            await spectrometer.sequence(0.7, 2)

    bench.run(scenario)


def test_a_lamp_that_does_not_switch_is_noticed_unless_the_firmware_cannot_tell(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        light = QEProLight(spectrometer)
        bench.simulator.faults.ignored = {0x00110410}
        with pytest.raises(DeviceFault, match="lamp of 01 and reads back 00"):
            await light.set_lamp(True)
        bench.simulator.faults.ignored = set()
        bench.simulator.faults.unknown = {0x00110400, 0x00110100, 0x00000080}
        await light.set_lamp(True)
        assert bench.simulator.lamp_on
        await spectrometer.open()
        assert await spectrometer.identity() == "Ocean Optics QE Pro QEP00001"

    bench.run(scenario)


@pytest.mark.parametrize("coefficient", [float("nan"), float("inf")])
def test_coefficients_that_are_no_numbers_are_refused_when_opening(bench: Bench, coefficient: float) -> None:
    bench.detector.nonlinearity_coefficients = (0.875, coefficient, 0, 0, 0, 0, 0, 0)
    with pytest.raises(DeviceFault, match="recalibrated"):
        asyncio.run(bench.spectrometer.open())


@pytest.mark.parametrize("coefficients", [(0.0,) * 4, (1000.0, -0.8, 0.0, 0.0), (300.0, 0.8, -1e-3, 0.0)])
def test_wavelengths_that_do_not_increase_are_refused_when_opening(
    bench: Bench, coefficients: tuple[float, float, float, float]
) -> None:
    bench.detector.wavelength_coefficients = coefficients
    with pytest.raises(DeviceFault, match="do not increase"):
        asyncio.run(bench.spectrometer.open())


def test_a_triggered_exposure_waits_for_its_pulse_and_not_for_ever(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        for mode in (TriggerMode.LEVEL, TriggerMode.EDGE):
            begin = bench.clock.now()
            exposure = asyncio.create_task(spectrometer.expose_on_trigger(mode, 0.5, within=30.0))
            while bench.clock.now() < begin + 5:  # noqa: ASYNC110 - a clock has no event
                await asyncio.sleep(0.001)
            bench.simulator.trigger()
            spectrum = await exposure
            assert spectrum.counts[0] >= round(100 * (begin + 5.5)) - 1
            assert spectrum.integration_time == 0.5
            begin = bench.clock.now()
            with pytest.raises(DeviceTimeout, match=r"within 3 s of waiting for a trigger"):
                await spectrometer.expose_on_trigger(mode, 0.5, within=3.0)
            assert 3 <= bench.clock.now() - begin < 8
            assert (await spectrometer.expose(0.1)).counts[1] == 1100

    bench.run(scenario)


def test_pins_are_set_where_the_mask_says_and_read_back(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.gpio_inputs = 0b1000
        await spectrometer.set_gpio_outputs(0b0011, mask=0b0111)
        await spectrometer.set_gpio_levels(0b0010, mask=0b0011)
        assert await spectrometer.gpio() == Gpio(outputs=0b0011, levels=0b1010)
        await spectrometer.set_gpio_levels(0b0001, mask=0b0001)
        assert (await spectrometer.gpio()).levels == 0b1011
        with pytest.raises(DeviceFault, match="GPIO level"):
            await spectrometer.set_gpio_levels(0b0100, mask=0b0100)  # an input cannot be driven
        with pytest.raises(DeviceRefused, match="invalid"):
            await spectrometer.set_gpio_outputs(1 << 20, mask=1 << 20)

    bench.run(scenario)


def test_a_cancelled_exposure_aborts_the_integration_and_nothing_has_to_wait_for_it(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        for take in (lambda: spectrometer.expose(600.0), lambda: spectrometer.sequence(600.0, 3)):
            bench.clock.hold = True
            exposure = asyncio.create_task(take())
            while not bench.simulator.integrating:  # noqa: ASYNC110 - nor has a device
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.05)
            begin = bench.clock.now()
            exposure.cancel()
            with pytest.raises(asyncio.CancelledError):
                await exposure
            bench.clock.hold = False
            assert not bench.simulator.integrating
            await QEProLight(spectrometer).set_shutter(False)
            assert bench.clock.now() - begin < 1

    bench.run(scenario)


@pytest.mark.parametrize("message", [1, 4, 6])
def test_unplugging_is_noticed_and_the_device_works_after_reopening(bench: Bench, message: int) -> None:
    async def expose_often(spectrometer: QEPro) -> None:
        for _ in range(5):
            await spectrometer.expose(0.1)

    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.script = FaultScript.parse(f"at {message} unplug 1000 s")
        with pytest.raises(DeviceDisconnected, match="gone from USB"):
            await expose_often(spectrometer)
        await spectrometer.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await spectrometer.expose(0.1)
        with pytest.raises(DeviceNotFound):
            await spectrometer.open()
        bench.simulator.plug_in()
        await spectrometer.open()
        assert (await spectrometer.expose(0.1)).integration_time == 0.1

    bench.run(scenario)


def test_nothing_is_left_running_when_the_device_is_closed_in_any_state(bench: Bench) -> None:
    async def scenario() -> None:
        spectrometer = bench.spectrometer
        before = set(threading.enumerate())
        await spectrometer.close()
        await spectrometer.open()
        bench.simulator.unplug()
        await spectrometer.close()
        await spectrometer.close()
        with pytest.raises(DeviceDisconnected, match="not open"):
            await spectrometer.temperature()
        with pytest.raises(DeviceNotFound):
            await spectrometer.open()
        bench.simulator.plug_in()
        opening = asyncio.create_task(spectrometer.open())
        await asyncio.sleep(0.02)
        opening.cancel()
        await asyncio.gather(opening, return_exceptions=True)
        await spectrometer.close()
        deadline = time.monotonic() + 60
        while not set(threading.enumerate()) <= before:
            assert time.monotonic() < deadline, "a thread is left"
            await asyncio.sleep(0.01)

    asyncio.run(scenario())
