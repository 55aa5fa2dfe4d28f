"""What can go wrong between a computer and an instrument, and inside the instrument, written as a script.

Each simulator has an attribute `script`; what it says befalls the requests that the simulator gets. A script is text,
one fault a line::

    # the night on which the hub was loose
    at 12 lose-reply
    at 40 delay 0.5 s            # what is delayed delays what follows
    at 50 corrupt 3 times        # the requests 50, 51 and 52
    every 100 foreign            # the requests 100, 200, 300, ...
    from 300 slow                # request 300 and each one after it
    from 300 every 20 split
    at 7 unplug 0.3 s

Requests are counted from 1 since the script was made, and count whether or not they reach the device. Several faults
may befall the same request. Wire faults last in real seconds, because a client's own timeouts are real.
"""

import math
import random
import re
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

from simulators.errors import FaultScriptError

GARBAGE_BYTES = 8
"""The most bytes of noise in front of a reply."""
SPLIT_PIECES = 8
"""The most pieces into which a reply is split."""
SPLIT_PAUSE = 0.001
"""Real seconds between two of them."""
REMEMBERED = 16
"""How many earlier replies may come back as a foreign one."""


class Kind(StrEnum):
    """What can go wrong. A fault of the line that concerns the reply does nothing to a request that has none."""

    LOSE_REQUEST = "lose-request"
    """The request never reaches the device."""
    LOSE_REPLY = "lose-reply"
    """The device acts, and its reply is lost."""
    DELAY = "delay"
    """The reply, and all that follows it on the line, comes `seconds` later."""
    DUPLICATE = "duplicate"
    """The reply comes twice."""
    CORRUPT = "corrupt"
    """One bit of one byte of the reply is flipped."""
    TRUNCATE = "truncate"
    """The end of the reply is lost; at least its first byte comes, and at most all but the last."""
    GARBAGE = "garbage"
    """Some random bytes come in front of the reply."""
    SPLIT = "split"
    """The reply comes in small pieces with pauses between them."""
    MERGE = "merge"
    """The reply waits, and comes in one piece with the next one."""
    FOREIGN = "foreign"
    """A reply to an earlier request comes once more, in front of the right one; nothing if there was none."""
    UNPLUG = "unplug"
    """The line is cut in the middle of the reply, and back after `seconds`; the device stays switched on."""
    STALL = "stall"
    """For `seconds` nothing is answered and nothing acted on; what is asked in that time is lost."""

    REFUSE = "refuse"
    """The device answers the next command with its own error, and does not carry it out."""
    RESTART = "restart"
    """The device is switched off and on: it forgets its settings, and its reference if the real one does."""
    JAM = "jam"
    """The motor stops where it is, and the device reports its own fault until that is cleared."""
    DRIFT = "drift"
    """From now on the device reads wrongly by a small amount."""
    SLOW = "slow"
    """From now on the device takes ten times as long."""


LASTING = frozenset({Kind.DELAY, Kind.UNPLUG, Kind.STALL})
"""Faults that have a duration."""


@dataclass(frozen=True)
class Fault:
    """One kind of fault and the requests that it befalls. Raises `FaultScriptError` when it cannot happen."""

    kind: Kind
    at: int
    """The first request, counted from 1 since the script was made."""
    times: int = 1
    """How many requests in a row."""
    every: int = 0
    """0 for once, otherwise again after so many requests."""
    seconds: float = 0.0
    """Real seconds that a delay, an unplugging or a stall lasts."""

    def __post_init__(self) -> None:
        if self.at < 1 or self.times < 1 or self.every < 0:
            raise FaultScriptError(f"{self.kind}: requests and repetitions are counted from 1")
        if self.kind in LASTING and not (self.seconds > 0 and math.isfinite(self.seconds)):
            raise FaultScriptError(f'{self.kind}: it needs a duration above 0, such as "{self.kind} 0.5 s"')
        if self.kind not in LASTING and self.seconds:
            raise FaultScriptError(f"{self.kind}: it has no duration; only {', '.join(sorted(LASTING))} have one")

    def befalls(self, request: int) -> bool:
        """Whether the request with this number is hit."""
        after = request - self.at
        return after >= 0 and (after % self.every if self.every else after) < self.times


class FaultScript:
    """Faults by the numbers of the requests that they befall; the same `seed` gives the same random bytes."""

    def __init__(self, faults: Iterable[Fault] = (), seed: int = 0) -> None:
        self.faults = tuple(faults)
        self.random = random.Random(seed)
        """Where flipped bits, cuts and garbage come from."""
        self.requests = 0
        """How many requests there have been."""
        self.happened: list[tuple[int, Fault]] = []
        """What befell which request, in order."""

    @classmethod
    def parse(cls, text: str, seed: int = 0) -> Self:
        """Read a script in the form shown at the top of this module.

        Raises `FaultScriptError` with the number of the first line that cannot be read.
        """
        faults = []
        for number, line in enumerate(text.splitlines(), start=1):
            words = line.partition("#")[0].strip()
            if not words:
                continue
            try:
                faults.append(_fault(words))
            except FaultScriptError as error:
                raise FaultScriptError(f"line {number} of the fault script: {error}") from None
        return cls(faults, seed)

    def due(self) -> list[Fault]:
        """Count a request, and return what befalls it, in the order of the script."""
        self.requests += 1
        due = [fault for fault in self.faults if fault.befalls(self.requests)]
        self.happened += [(self.requests, fault) for fault in due]
        return due


