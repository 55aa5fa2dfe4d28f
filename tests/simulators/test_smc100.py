"""The simulated SMC100 speaks as its manual says, to any serial client."""

import sys
from collections.abc import Iterator

import pytest
import serial

from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from simulators.devices.motion import Axis
from simulators.devices.smc100 import SimulatedSMC100


class Terminal:
    """A person at a serial terminal."""

    def __init__(self, url: str) -> None:
        self._port = serial.serial_for_url(url, baudrate=57600)

    def type(self, line: str, timeout: float = 5) -> str:
        """Send one line and return what comes back, "" for nothing within `timeout` seconds."""
        self._port.write(f"{line}\r\n".encode())
        self._port.timeout = timeout
        if self._answers(line):
            return self._port.read_until(b"\r\n").decode().removesuffix("\r\n")
        # a command has no reply; once a query behind it is answered it has been carried out
        self._port.write(b"1TP\r\n")
        assert self._port.read_until(b"\r\n").startswith(b"1TP")
        return ""

    @staticmethod
    def _answers(line: str) -> bool:
        return line[1:3] in {"TS", "TP", "TE", "VE"} or line.endswith("?")


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def simulator(clock: SimulatedClock) -> Iterator[SimulatedSMC100]:
    simulator = SimulatedSMC100(Axis(clock, start=7.0, velocity=10, acceleration=20, limits=(-10, 100)))
    yield simulator
    simulator.close()


