"""APT frames agree with an independent implementation, and nothing else is taken for one."""

import io
from typing import Any

import pytest
import thorlabs_apt_protocol as thorlabs
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import apt

MOUNT, PC, CHANNEL = 0x50, 0x01, 1
counts = st.integers(-(2**31), 2**31 - 1)


def from_mount(number: int, data: bytes) -> bytes:
    return apt.HEADER.pack(number, len(data), PC | 0x80, MOUNT) + data


def theirs(frame: bytes) -> Any:
    """What the other implementation reads in a frame."""
    (message,) = thorlabs.Unpacker(io.BytesIO(frame), on_error="raise")
    return message


@pytest.mark.parametrize(
    ("ours", "reference"),
    [
        (apt.short(apt.REQUEST_INFO), thorlabs.hw_req_info(MOUNT, PC)),
        (apt.short(apt.STOP_UPDATES), thorlabs.hw_stop_updatemsgs(MOUNT, PC)),
        (apt.short(apt.REQUEST_STATUS, 1), thorlabs.mot_req_statusupdate(MOUNT, PC, CHANNEL)),
        (apt.short(apt.REQUEST_VELOCITY, 1), thorlabs.mot_req_velparams(MOUNT, PC, CHANNEL)),
        (apt.short(apt.REQUEST_HOMING, 1), thorlabs.mot_req_homeparams(MOUNT, PC, CHANNEL)),
        (apt.short(apt.HOME, 1), thorlabs.mot_move_home(MOUNT, PC, CHANNEL)),
        (apt.short(apt.STOP, 1, apt.PROFILED), thorlabs.mot_move_stop(MOUNT, PC, CHANNEL, 2)),
        (apt.short(apt.SET_ENABLED, 1, apt.DISABLE), thorlabs.mod_set_chanenablestate(MOUNT, PC, CHANNEL, 2)),
    ],
)
def test_a_request_is_what_another_program_would_send(ours: bytes, reference: bytes) -> None:
    assert ours == reference


@given(counts, counts, counts)
def test_numbers_go_out_as_another_program_would_send_them(one: int, two: int, three: int) -> None:
    assert apt.long(apt.MOVE_TO, apt.MOVE_DATA.pack(1, one)) == thorlabs.mot_move_absolute(MOUNT, PC, CHANNEL, one)
    velocity = apt.VelocitySetting(acceleration=one, velocity=two)
    assert apt.long(apt.SET_VELOCITY, velocity.data()) == thorlabs.mot_set_velparams(MOUNT, PC, CHANNEL, 0, one, two)
    homing = apt.HomingSetting(direction=2, switch=1, velocity=two, offset=three)
    reference = thorlabs.mot_set_homeparams(MOUNT, PC, CHANNEL, 2, 1, two, three)
    assert apt.long(apt.SET_HOMING, homing.data()) == reference


@given(counts, st.integers(0, 2**32 - 1))
def test_a_status_is_read_as_another_program_reads_it(position: int, bits: int) -> None:
    frame = from_mount(apt.STATUS, apt.STATUS_DATA.pack(1, position, 0, bits))
    status, reference = apt.Status.read(frame), theirs(frame)
    assert status.position == reference.position
    assert bool(status.bits & 0x30) == (reference.moving_forward or reference.moving_reverse)
    assert bool(status.bits & 0x200) == reference.homing
    assert bool(status.bits & 0x400) == reference.homed
    assert bool(status.bits & 0x4000) == reference.motion_error
    assert bool(status.bits & 0x80000000) == reference.channel_enabled


@given(counts, counts)
def test_settings_are_read_as_another_program_reads_them(one: int, two: int) -> None:
    frame = from_mount(apt.VELOCITY, apt.VelocitySetting(one, two).data())
    assert apt.VelocitySetting.read(frame) == apt.VelocitySetting(one, two)
    assert (theirs(frame).acceleration, theirs(frame).max_velocity) == (one, two)
    frame = from_mount(apt.HOMING, apt.HomingSetting(2, 1, one, two).data())
    assert apt.HomingSetting.read(frame) == apt.HomingSetting(2, 1, one, two)
    assert (theirs(frame).home_velocity, theirs(frame).offset_distance) == (one, two)


def test_who_answers_is_read_as_another_program_reads_it() -> None:
    data = apt.INFO_DATA.pack(55123456, b"K10CR1", 16, 7, 2, 1, 0, b"", 3, 1, 1)
    frame = from_mount(apt.INFO, data)
    info, reference = apt.Info.read(frame), theirs(frame)
    assert len(frame) == 90
    assert info.serial_number == reference.serial_number
    assert info.model == reference.model_number.rstrip(b"\0").decode()
    assert info.firmware == ".".join(map(str, reference.firmware_version)) == "1.2.7"


STATUS_FRAME = from_mount(apt.STATUS, apt.STATUS_DATA.pack(1, -70000, 0, 0x80000400))


@pytest.mark.parametrize("frame", [STATUS_FRAME, apt.HEADER.pack(apt.HOMED, 1, PC, MOUNT)])
def test_a_frame_is_whole_with_its_last_byte_and_not_before(frame: bytes) -> None:
    assert apt.missing(frame) == 0
    for length in range(len(frame)):
        assert 0 < apt.missing(frame[:length]) <= len(frame) - length


@settings(max_examples=300)
@given(st.binary(max_size=40))
def test_a_frame_is_found_behind_noise(noise: bytes) -> None:
    # as the serial port does it: a byte that cannot begin a frame is dropped
    left, read = noise + STATUS_FRAME, b""
    while True:
        missing = apt.missing(read)
        if missing == 0:
            break
        if missing < 0:
            read = read[1:]
        else:
            assert left, "the frame was passed over"
            read, left = read + left[:missing], left[missing:]
    assert read == STATUS_FRAME
    assert not left


@pytest.mark.parametrize(
    "header",
    [
        (0x0777, 14, PC | 0x80, MOUNT),  # no such message
        (apt.STATUS, 15, PC | 0x80, MOUNT),  # longer than it can be
        (apt.STATUS, 14, PC, MOUNT),  # it always has data
        (apt.STATUS, 14, 0x11 | 0x80, MOUNT),  # for somebody else
        (apt.STATUS, 14, PC | 0x80, PC),  # our own echo
    ],
)
def test_what_does_not_fit_together_is_no_frame(header: tuple[int, int, int, int]) -> None:
    assert apt.missing(apt.HEADER.pack(*header)) == -1