class Breakable(ABC):
    """A device that can be struck by the faults of devices."""

    @abstractmethod
    def refuse(self) -> None:
        """Answer the next command with the device's own error, and do not carry it out."""

    @abstractmethod
    def restart(self) -> None:
        """Wake up as after switching off and on."""

    @abstractmethod
    def jam(self) -> None:
        """Stop and report a fault until it is cleared."""

    @abstractmethod
    def drift(self) -> None:
        """Read wrongly by a small amount from now on."""

    @abstractmethod
    def slow(self) -> None:
        """Take ten times as long from now on."""


def strike(device: Breakable, faults: Iterable[Fault]) -> None:
    """Let those of the `faults` that concern the device befall it; the others are the line's."""
    blows = {
        Kind.REFUSE: device.refuse,
        Kind.RESTART: device.restart,
        Kind.JAM: device.jam,
        Kind.DRIFT: device.drift,
        Kind.SLOW: device.slow,
    }
    for fault in faults:
        if fault.kind in blows:
            blows[fault.kind]()


def duration(kind: Kind, faults: Iterable[Fault]) -> float:
    """Real seconds that the faults of this `kind` among `faults` last together; 0 where there is none."""
    return sum(fault.seconds for fault in faults if fault.kind is kind)


def reaches_device(faults: Iterable[Fault]) -> bool:
    """Whether a request that the `faults` befall gets to the device at all."""
    return not {fault.kind for fault in faults} & {Kind.LOSE_REQUEST, Kind.STALL}


@dataclass(frozen=True)
class Piece:
    """Bytes that come back together."""

    data: bytes
    after: float = 0.0
    """Real seconds between this piece and what was sent before it, or the request if that was later."""


@dataclass
class Line:
    """What a line has carried and still holds, and what it makes of the replies; one for each connection."""

    _earlier: deque[bytes] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    _held: bytes = b""

    def carry(self, faults: Sequence[Fault], reply: bytes, chance: random.Random) -> list[Piece]:
        """The pieces in which `reply` comes back when the `faults` befall it, to be sent in this order.

        `reply` is empty when there is none, as for a request that does not reach the device. After an unplugging
        the last piece ends in the middle of the reply; cutting the line is for the caller to do.
        """
        kinds = {fault.kind for fault in faults}
        others = [earlier for earlier in self._earlier if earlier != reply]
        if reply and reply not in self._earlier:
            self._earlier.append(reply)
        data = b"" if Kind.LOSE_REPLY in kinds else reply
        if not data:
            return []
        if Kind.CORRUPT in kinds:
            at = chance.randrange(len(data))
            data = data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        if Kind.TRUNCATE in kinds:
            data = data[: chance.randrange(1, max(len(data), 2))]
        if Kind.DUPLICATE in kinds:
            data += data
        if Kind.FOREIGN in kinds and others:
            data = chance.choice(others) + data
        if Kind.GARBAGE in kinds:
            data = chance.randbytes(chance.randint(1, GARBAGE_BYTES)) + data
        data, self._held = self._held + data, b""
        if Kind.UNPLUG in kinds:
            data = data[: len(data) // 2]
        elif Kind.MERGE in kinds:
            data, self._held = b"", data
        if not data:
            return []
        size = -(-len(data) // SPLIT_PIECES) if Kind.SPLIT in kinds else len(data)
        pieces = [Piece(data[at : at + size], SPLIT_PAUSE if at else 0.0) for at in range(0, len(data), size)]
        pieces[0] = Piece(pieces[0].data, duration(Kind.DELAY, faults))
        return pieces


FORM = re.compile(
    r"(?:at (?P<at>\d{1,9})|every (?P<every>\d{1,9})|from (?P<first>\d{1,9})(?: every (?P<again>\d{1,9}))?)"
    r" (?P<kind>[a-z-]+)"
    r"(?: (?P<seconds>\d{1,9}(?:\.\d*)?) ?s)?"
    r"(?: (?P<times>\d{1,9}) times)?"
)
"""A line of a script, with single blanks and no number that could be too large."""


def _fault(words: str) -> Fault:
    """What one line says. Raises `FaultScriptError`."""
    match = FORM.fullmatch(" ".join(words.split()))
    if match is None:
        raise FaultScriptError(f'cannot read "{words}"; write it like "at 12 lose-reply" or "every 100 delay 0.5 s"')
    part = match.groupdict()
    try:
        kind = Kind(part["kind"])
    except ValueError:
        raise FaultScriptError(f'there is no fault "{part["kind"]}"; there are {", ".join(Kind)}') from None
    if part["at"]:
        at, every = int(part["at"]), 0
    elif part["every"]:
        at = every = int(part["every"])
    else:
        at, every = int(part["first"]), int(part["again"] or 1)
    return Fault(kind, at, times=int(part["times"] or 1), every=every, seconds=float(part["seconds"] or 0))
