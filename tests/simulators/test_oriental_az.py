"""The simulated AZ is driven by plain Modbus clients that know nothing of our driver."""

import socket
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.pdu.diag_message import ReturnQueryDataResponse

from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from simulators.devices.motion import Axis
from simulators.devices.oriental_az import SimulatedOrientalAZ

Client = ModbusTcpClient | ModbusSerialClient


def tcp_client(simulator: SimulatedOrientalAZ) -> Client:
    address = urlsplit(simulator.start())
    assert address.hostname
    assert address.port
    return ModbusTcpClient(address.hostname, port=address.port, timeout=1, retries=0)


def rtu_client(simulator: SimulatedOrientalAZ) -> Client:
    return ModbusSerialClient(simulator.start().removeprefix("rtu+"), timeout=1, retries=0)


def terminal_client(simulator: SimulatedOrientalAZ) -> Client:
    pytest.importorskip("termios")
    return ModbusSerialClient(simulator.start_pty(), baudrate=115200, timeout=1, retries=0)


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture(params=[tcp_client, rtu_client, terminal_client])
def connect(request: pytest.FixtureRequest) -> Callable[[SimulatedOrientalAZ], Client]:
    connect: Callable[[SimulatedOrientalAZ], Client] = request.param
    return connect


@pytest.fixture
def simulator(clock: SimulatedClock, connect: Callable[[SimulatedOrientalAZ], Client]) -> Iterator[SimulatedOrientalAZ]:
    axis = Axis(clock, start=-3.0, velocity=10, acceleration=20, limits=(-90, 180))
    simulator = SimulatedOrientalAZ(axis, rtu=connect is not tcp_client)
    yield simulator
    simulator.close()


@pytest.fixture
def client(simulator: SimulatedOrientalAZ, connect: Callable[[SimulatedOrientalAZ], Client]) -> Iterator[Client]:
    client = connect(simulator)
    assert client.connect()
    yield client
    client.close()


def output(client: Client) -> int:
    return client.read_holding_registers(0x7F, count=1, device_id=1).registers[0]


def position(client: Client) -> int:
    registers = client.read_holding_registers(0xCC, count=2, device_id=1).registers
    steps = client.convert_from_registers(registers, client.DATATYPE.INT32)
    assert isinstance(steps, int)
    return steps


def motion(client: Client, steps: int, speed: int = 2000, trigger: int = 1) -> list[int]:
    values = [0, 1, steps, speed, 3000, 3000, 1000, trigger, 0]
    return [word for value in values for word in client.convert_to_registers(value, client.DATATYPE.INT32)]


def test_direct_data_operation_moves_the_axis(clock: SimulatedClock, client: Client) -> None:
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


def test_data_without_a_trigger_moves_nothing(clock: SimulatedClock, client: Client) -> None:
    client.write_registers(0x58, motion(client, 1000, trigger=0), device_id=1)
    clock.advance_to(10)
    assert position(client) == -300


def test_home_and_stop_act_on_rising_edges(clock: SimulatedClock, client: Client) -> None:
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


def test_a_target_beyond_the_travel_raises_an_alarm_until_it_is_reset(clock: SimulatedClock, client: Client) -> None:
    client.write_registers(0x58, motion(client, 18001), device_id=1)
    assert output(client) & 1 << 7
    assert client.read_holding_registers(0x80, count=2, device_id=1).registers == [0, 0x67]
    client.write_register(0x7D, 1 << 7, device_id=1)
    assert not output(client) & 1 << 7


def test_registers_and_values_that_do_not_exist_are_answered_with_an_exception(client: Client) -> None:
    assert client.read_holding_registers(0x200, count=1, device_id=1).exception_code == 2
    assert client.write_registers(0x58, motion(client, 100, speed=0), device_id=1).exception_code == 3


def test_what_is_sent_to_be_echoed_comes_back(client: Client) -> None:
    echo = client.diag_query_data(b"\x12\x34", device_id=1)
    assert isinstance(echo, ReturnQueryDataResponse)
    assert echo.message == b"\x12\x34"


def test_switching_off_and_on_forgets_all_data_but_not_where_the_stage_stands(
    simulator: SimulatedOrientalAZ, clock: SimulatedClock, client: Client
) -> None:
    client.write_registers(0x58, motion(client, 9000), device_id=1)
    clock.advance_to(2)
    simulator.restart()
    clock.advance_to(4)
    stopped = position(client)
    assert -300 < stopped < 9000
    assert client.read_holding_registers(0x58, count=18, device_id=1).registers == [0] * 18
    simulator.restart()
    assert position(client) == stopped


def test_a_jammed_motor_stands_still_with_an_alarm_until_it_is_reset(
    simulator: SimulatedOrientalAZ, clock: SimulatedClock, client: Client
) -> None:
    client.write_registers(0x58, motion(client, 9000), device_id=1)
    clock.advance_to(2)
    simulator.jam()
    clock.advance_to(4)
    stopped = position(client)
    assert output(client) & 1 << 7
    assert client.read_holding_registers(0x80, count=2, device_id=1).registers == [0, 0x10]
    client.write_registers(0x58, motion(client, 9000), device_id=1)
    clock.advance_to(6)
    assert position(client) == stopped
    client.write_register(0x7D, 1 << 7, device_id=1)
    assert output(client) & 1 << 5


def test_a_refused_write_is_answered_with_an_exception_and_not_carried_out(
    simulator: SimulatedOrientalAZ, clock: SimulatedClock, client: Client
) -> None:
    simulator.refuse()
    assert client.write_registers(0x58, motion(client, 9000), device_id=1).exception_code == 4
    clock.advance_to(10)
    assert position(client) == -300
    assert not client.write_registers(0x58, motion(client, 9000), device_id=1).isError()


def test_a_drifting_encoder_reads_too_much_and_a_slow_motor_takes_ten_times_as_long(
    simulator: SimulatedOrientalAZ, clock: SimulatedClock, client: Client
) -> None:
    simulator.drift()
    assert position(client) == -250
    simulator.slow()
    client.write_registers(0x58, motion(client, -4500), device_id=1)
    clock.advance_to(27.6)
    assert output(client) & 1 << 13
    clock.advance_to(27.7)
    assert not output(client) & 1 << 13


def test_faults_of_a_script_befall_the_requests_that_it_names(simulator: SimulatedOrientalAZ, client: Client) -> None:
    simulator.script = FaultScript.parse("at 2 drift\nat 3 refuse")
    assert position(client) == -300
    assert position(client) == -250
    assert client.write_register(0x7D, 0, device_id=1).exception_code == 4
    assert [request for request, _ in simulator.script.happened] == [2, 3]


@pytest.mark.parametrize("connect", [rtu_client])
def test_a_serial_line_is_silent_about_other_units_and_frames_with_a_wrong_checksum(
    simulator: SimulatedOrientalAZ,
) -> None:
    address = urlsplit(simulator.start().removeprefix("rtu+"))
    with socket.create_connection((address.hostname, address.port), timeout=1) as line:
        # checksums computed bit by bit after the "Modbus over serial line" specification, section 6.2.2
        line.sendall(bytes.fromhex("02 03 007F 0001 B5E1"))
        line.sendall(bytes.fromhex("01 03 007F 0001 B5D3"))
        line.sendall(bytes.fromhex("01 03 007F 0001 B5D2"))
        assert line.recv(100).hex() == "0103024020" + "885c"
        line.settimeout(0.05)
        with pytest.raises(TimeoutError):
            line.recv(100)
