"""The QE Pro driver delivers the spectrum that was asked for, or says why not."""

import asyncio
from collections.abc import Awaitable, Callable

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
from drivers.interfaces import Light, Spectrometer
from drivers.qepro import QEPro, QEProLight
from simulators.clock import SimulatedClock
from simulators.qepro import SimulatedQEPro


class Glow:
    """A detector whose counts tell the integration time, the moment, the shutter and the lamp."""

    pixels = 1044
    wavelength_coefficients = (345.25, 0.8, -1e-5, -2e-9)

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock
        self.nonlinearity_coefficients: tuple[float, ...] = (0.875, 2.0**-20, 0, 0, 0, 0, 0, 0)

    def read_out(self, integration_time: float, *, shutter_open: bool, lamp_on: bool) -> CountArray:
        counts = np.full(self.pixels, 1000 + 1000 * integration_time + 100 * shutter_open + 200 * lamp_on)
        counts[0] = round(self.clock.now())
        return counts.astype(np.uint32)


class Bench:
    """A simulated spectrometer, and the driver connected to it."""

    def __init__(self, packet_size: int = 512) -> None:
        self.clock = SimulatedClock()
        self.detector = Glow(self.clock)
        self.simulator = SimulatedQEPro(self.detector, self.clock, packet_size=packet_size)
        self.spectrometer = QEPro("spectrometer", self.clock, usb_backend=self.simulator)

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
        assert await spectrometer.identity() == "Ocean Optics QE Pro QEP00001"

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
        assert spectrum.counts[0] == round(bench.clock.now())
        assert bench.clock.now() > begin
        setattr(bench.simulator.faults, fault, 1000)
        with pytest.raises(ProtocolError, match="4 stale spectra"):
            await spectrometer.expose(0.1)

    bench.run(scenario)


@pytest.mark.parametrize("seconds", [0.0079, 1600.0, float("nan")])
def test_an_impossible_integration_time_is_refused_with_the_limits(bench: Bench, seconds: float) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.faults.silent = True  # a message sent would now end in a timeout
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


def test_replies_to_earlier_requests_are_skipped_but_not_for_ever(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.faults.foreign_replies = 3
        assert (await spectrometer.expose(0.1)).counts[1] == 1100
        bench.simulator.faults.foreign_replies = 8
        with pytest.raises(ProtocolError, match="8 other requests"):
            await spectrometer.expose(0.1)

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
        bench.simulator.faults.silent = True
        with pytest.raises(DeviceTimeout, match="no answer on USB"):
            await spectrometer.expose(0.1)
        bench.simulator.faults.silent = False
        assert (await spectrometer.expose(0.1)).integration_time == 0.1

    bench.run(scenario)


@pytest.mark.parametrize("packets", [0, 3, 12])
def test_unplugging_at_any_moment_is_noticed_and_the_device_works_after_reopening(bench: Bench, packets: int) -> None:
    async def expose_often(spectrometer: QEPro) -> None:
        for _ in range(5):
            await spectrometer.expose(0.1)

    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.packets_until_unplugged = packets
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


def test_a_torn_reply_does_not_spoil_the_next(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.packets_to_lose = 1
        with pytest.raises(DriverError):
            await spectrometer.expose(0.1)
        bench.simulator.packets_to_lose = 0
        assert (await spectrometer.expose(0.1)).counts[1] == 1100

    bench.run(scenario)


def test_a_hardware_fault_is_told_apart_from_a_refusal(bench: Bench) -> None:
    async def scenario(spectrometer: QEPro) -> None:
        bench.simulator.faults.broken = True
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