@pytest.mark.parametrize(
    "way",
    ["tcp", pytest.param("pty", marks=pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"))],
)
def test_a_dialog_by_hand_homes_and_moves(clock: SimulatedClock, simulator: SimulatedSMC100, way: str) -> None:
    terminal = Terminal(simulator.start() if way == "tcp" else simulator.start_pty())
    assert terminal.type("1TS") == "1TS00000A"
    terminal.type("1PA30")
    assert terminal.type("1TE") == "1TEH"
    terminal.type("1OR")
    assert terminal.type("1TS") == "1TS00001E"
    terminal.type("1OR")
    assert terminal.type("1TE") == "1TEE"
    clock.advance_to(20)
    assert terminal.type("1TS") == "1TS000032"
    terminal.type("1PA30")
    assert terminal.type("1TE") == "1TE@"
    assert terminal.type("1TS") == "1TS000028"
    terminal.type("1PA10")
    assert terminal.type("1TE") == "1TEM"
    clock.advance_to(40)
    assert terminal.type("1TP") == "1TP30.00000"
    terminal.type("1PR-5.5")
    clock.advance_to(60)
    assert terminal.type("1TP") == "1TP24.50000"


def test_what_the_manual_forbids_is_refused_with_its_letter(clock: SimulatedClock, simulator: SimulatedSMC100) -> None:
    terminal = Terminal(simulator.start())
    terminal.type("1OR")
    clock.advance_to(20)
    for line, letter in {"1PA101": "G", "1PAx": "C", "1XX": "A", "1OR": "K", "1VA0": "C", "1SL-11": "C"}.items():
        terminal.type(line)
        assert terminal.type("1TE") == f"1TE{letter}", line
        assert terminal.type("1TE") == "1TE@", "an error is told once"
    terminal.type("1MM0")
    assert terminal.type("1TS") == "1TS00003C"
    terminal.type("1PA1")
    assert terminal.type("1TE") == "1TEJ"
    terminal.type("1MM1")
    assert terminal.type("1TS") == "1TS000032"


def test_settings_are_remembered_and_limit_moves(clock: SimulatedClock, simulator: SimulatedSMC100) -> None:
    terminal = Terminal(simulator.start())
    terminal.type("1VA5")
    assert terminal.type("1VA?") == "1VA5"
    terminal.type("1SR20")
    assert terminal.type("1SR?") == "1SR20"
    terminal.type("1OR")
    clock.advance_to(20)
    terminal.type("1PA20.1")
    assert terminal.type("1TE") == "1TEG"


def test_only_the_first_command_of_a_line_counts_and_other_addresses_are_not_ours(
    clock: SimulatedClock, simulator: SimulatedSMC100
) -> None:
    terminal = Terminal(simulator.start())
    assert terminal.type("1TP 1TS") == "1TP7.00000"
    terminal.type("2OR")
    assert terminal.type("1TS") == "1TS00000A"


def test_a_stopped_search_leaves_the_stage_unreferenced(clock: SimulatedClock, simulator: SimulatedSMC100) -> None:
    terminal = Terminal(simulator.start())
    terminal.type("1OR")
    clock.advance_to(0.1)
    terminal.type("1ST")
    assert terminal.type("1TS") == "1TS000028", "it brakes"
    clock.advance_to(5)
    assert terminal.type("1TS") == "1TS00000A"


def homed(clock: SimulatedClock, simulator: SimulatedSMC100) -> Terminal:
    terminal = Terminal(simulator.start())
    terminal.type("1OR")
    clock.advance_to(clock.now() + 20)
    assert terminal.type("1TS") == "1TS000032"
    return terminal


def test_a_power_cycle_forgets_the_reference_the_speed_and_the_limits(
    clock: SimulatedClock, simulator: SimulatedSMC100
) -> None:
    terminal = homed(clock, simulator)
    for line in ("1VA5", "1SR20", "1PA8"):
        terminal.type(line)
    clock.advance_to(40)
    simulator.restart()
    assert terminal.type("1TS") == "1TS00000A"
    assert terminal.type("1TP") == "1TP0.00000", "an incremental encoder counts from where it wakes up"
    assert terminal.type("1VA?") == "1VA10"
    assert terminal.type("1SR?") == "1SR100"
    terminal.type("1PA30")
    assert terminal.type("1TE") == "1TEH"
    terminal.type("1OR")
    clock.advance_to(60)
    terminal.type("1PA30")
    clock.advance_to(80)
    assert terminal.type("1TP") == "1TP30.00000"


def test_a_jammed_motor_is_a_following_error_until_a_reset(clock: SimulatedClock, simulator: SimulatedSMC100) -> None:
    terminal = homed(clock, simulator)
    terminal.type("1PA80")
    clock.advance_to(clock.now() + 2)
    simulator.jam()
    clock.advance_to(clock.now() + 2)
    assert terminal.type("1TS") == "1TS00203C"
    assert 0 < float(terminal.type("1TP").removeprefix("1TP")) < 80
    terminal.type("1PA1")
    assert terminal.type("1TE") == "1TEJ"
    terminal.type("1RS")
    assert terminal.type("1TS") == "1TS00000A"


def test_a_refused_command_is_not_carried_out_and_says_so_once(
    clock: SimulatedClock, simulator: SimulatedSMC100
) -> None:
    terminal = homed(clock, simulator)
    simulator.refuse()
    assert terminal.type("1TP") == "1TP0.00000", "a query is not refused"
    terminal.type("1PA30")
    assert terminal.type("1TE") == "1TED"
    assert terminal.type("1TS") == "1TS000032"
    terminal.type("1PA30")
    assert terminal.type("1TE") == "1TE@"
    assert terminal.type("1TS") == "1TS000028"


def test_a_drifting_encoder_reads_off_and_a_slow_stage_takes_ten_times_as_long(
    clock: SimulatedClock, simulator: SimulatedSMC100
) -> None:
    terminal = homed(clock, simulator)
    simulator.drift(0.25)
    assert terminal.type("1TP") == "1TP0.25000"
    simulator.slow()
    terminal.type("1PA20")
    begin = clock.now()
    # 20 degrees at 10 degrees/s with ramps at 20 degrees/s^2 take 2.5 s
    clock.advance_to(begin + 24.9)
    assert terminal.type("1TS") == "1TS000028"
    clock.advance_to(begin + 25.1)
    assert terminal.type("1TS") == "1TS000032"
    assert terminal.type("1TP") == "1TP20.25000"
    assert terminal.type("1VA?") == "1VA10"


def test_a_script_befalls_the_lines_that_are_typed(clock: SimulatedClock, simulator: SimulatedSMC100) -> None:
    terminal = homed(clock, simulator)
    simulator.script = FaultScript.parse("at 2 lose-reply\nat 4 restart")
    assert terminal.type("1TP") == "1TP0.00000"
    assert terminal.type("1TP", timeout=0.2) == ""
    assert terminal.type("1TS") == "1TS000032"
    assert terminal.type("1TS") == "1TS00000A"
    assert [number for number, _ in simulator.script.happened] == [2, 4]
