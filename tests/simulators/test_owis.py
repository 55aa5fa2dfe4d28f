"""The simulated OWIS PS controllers speak as public clients of the real ones expect, to any serial client."""

from collections.abc import Iterator

import pytest
import serial

from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.devices.owis import SimulatedOwisPS


class Terminal:
    """A person at a serial terminal."""

    def __init__(self, url: str) -> None:
        self._port = serial.serial_for_url(url, timeout=5)

    def ask(self, question: str) -> str:
        """Send a question and return its answer."""
        self._port.write(f"{question}\r".encode())
        return self._port.read_until(b"\r").decode().removesuffix("\r")

    def tell(self, command: str) -> None:
        """Send a command; it has no reply, so the answer to the next question shows that it was carried out."""
        self._port.write(f"{command}\r".encode())
        assert self.ask("?VERSION").startswith("PS")


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def axis(clock: SimulatedClock) -> Axis:
    return Axis(clock, start=7.0, velocity=10, acceleration=20, limits=(-20, 100))


@pytest.fixture
def simulator(axis: Axis, clock: SimulatedClock) -> Iterator[SimulatedOwisPS]:
    simulator = SimulatedOwisPS([axis], clock, counts_per_degree=1000)
    yield simulator
    simulator.close()


@pytest.fixture
def terminal(simulator: SimulatedOwisPS) -> Terminal:
    return Terminal(simulator.start())


def homed(terminal: Terminal, clock: SimulatedClock) -> Terminal:
    terminal.tell("INIT1")
    terminal.tell("REF1=4")
    clock.advance_to(clock.now() + 20)
    return terminal


def test_a_dialog_by_hand_homes_and_moves(terminal: Terminal, clock: SimulatedClock, axis: Axis) -> None:
    assert terminal.ask("?ASTAT") == "I"
    assert terminal.ask("?CNT1") == "0"  # wherever it stands when it is switched on
    terminal.tell("INIT1")
    assert terminal.ask("?ASTAT") == "R"
    assert terminal.ask("?REFST1") == "0"
    terminal.tell("REF1=4")
    assert terminal.ask("?ASTAT") == "P"
    clock.advance_to(20.0)
    assert terminal.ask("?ASTAT") == "R"
    assert (terminal.ask("?REFST1"), terminal.ask("?CNT1")) == ("1", "0")
    for command in ("PVEL1=10000", "ACC1=20000", "ABSOL1", "PSET1=30000", "PGO1"):
        terminal.tell(command)
    assert terminal.ask("?ASTAT") == "T"
    # 30 degrees at 10 degrees/s with ramps at 20 degrees/s^2 take 3.5 s
    clock.advance_to(20.0 + 1.75)
    assert terminal.ask("?CNT1") == "15000"
    clock.advance_to(20.0 + 3.51)
    assert (terminal.ask("?ASTAT"), terminal.ask("?CNT1"), axis.position()) == ("R", "30000", 30.0)
    for command in ("RELAT1", "PSET1=-500", "PGO1"):
        terminal.tell(command)
    clock.advance_to(40.0)
    assert (terminal.ask("?MODE1"), terminal.ask("?CNT1")) == ("RELAT", "29500")


def test_only_modes_that_zero_the_counter_zero_it(terminal: Terminal, clock: SimulatedClock) -> None:
    terminal.tell("INIT1")
    terminal.tell("REF1=1")
    clock.advance_to(20.0)
    assert (terminal.ask("?REFST1"), terminal.ask("?CNT1")) == ("1", "-7000")


def test_a_stop_brakes_within_the_ramp(terminal: Terminal, clock: SimulatedClock, axis: Axis) -> None:
    homed(terminal, clock)
    terminal.tell("PSET1=90000")
    terminal.tell("PGO1")
    clock.advance_to(clock.now() + 3.0)
    before = axis.position()
    terminal.tell("STOP1")
    clock.advance_to(clock.now() + 10.0)
    assert terminal.ask("?ASTAT") == "R"
    # v^2 / 2a
    assert axis.position() - before == pytest.approx(10**2 / 40)


def test_the_limit_switch_switches_off_and_can_be_left(terminal: Terminal, clock: SimulatedClock) -> None:
    homed(terminal, clock)
    terminal.tell("PSET1=150000")
    terminal.tell("PGO1")
    clock.advance_to(clock.now() + 60)
    assert (terminal.ask("?ASTAT"), terminal.ask("?ESTAT1"), terminal.ask("?CNT1")) == ("L", "8", "100000")
    terminal.tell("EFREE1")
    assert terminal.ask("?MSG").startswith("07")
    terminal.tell("INIT1")
    terminal.tell("EFREE1")
    assert terminal.ask("?ASTAT") == "F"
    clock.advance_to(clock.now() + 60)
    assert (terminal.ask("?ASTAT"), terminal.ask("?ESTAT1")) == ("R", "0")


def test_what_is_wrong_is_told_once_and_nothing_answers_at_once(terminal: Terminal) -> None:
    for request, number in (("HOP1", "05"), ("PGO3", "02"), ("PVEL1=0", "04"), ("PGO1", "07"), ("?NONSENSE1", "05")):
        terminal._port.write(f"{request}\r".encode())
        assert terminal.ask("?MSG") == number
        assert terminal.ask("?MSG") == "00"


def test_terminal_mode_2_says_ok_and_uses_words(terminal: Terminal) -> None:
    terminal._port.write(b"TERM=2\rINIT1\r")
    assert terminal._port.read_until(b"OK\rOK\r") == b"OK\rOK\r"
    assert terminal.ask("?MSG") == "00 no message"


def test_a_ps90_moves_the_axis_that_is_named(clock: SimulatedClock) -> None:
    axes = [Axis(clock, velocity=10, acceleration=20, limits=(-20, 100)) for _ in range(3)]
    simulator = SimulatedOwisPS(axes, clock, counts_per_degree=1000)
    terminal = Terminal(simulator.start())
    try:
        assert terminal.ask("?VERSION").startswith("PS90")
        terminal.tell("INIT2")
        assert terminal.ask("?ASTAT") == "IRI"
        terminal.tell("PSET2=5000")
        terminal.tell("PGO2")
        assert terminal.ask("?ASTAT") == "ITI"
        clock.advance_to(10.0)
        assert [axis.position() for axis in axes] == [0.0, 5.0, 0.0]
    finally:
        simulator.close()


def test_motor_off_is_not_ready(terminal: Terminal) -> None:
    terminal.tell("INIT1")
    terminal.tell("MOFF1")
    assert terminal.ask("?ASTAT") == "O"
    terminal.tell("MON1")
    assert terminal.ask("?ASTAT") == "R"


def test_the_faults_of_a_device_are_visible(
    terminal: Terminal, clock: SimulatedClock, simulator: SimulatedOwisPS
) -> None:
    homed(terminal, clock)
    simulator.refuse()
    terminal.tell("PSET1=30000")
    assert (terminal.ask("?PSET1"), terminal.ask("?MSG")) == ("0", "09")
    simulator.drift()
    assert terminal.ask("?CNT1") == "500"
    simulator.slow()
    terminal.tell("PSET1=30000")
    terminal.tell("PGO1")
    clock.advance_to(clock.now() + 10 * 3.5 - 0.1)
    assert terminal.ask("?ASTAT") == "T"
    simulator.jam()
    assert (terminal.ask("?ASTAT"), terminal.ask("?REFST1")) == ("E", "0")
    terminal.tell("PVEL1=77")
    simulator.restart()
    assert (terminal.ask("?ASTAT"), terminal.ask("?PVEL1")) == ("I", "10000")
