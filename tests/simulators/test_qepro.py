"""The simulated QE Pro is read by seabreeze, which knows nothing of our driver, and both agree."""

import asyncio
import struct
import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest
import usb.core

from drivers.arrays import CountArray
from drivers.obp import ACK_REQUESTED, NACK, Message, decode, encode
from drivers.qepro import QEPro
from simulators.devices.clock import SimulatedClock
from simulators.devices.qepro import SimulatedQEPro


class Ramp:
    """A detector whose counts tell the integration time, the shutter and the lamp."""

    pixels = 1044
    wavelength_coefficients = (345.25, 0.8, -1e-5, -2e-9)
    nonlinearity_coefficients = (0.875, 1e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float, ended: float
    ) -> CountArray:
        light = 1e5 * integration_time * shutter_open * lamp_on
        return (1500 + light + np.arange(self.pixels)).astype(np.uint32)


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


def talk(simulator: SimulatedQEPro, message_type: int, payload: bytes = b"", size: int = 512) -> Message:
    """One exchange through pyusb, without our driver."""
    device = usb.core.find(idVendor=0x2457, idProduct=0x4004, backend=simulator)
    device.set_configuration()
    device.write(0x01, encode(Message(message_type, 7, ACK_REQUESTED, 0, payload)), 1000)
    return decode(device.read(0x81, size, 1000).tobytes())


@pytest.fixture
def seabreeze_backend() -> Iterator[str]:
    """A name under which seabreeze finds a pyusb backend that the test puts there."""
    name = "simulated_qepro"
    sys.modules[f"usb.backend.{name}"] = ModuleType(name)
    yield name
    del sys.modules[f"usb.backend.{name}"]


def test_seabreeze_reads_the_same_instrument_as_our_driver(clock: SimulatedClock, seabreeze_backend: str) -> None:
    import seabreeze  # noqa: PLC0415 - seabreeze chooses its backend when it is first used

    # seabreeze reads 64 bytes at a time, which only full-speed USB delivers without overflow
    simulator = SimulatedQEPro(Ramp(), clock, serial_number="QEP04242", packet_size=64)
    vars(sys.modules[f"usb.backend.{seabreeze_backend}"])["get_backend"] = lambda: simulator
    seabreeze.use("pyseabreeze", pyusb_backend=seabreeze_backend)
    from seabreeze.spectrometers import Spectrometer, list_devices  # noqa: PLC0415

    talk(simulator, 0x00110410, b"\x01")
    talk(simulator, 0x00110610, b"\x01")
    assert [device.serial_number for device in list_devices()] == ["QEP04242"]
    theirs = Spectrometer.from_serial_number("QEP04242")
    assert theirs.model == "QEPRO"
    theirs.integration_time_micros(250_000)
    stale = theirs.intensities()
    their_counts, their_wavelengths = theirs.intensities(), theirs.wavelengths()
    theirs.close()
    assert stale[0] == 1500 + 1e5 * 0.1, "the first spectrum after a change is one of the old time"

    async def read_ours() -> tuple[str, np.ndarray, np.ndarray]:
        ours = QEPro("spectrometer", clock, serial_number="QEP04242", usb_backend=simulator)
        await ours.open()
        spectrum = await ours.expose(0.25)
        result = await ours.identity(), spectrum.counts, await ours.wavelengths()
        await ours.close()
        return result

    identity, counts, wavelengths = asyncio.run(read_ours())
    assert "QEP04242" in identity
    np.testing.assert_array_equal(counts, their_counts)
    np.testing.assert_allclose(wavelengths, their_wavelengths, rtol=1e-12)


def test_a_read_smaller_than_a_packet_overflows_as_on_a_real_bus(clock: SimulatedClock) -> None:
    with pytest.raises(usb.core.USBError, match="Overflow"):
        talk(SimulatedQEPro(Ramp(), clock), 0x00000100, size=32)


