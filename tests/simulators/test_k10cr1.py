"""The simulated K10CR1 is driven by an independent client, the package `thorlabs-apt-protocol`, as it is."""

from collections.abc import Iterator
from typing import Any

import pytest
import serial
import thorlabs_apt_protocol as thorlabs

from simulators.devices.clock import SimulatedClock
from simulators.devices.k10cr1 import SimulatedK10CR1
from simulators.devices.motion import Axis

MOUNT, PC, CHANNEL = 0x50, 0x01, 1
COUNTS_PER_DEGREE = 136533.33333
"""Published by several drivers that people run on real mounts, as are the next two."""
VELOCITY_PER_DEGREE = 7329109
ACCELERATION_PER_DEGREE = 1502


class Client:
    """Somebody who knows the protocol only from that package."""

    def __init__(self, url: str) -> None:
        self._port = serial.serial_for_url(url, baudrate=115200, rtscts=True, timeout=5)
        self._unpacker = thorlabs.Unpacker(self._port, on_error="raise")

    def send(self, message: bytes) -> None:
        self._port.write(message)

    def ask(self, message: bytes, name: str) -> Any:
        """The first answer called `name`; whatever comes before it is in `self.before`."""
        self.send(message)
        self.before = []
        for answer in self._unpacker:
            if answer.msg == name:
                return answer
            self.before.append(answer)
        raise AssertionError(f"no {name}, only {self.before}")

    def status(self) -> Any:
        return self.ask(thorlabs.mot_req_statusupdate(MOUNT, PC, CHANNEL), "mot_get_statusupdate")

    def close(self) -> None:
        self._port.close()


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def simulator(clock: SimulatedClock) -> Iterator[SimulatedK10CR1]:
    axis = Axis(clock, start=12.0, velocity=10, acceleration=10, limits=(-10, 100))
    simulator = SimulatedK10CR1(axis, serial_number=55123456)
    yield simulator
    simulator.close()


@pytest.fixture
def client(simulator: SimulatedK10CR1) -> Iterator[Client]:
    client = Client(simulator.start())
    yield client
    client.close()


def home(client: Client, clock: SimulatedClock) -> None:
    """Home with a velocity at which it ends soon."""
    velocity = 5 * VELOCITY_PER_DEGREE
    client.send(thorlabs.mot_set_homeparams(MOUNT, PC, CHANNEL, 2, 1, velocity, round(4 * COUNTS_PER_DEGREE)))
    client.send(thorlabs.mot_move_home(MOUNT, PC, CHANNEL))
    while not client.status().homed:
        clock.advance_to(clock.now() + 1)


def test_another_program_recognises_the_mount(client: Client) -> None:
    info = client.ask(thorlabs.hw_req_info(MOUNT, PC), "hw_get_info")
    assert info.serial_number == 55123456
    assert info.model_number.rstrip(b"\0") == b"K10CR1"
    assert info.nchs == 1
    client.send(thorlabs.mod_identify(MOUNT, PC, CHANNEL))
    state = client.ask(thorlabs.mod_req_chanenablestate(MOUNT, PC, CHANNEL), "mod_get_chanenablestate")
    assert state.enabled


def test_another_program_homes_moves_and_is_told_when_it_is_done(client: Client, clock: SimulatedClock) -> None:
    status = client.status()
    assert status.channel_enabled
    assert not status.homed
    home(client, clock)
    assert [message.msg for message in client.before] == ["mot_move_homed"]
    client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(30 * COUNTS_PER_DEGREE)))
    status = client.status()
    assert status.moving_forward
    assert not status.homing
    clock.advance_to(clock.now() + 30 / 10 + 10 / 10 + 0.01)  # both ramps and the cruise
    status = client.status()
    assert not status.moving_forward
    assert status.position == pytest.approx(30 * COUNTS_PER_DEGREE, abs=1)
    (completed,) = client.before
    assert completed.msg == "mot_move_completed"
    assert completed.position == status.position
    assert completed.homed


