"""What an operator sees while a campaign runs: a line per scan on a terminal, plain lines in a log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID

    from goniometer.scans.progress import Progress
    from goniometer.states import Kind
    from goniometer.storage.records import Expected


LOG_INTERVAL = 5.0
"""Seconds between two lines of progress in a log."""

Show = Callable[["Progress"], None]
Note = Callable[[str], None]


def duration(seconds: float | None) -> str:
    """A time as a person says it; "?" when unknown.

    >>> duration(3900), duration(75), duration(12.4), duration(None)
    ('1 h 05 min', '1 min 15 s', '12 s', '?')
    """
    if seconds is None:
        return "?"
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    if whole >= 60:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole} s"


def called(name: str, kind: Kind) -> str:
    """How an operator tells a scan from the others.

    >>> called("Sample 1 #2", "sample"), called("Sample 1 #2", "spot"), called("reference", "reference")
    ('Sample 1 #2', 'Sample 1 #2, another spot', 'reference panel')
    """
    if kind == "reference":
        return name.replace("reference", "reference panel")
    return f"{name}, another spot" if kind == "spot" else name


def span(time: Expected) -> str:
    """A time with its limits; these are left out where all are the same.

    >>> from goniometer.storage.records import Expected
    >>> span(Expected(725.0, 600.0, 905.0)), span(Expected(50.0, 50.0, 50.0))
    ('12 min 05 s (10 min 00 s to 15 min 05 s)', '50 s')
    """
    told, low, high = (duration(each) for each in (time.seconds, time.low, time.high))
    return told if low == high else f"{told} ({low} to {high})"


@contextmanager
def progress_display(console: Console) -> Iterator[tuple[Show, Note]]:
    """A function that shows progress and one that shows a sentence, on `console`, until the context ends."""
    if console.is_terminal:
        with _bars(console) as display:
            yield display
    else:
        yield _lines(console), lambda sentence: console.print(sentence, markup=False, highlight=False)


@contextmanager
def _bars(console: Console) -> Iterator[tuple[Show, Note]]:
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bars
    from rich.table import Column

    columns = (
        TextColumn("{task.description:<22}", markup=False),
        BarColumn(bar_width=12),
        TextColumn("{task.completed:>4.0f} of {task.total:.0f} points"),
        TextColumn("{task.fields[state]}", table_column=Column()),  # goes on in a second line of a narrow terminal
    )
    with Bars(*columns, console=console) as bars:
        tasks: dict[int, TaskID] = {}

        def show(progress: Progress) -> None:
            if progress.scan_id not in tasks:
                tasks[progress.scan_id] = bars.add_task(called(progress.sample, progress.kind), state="")
            bars.update(
                tasks[progress.scan_id],
                completed=progress.done,
                total=max(progress.expected, progress.done),
                state=_state(progress),
            )

        yield show, lambda sentence: bars.console.print(sentence, markup=False, highlight=False)


def _lines(console: Console) -> Show:
    last: dict[int, tuple[float, tuple[str, str | None] | None]] = {}

    def show(progress: Progress) -> None:
        doing = progress.phase, None if progress.waiting is None else progress.waiting.what
        since, before = last.get(progress.scan_id, (-LOG_INTERVAL, None))
        if before == doing and time.monotonic() - since < LOG_INTERVAL:
            return
        last[progress.scan_id] = time.monotonic(), doing
        console.print(
            f"{called(progress.sample, progress.kind)}: {progress.done} of about {progress.expected} points, "
            f"{100 * progress.fraction:.0f} %, {_state(progress)}",
            markup=False,
            highlight=False,
        )

    return show


def _state(progress: Progress) -> str:
    """Time left, what it waits for, or how it ended."""
    if progress.phase == "finished":
        dead = "" if progress.dead_time is None else f", {progress.dead_time:.2g} s of dead time a point"
        ended = "finished" if progress.outcome == "completed" else progress.outcome
        return f"{ended}, {duration(progress.bench_elapsed)} on the bench{dead}"
    if progress.phase != "running":
        return progress.phase
    if progress.waiting is not None:
        left = "" if progress.waiting.left is None else f", {duration(progress.waiting.left)} left on the bench"
        return f"waiting: {progress.waiting.what}{left}"
    if progress.remaining is None:  # no point tells yet how bench time passes here
        return f"{span(progress.bench_remaining)} left on the bench"
    return f"{duration(progress.remaining)} left; on the bench {span(progress.bench_remaining)}"