def test_integrating_takes_simulated_time(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    assert len(talk(simulator, 0x00100928, size=8192).payload) == 32 + 4 * 1044
    assert clock.now() == pytest.approx(0.1)


def test_saturated_pixels_stop_at_the_limit_of_the_converter(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    for message_type, payload in {0x00110410: b"\x01", 0x00110610: b"\x01"}.items():
        talk(simulator, message_type, payload)
    talk(simulator, 0x00110010, struct.pack("<L", 3_000_000))
    talk(simulator, 0x00100830)
    device = usb.core.find(idVendor=0x2457, backend=simulator)
    device.write(0x01, encode(Message(0x00100928, 9)), 1000)
    payload = decode(device.read(0x81, 8192, 5000).tobytes()).payload
    np.testing.assert_array_equal(np.frombuffer(payload, "<u4", offset=32), 200_000)


def test_the_cooler_needs_its_time(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    talk(simulator, 0x00420011, struct.pack("<f", -15.0))
    talk(simulator, 0x00420010, b"\x01")
    assert struct.unpack("<f", talk(simulator, 0x00420004).payload)[0] == pytest.approx(25, abs=0.1)
    assert talk(simulator, 0x00420003).payload == b"\x00"
    clock.advance_to(clock.now() + 15)
    # one time constant on the way from 25 to -15 degrees Celsius
    assert struct.unpack("<f", talk(simulator, 0x00420004).payload)[0] == pytest.approx(-15 + 40 / np.e, abs=0.1)
    clock.advance_to(clock.now() + 200)
    assert talk(simulator, 0x00420003).payload == b"\x01"


def test_what_the_device_does_not_know_is_refused_with_the_reason(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    for message_type, payload, error in (
        (0x00000BAD, b"", 2),
        (0x00110010, b"\x00", 5),
        (0x00110010, struct.pack("<L", 7_999), 6),
        (0x00180101, b"\x04", 12),
    ):
        reply = talk(simulator, message_type, payload)
        assert reply.flags & NACK
        assert reply.error == error


def test_the_buffer_fills_back_to_back_until_it_is_full_and_gives_the_oldest_first(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    talk(simulator, 0x00100832, struct.pack("<L", 3))
    talk(simulator, 0x00100902)
    assert talk(simulator, 0x00100908).payload == b"\x00"
    for waited, there in ((0.15, 1), (0.1, 2), (5.0, 3)):
        clock.advance_to(clock.now() + waited)
        assert talk(simulator, 0x00100900).payload == struct.pack("<L", there)
    assert talk(simulator, 0x00100908).payload == b"\x01"
    numbers = [struct.unpack_from("<LQLHB", talk(simulator, 0x00100928, size=8192).payload)[0] for _ in range(3)]
    assert numbers == [1, 2, 3]
    talk(simulator, 0x00100830)
    assert talk(simulator, 0x00100900).payload == bytes(4)


def test_a_restart_forgets_all_settings_and_starts_counting_again(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    talk(simulator, 0x00110410, b"\x01")
    talk(simulator, 0x00420010, b"\x01")
    talk(simulator, 0x00110010, struct.pack("<L", 250_000))
    talk(simulator, 0x00100928, size=8192)
    clock.advance_to(200.0)
    simulator.restart()
    assert talk(simulator, 0x00110400).payload == b"\x00"
    assert talk(simulator, 0x00420000).payload == b"\x00"
    assert talk(simulator, 0x00110000).payload == struct.pack("<L", 100_000)
    count, tick = struct.unpack_from("<LQ", talk(simulator, 0x00100928, size=8192).payload)
    assert (count, tick) == (1, 100_000)


def test_an_uncooled_sensor_is_read_out_at_its_own_temperature(clock: SimulatedClock) -> None:
    class Thermometer(Ramp):
        def read_out(
            self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float, ended: float
        ) -> CountArray:
            return np.full(self.pixels, round(100 + sensor_temperature), dtype=np.uint32)

    simulator = SimulatedQEPro(Thermometer(), clock)
    for enable, expected in ((b"\x00", 125), (b"\x01", 90)):
        talk(simulator, 0x00420010, enable)
        clock.advance_to(clock.now() + 200)
        payload = talk(simulator, 0x00100928, size=8192).payload
        assert struct.unpack_from("<L", payload, 32)[0] == expected


def test_a_poor_cooler_wanders_around_its_set_point_and_calls_that_stable(clock: SimulatedClock) -> None:
    simulator = SimulatedQEPro(Ramp(), clock)
    simulator.faults.ripple = 0.4
    talk(simulator, 0x00420010, b"\x01")
    for moment, expected in ((250.0, -9.6), (500.0, -10.0), (750.0, -10.4)):
        clock.advance_to(moment)
        assert struct.unpack("<f", talk(simulator, 0x00420004).payload)[0] == pytest.approx(expected, abs=1e-4)
        assert talk(simulator, 0x00420003).payload == b"\x01"
