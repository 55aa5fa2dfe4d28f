"""The simulated AZ is driven by a plain Modbus client that knows nothing of our driver."""

from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusTcpClient

from simulators.clock import SimulatedClock
from simulators.motion import Axis
from simulators.oriental_az import SimulatedOrientalAZ


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def simulator(clock: SimulatedClock) -> Iterator[SimulatedOrientalAZ]:
    axis = Axis(clock, start=-3.0, velocity=10, acceleration=20, limits=(-90, 180))
    simulator = SimulatedOrientalAZ(axis)
    yield simulator
    simulator.close()


@pytest.fixture
def client(simulator: SimulatedOrientalAZ) -> Iterator[ModbusTcpClient]:
    host, port = simulator.start()
    client = ModbusTcpClient(host, port=port, timeout=1)
    assert client.connect()
    yield client
    client.close()


def output(client: ModbusTcpClient) -> int:
    return client.read_holding_registers(0x7F, count=1, device_id=1).registers[0]


def position(client: ModbusTcpClient) -> int:
    registers = client.read_holding_registers(0xCC, count=2, device_id=1).registers
    return client.convert_from_registers(registers, client.DATATYPE.INT32)


def motion(client: ModbusTcpClient, steps: int, speed: int = 2000, trigger: int = 1) -> list[int]:
    values = [0, 1, steps, speed, 3000, 3000, 1000, trigger, 0]
    return [word for value in values for word in client.convert_to_registers(value, client.DATATYPE.INT32)]


def test_direct_data_operation_moves_the_axis(clock: SimulatedClock, client: ModbusTcpClient) -> None:
    assert position(client) == -300
    assert output(client) & 1 << 5
    client.write_registers(0x58, motion(client, -4500), device_id=1)
    assert output(client) & 1 << 13
    # 42 degrees at 20 degrees/s with ramps at 30 degrees/s^2: 42 / 20 + 20 / 30 s
    clock.advance_to(2.766)
    assert output(client) & 1 << 13
    clock.advance_to(2.768)
    assert not output(client) & 1 << 13
    assert output(client) & 1 << 14
    assert position(client) == -4500


def test_data_without_a_trigger_moves_nothing(clock: SimulatedClock, client: ModbusTcpClient) -> None:
    client.write_registers(0x58, motion(client, 1000, trigger=0), device_id=1)
    clock.advance_to(10)
    assert position(client) == -300


def test_home_and_stop_act_on_rising_edges(clock: SimulatedClock, client: ModbusTcpClient) -> None:
    client.write_register(0x7D, 1 << 4, device_id=1)
    client.write_register(0x7D, 0, device_id=1)
    clock.advance_to(10)
    assert position(client) == 0
    assert output(client) & 1 << 4
    client.write_registers(0x58, motion(client, 9000), device_id=1)
    clock.advance_to(11)
    client.write_register(0x7D, 1 << 5, device_id=1)
    client.write_registers(0x58, motion(client, 9000), device_id=1)
    clock.advance_to(60)
    assert 0 < position(client) < 9000, "no motion begins while the stop bit is set"


def test_a_target_beyond_the_travel_raises_an_alarm_until_it_is_reset(
    clock: SimulatedClock, client: ModbusTcpClient
) -> None:
    client.write_registers(0x58, motion(client, 18001), device_id=1)
    assert output(client) & 1 << 7
    assert client.read_holding_registers(0x80, count=2, device_id=1).registers == [0, 0x67]
    client.write_register(0x7D, 1 << 7, device_id=1)
    assert not output(client) & 1 << 7


def test_registers_and_values_that_do_not_exist_are_answered_with_an_exception(client: ModbusTcpClient) -> None:
    assert client.read_holding_registers(0x200, count=1, device_id=1).exception_code == 2
    assert client.write_registers(0x58, motion(client, 100, speed=0), device_id=1).exception_code == 3