def test_on_the_way_back_it_passes_its_target_unless_it_is_told_not_to(client: Client, clock: SimulatedClock) -> None:
    home(client, clock)
    query = thorlabs.mot_req_genmoveparams(MOUNT, PC, CHANNEL), "mot_get_genmoveparams"
    for distance in (client.ask(*query).backlash_distance, 0):
        client.send(thorlabs.mot_set_genmoveparams(MOUNT, PC, CHANNEL, distance))
        assert client.ask(*query).backlash_distance == distance
        client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(20 * COUNTS_PER_DEGREE)))
        client.status()  # a command that is answered by nothing may take effect late; once this is answered it has
        clock.advance_to(clock.now() + 10)
        client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(10 * COUNTS_PER_DEGREE)))
        lowest = 20 * COUNTS_PER_DEGREE
        for _ in range(60):
            lowest = min(lowest, client.status().position)
            clock.advance_to(clock.now() + 0.1)
        assert lowest == pytest.approx(10 * COUNTS_PER_DEGREE - distance, abs=600)
        assert client.status().position == pytest.approx(10 * COUNTS_PER_DEGREE, abs=1)


def test_another_program_stops_it_on_its_way(client: Client, clock: SimulatedClock) -> None:
    home(client, clock)
    client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(80 * COUNTS_PER_DEGREE)))
    assert client.status().moving_forward
    clock.advance_to(clock.now() + 2)
    client.send(thorlabs.mot_move_stop(MOUNT, PC, CHANNEL, 2))
    assert client.status().moving_forward, "it brakes"
    clock.advance_to(clock.now() + 2)
    status = client.status()
    assert not status.moving_forward
    # a ramp and a second of cruise, then a ramp down
    assert status.position == pytest.approx((5 + 10 + 5) * COUNTS_PER_DEGREE, abs=2)
    assert [message.msg for message in client.before] == ["mot_move_stopped"]


def test_settings_have_the_published_units_and_the_mounts_own_bounds(client: Client) -> None:
    query = thorlabs.mot_req_velparams(MOUNT, PC, CHANNEL), "mot_get_velparams"
    setting = client.ask(*query)
    assert setting.max_velocity == pytest.approx(10 * VELOCITY_PER_DEGREE, rel=1e-4)
    assert setting.acceleration == pytest.approx(10 * ACCELERATION_PER_DEGREE, rel=1e-4)
    client.send(thorlabs.mot_set_velparams(MOUNT, PC, CHANNEL, 0, 5 * 1502, 50 * VELOCITY_PER_DEGREE))
    setting = client.ask(*query)
    assert setting.acceleration == 5 * 1502
    assert setting.max_velocity == pytest.approx(10 * VELOCITY_PER_DEGREE, rel=1e-4)


def test_after_a_power_cut_it_counts_from_where_it_stands_and_homes_too_slowly(
    client: Client, clock: SimulatedClock, simulator: SimulatedK10CR1
) -> None:
    home(client, clock)
    client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(20 * COUNTS_PER_DEGREE)))
    assert client.status().moving_forward
    clock.advance_to(clock.now() + 10)
    simulator.restart()
    status = client.status()
    assert (status.homed, status.position) == (False, 0)
    client.send(thorlabs.mot_move_home(MOUNT, PC, CHANNEL))
    clock.advance_to(clock.now() + 600)
    assert client.status().homing


def test_a_jammed_mount_says_so_until_it_is_disabled_and_enabled(
    client: Client, clock: SimulatedClock, simulator: SimulatedK10CR1
) -> None:
    home(client, clock)
    simulator.jam()
    assert client.status().motion_error
    client.send(thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(20 * COUNTS_PER_DEGREE)))
    assert not client.status().moving_forward
    client.send(thorlabs.mod_set_chanenablestate(MOUNT, PC, CHANNEL, 2))
    assert not client.status().channel_enabled
    client.send(thorlabs.mod_set_chanenablestate(MOUNT, PC, CHANNEL, 1))
    status = client.status()
    assert status.channel_enabled
    assert not status.motion_error


def test_a_refused_command_is_named_and_not_carried_out(
    client: Client, clock: SimulatedClock, simulator: SimulatedK10CR1
) -> None:
    home(client, clock)
    simulator.refuse()
    move = thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, round(20 * COUNTS_PER_DEGREE))
    assert client.ask(move, "hw_richresponse").msg_ident == 0x0453
    assert not client.status().moving_forward


def test_status_comes_unasked_where_somebody_has_asked_for_that(client: Client) -> None:
    client.send(thorlabs.hw_start_updatemsgs(MOUNT, PC))
    client.ask(thorlabs.hw_req_info(MOUNT, PC), "hw_get_info")
    assert {message.msg for message in client.before} == {"mot_get_statusupdate"}


def test_bytes_that_belong_to_no_request_are_passed_over(client: Client) -> None:
    client.send(b"\x00\xff noise \x50\x01")
    assert client.status().position == 0
