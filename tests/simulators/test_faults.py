"""Fault scripts say what they mean, and the line does to replies what the script says."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.devices.faults import LASTING, Fault, FaultScript, Kind, Line, Piece, duration, reaches_device, strike
from simulators.errors import FaultScriptError

DEVICE_KINDS = {Kind.REFUSE, Kind.RESTART, Kind.JAM, Kind.DRIFT, Kind.SLOW}
replies = st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=12)


def fault(kind: Kind) -> Fault:
    return Fault(kind, 1, seconds=0.5 if kind in LASTING else 0.0)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("at 12 lose-reply", Fault(Kind.LOSE_REPLY, 12)),
        ("at 40 delay 0.5 s", Fault(Kind.DELAY, 40, seconds=0.5)),
        ("every 100 corrupt", Fault(Kind.CORRUPT, 100, every=100)),
        ("from 300 stall 2 s", Fault(Kind.STALL, 300, every=1, seconds=2.0)),
        ("at 7 unplug 0.3s", Fault(Kind.UNPLUG, 7, seconds=0.3)),
        ("  at 7   jam   # the cable is caught", Fault(Kind.JAM, 7)),
        ("at 50 delay 1. s 3 times", Fault(Kind.DELAY, 50, times=3, seconds=1.0)),
        ("from 5 every 20 foreign 2 times", Fault(Kind.FOREIGN, 5, times=2, every=20)),
    ],
)
def test_a_script_means_what_it_says(line: str, expected: Fault) -> None:
    assert FaultScript.parse(f"# a comment\n\n{line}\n").faults == (expected,)


def test_every_kind_can_be_written() -> None:
    text = "\n".join(f"at 1 {kind} 0.5 s" if kind in LASTING else f"at 1 {kind}" for kind in Kind)
    assert [fault.kind for fault in FaultScript.parse(text).due()] == list(Kind)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("at lose-reply", 'cannot read "at lose-reply"; write it like'),
        ("at 3", "cannot read"),
        ("at 3 lose-reply 2", "cannot read"),
        ("at 3 vanish", 'there is no fault "vanish"; there are lose-request, lose-reply'),
        ("at 0 corrupt", "corrupt: requests and repetitions are counted from 1"),
        ("at 1 corrupt 0 times", "counted from 1"),
        ("every 0 corrupt", "counted from 1"),
        ("at 3 delay", 'delay: it needs a duration above 0, such as "delay 0.5 s"'),
        ("at 3 stall 0 s", "needs a duration"),
        ("at 3 jam 2 s", "jam: it has no duration; only delay, stall, unplug have one"),
    ],
)
def test_a_bad_line_is_named_with_its_number_and_what_would_be_right(line: str, complaint: str) -> None:
    with pytest.raises(FaultScriptError) as caught:
        FaultScript.parse(f"at 1 split\n# fine so far\n{line}\n")
    assert str(caught.value).startswith("line 3 of the fault script: ")
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_faults_befall_the_requests_that_the_script_numbers_and_the_record_says_so() -> None:
    script = FaultScript.parse("at 3 corrupt 2 times\nevery 4 foreign\nfrom 9 slow\nfrom 2 every 5 split 2 times")
    hit = [{fault.kind for fault in script.due()} for _ in range(11)]
    numbers = {kind: [number for number, kinds in enumerate(hit, start=1) if kind in kinds] for kind in Kind}
    assert numbers[Kind.CORRUPT] == [3, 4]
    assert numbers[Kind.FOREIGN] == [4, 8]
    assert numbers[Kind.SLOW] == [9, 10, 11]
    assert numbers[Kind.SPLIT] == [2, 3, 7, 8]
    assert [(number, fault.kind) for number, fault in script.happened if fault.kind is Kind.FOREIGN] == [
        (4, Kind.FOREIGN),
        (8, Kind.FOREIGN),
    ]
    assert script.requests == 11


@given(replies, st.lists(st.sets(st.sampled_from([Kind.DELAY, Kind.SPLIT, Kind.MERGE])), min_size=12, max_size=12))
def test_what_is_only_late_or_in_pieces_comes_whole_and_in_order(sent: list[bytes], kinds: list[set[Kind]]) -> None:
    line, chance, came = Line(), random.Random(1), b""
    for reply, befalling in zip([*sent, b"last"], [*kinds[: len(sent)], set[Kind]()], strict=True):
        pieces = line.carry([fault(kind) for kind in befalling], reply, chance)
        assert all(piece.data for piece in pieces)
        came += b"".join(piece.data for piece in pieces)
    assert came == b"".join(sent) + b"last"


@given(st.binary(min_size=1, max_size=40), st.integers(0, 1000))
def test_each_fault_does_to_a_reply_what_its_name_says(reply: bytes, seed: int) -> None:
    def come(kind: Kind, *, earlier: bytes = b"") -> bytes:
        line = Line()
        if earlier:
            line.carry([], earlier, random.Random(0))
        return b"".join(piece.data for piece in line.carry([fault(kind)], reply, random.Random(seed)))

    assert come(Kind.LOSE_REPLY) == b""
    assert come(Kind.MERGE) == b""
    assert come(Kind.DUPLICATE) == reply * 2
    flipped = come(Kind.CORRUPT)
    assert len(flipped) == len(reply)
    assert sum((a ^ b).bit_count() for a, b in zip(flipped, reply, strict=True)) == 1
    cut = come(Kind.TRUNCATE)
    assert reply.startswith(cut)
    assert 1 <= len(cut) < max(len(reply), 2)
    noisy = come(Kind.GARBAGE)
    assert noisy.endswith(reply)
    assert 1 <= len(noisy) - len(reply) <= 8
    assert come(Kind.FOREIGN) == reply
    assert come(Kind.FOREIGN, earlier=reply + b"!") == reply + b"!" + reply
    assert reply.startswith(come(Kind.UNPLUG))
    assert len(come(Kind.UNPLUG)) == len(reply) // 2
    for kind in DEVICE_KINDS:
        assert come(kind) == reply


def test_a_delay_comes_before_the_first_piece_only() -> None:
    both = [fault(Kind.DELAY), fault(Kind.SPLIT)]
    pieces = Line().carry(both, b"abc", random.Random(0))
    assert [piece.data for piece in pieces] == [b"a", b"b", b"c"]
    assert pieces[0].after == 0.5
    assert all(0 < piece.after < 0.5 for piece in pieces[1:])
    assert Line().carry([], b"abc", random.Random(0)) == [Piece(b"abc")]


def test_the_same_seed_spoils_the_same_bytes_so_that_a_failure_can_be_repeated() -> None:
    def night(seed: int) -> list[list[Piece]]:
        script, line = FaultScript.parse("every 2 corrupt\nevery 3 garbage\nevery 5 foreign", seed), Line()
        return [line.carry(script.due(), f"reply {number}".encode(), script.random) for number in range(30)]

    assert night(7) == night(7)
    assert night(7) != night(8)


def test_a_request_that_is_lost_or_stalled_does_not_reach_the_device() -> None:
    kept = {kind for kind in Kind if reaches_device([fault(kind)])}
    assert set(Kind) - kept == {Kind.LOSE_REQUEST, Kind.STALL}
    assert duration(Kind.STALL, [fault(Kind.STALL), fault(Kind.DELAY), fault(Kind.STALL)]) == 1.0


def test_device_faults_strike_the_device_each_by_its_name() -> None:
    class Recorder:
        def __init__(self) -> None:
            self.struck: list[str] = []

        def __getattr__(self, name: str) -> object:
            return lambda: self.struck.append(name)

    recorder = Recorder()
    strike(recorder, [fault(kind) for kind in Kind])
    assert recorder.struck == ["refuse", "restart", "jam", "drift", "slow"]
