"""Speed against accuracy: what several ways to the same result cost, and how far off each is.

Costs are measured where the program runs. All ways of a chart take turns, so that a machine that is busy for a while
is busy for all of them; what counts is the median of the rounds, and the quartiles tell how steady it was.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np


@dataclass(frozen=True)
class Use:
    """What somebody asks for who wants a way for themselves."""

    kind: Literal["campaign", "fit", "choose", "text"]
    settings: dict[str, str | float] = field(default_factory=dict)
    """"campaign": keys of its resolution; "fit": model and engine; "text": the text to copy, a command or a piece of a
    scene; "choose": nothing, as the scene decides."""
    note: str = ""
    """Where what one gets so differs from what was charted: a sentence, or empty."""


@dataclass(frozen=True)
class Candidate:
    """One way to a result."""

    name: str
    """A few words that stand beside its mark."""
    setting: str
    """What exactly is done, as a phrase."""
    family: str
    """Ways of one family differ by how much effort they take, and have one colour."""
    run: Callable[[int], Any]
    """What is timed; it is told the number of the round, so that each may have noise of its own."""
    share: float = 1.0
    """Which part of the whole job one `run` is; the cost is that of the whole, or of one piece of it."""
    use: Use | None = None
    """None where no command offers it, and it is there to be compared with."""


@dataclass(frozen=True)
class Timed:
    """A way that has run."""

    candidate: Candidate
    low: float
    """Lower quartile of the rounds, s."""
    middle: float
    """Median, s."""
    high: float
    """Upper quartile, s."""
    results: tuple[Any, ...]
    """Of all rounds."""

    def choice(self, error: Callable[[Any], float], more: dict[str, float] | None = None) -> "Choice":
        """The mark of a chart: the error is the root mean square of `error` over the results."""
        way = self.candidate
        off = float(np.sqrt(np.mean([error(result) ** 2 for result in self.results])))
        return Choice(way.name, way.setting, way.family, self.middle, self.low, self.high, off, more or {}, way.use)


@dataclass(frozen=True)
class Choice:
    """A way with its cost and its error: one mark of a chart."""

    name: str
    setting: str
    family: str
    cost: float
    """Median of the rounds, or what a model of the instrument says."""
    cost_low: float
    """Lower quartile."""
    cost_high: float
    """Upper quartile."""
    error: float
    more: dict[str, float] = field(default_factory=dict)
    """Further figures for the table, by name with unit."""
    use: Use | None = None
    """None where no command offers it."""


@dataclass(frozen=True)
class Axis:
    """What a chart shows along one side."""

    name: str
    unit: str
    """Empty for a pure number."""

    @property
    def label(self) -> str:
        """Name with unit."""
        return f"{self.name} / {self.unit}" if self.unit else self.name


@dataclass(frozen=True)
class Chart:
    """Ways to one result, to be drawn with both axes logarithmic."""

    kind: str
    """Short name, unique in a page, e.g. "fits"."""
    title: str
    caption: str
    """What is compared and how it was measured: whole sentences."""
    cost: Axis
    error: Axis
    choices: tuple[Choice, ...]

    @property
    def front(self) -> tuple[int, ...]:
        """Indexes into `choices` of those that no other one beats, by rising cost."""
        return pareto_front([c.cost for c in self.choices], [c.error for c in self.choices])


def pareto_front(costs: Sequence[float], errors: Sequence[float]) -> tuple[int, ...]:
    """Which are beaten by none that costs no more and errs no more, by rising cost; the first of equals counts.

    >>> pareto_front([1.0, 2.0, 3.0, 2.5], [0.3, 0.1, 0.2, 0.1])
    (0, 1)
    """
    front: list[int] = []
    for index in sorted(range(len(costs)), key=lambda i: (costs[i], errors[i], i)):
        if not front or errors[index] < errors[front[-1]]:
            front.append(index)
    return tuple(front)


def race(
    candidates: Sequence[Candidate],
    rounds: int,
    told: Callable[[str], None] = lambda _: None,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[Timed, ...]:
    """Run all `candidates` in turns, `rounds` times after a first one that only warms up.

    Each round begins with another one, so that none always follows the same. `told` hears what is running; `clock`
    gives seconds.
    """
    results: list[list[Any]] = [[] for _ in candidates]
    for candidate in candidates:
        told(f"{candidate.family}: {candidate.name}")
        candidate.run(0)
    seconds = np.empty((rounds, len(candidates)))
    for number in range(rounds):
        told(f"round {number + 1} of {rounds}")
        for place in range(len(candidates)):
            index = (place + number) % len(candidates)
            begin = clock()
            results[index].append(candidates[index].run(number))
            seconds[number, index] = (clock() - begin) / candidates[index].share
    low, middle, high = np.quantile(seconds, [0.25, 0.5, 0.75], axis=0)
    return tuple(
        Timed(candidate, float(low[i]), float(middle[i]), float(high[i]), tuple(results[i]))
        for i, candidate in enumerate(candidates)
    )


def charts_json(charts: Sequence[Chart]) -> list[dict[str, Any]]:
    """Charts as they go into JSON; every choice says whether it stands on the front."""
    return [
        {
            "kind": chart.kind,
            "title": chart.title,
            "caption": chart.caption,
            "cost": asdict(chart.cost),
            "error": asdict(chart.error),
            "choices": [
                asdict(choice) | {"on_front": index in chart.front} for index, choice in enumerate(chart.choices)
            ],
        }
        for chart in charts
    ]
