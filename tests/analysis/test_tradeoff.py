"""Charts of speed against accuracy: the front is right, all ways get the same treatment, and nothing is unnamed."""

import itertools
import re

import numpy as np
import pytest

from analysis.figures.tradeoff import tradeoff_chapter, tradeoff_chart
from analysis.tradeoff import Axis, Candidate, Chart, Choice, charts_json, pareto_front, race


@pytest.mark.parametrize("seed", range(5))
def test_the_front_holds_exactly_what_nothing_beats(seed: int) -> None:
    random = np.random.default_rng(seed)
    costs, errors = random.random((2, 40)).round(1)  # rounded, so that there are equals
    front = pareto_front(list(costs), list(errors))

    def beats(i: int, j: int) -> bool:
        return bool(costs[i] <= costs[j] and errors[i] <= errors[j] and (costs[i] < costs[j] or errors[i] < errors[j]))

    unbeaten = {(costs[j], errors[j]) for j in range(40) if not any(beats(i, j) for i in range(40))}
    assert {(costs[i], errors[i]) for i in front} == unbeaten
    assert len(front) == len(unbeaten)
    assert all(costs[a] < costs[b] for a, b in itertools.pairwise(front))


def test_all_ways_are_timed_in_turns_and_none_always_follows_the_same() -> None:
    order: list[tuple[str, int]] = []
    ticks = iter(range(1000))

    def way(name: str) -> Candidate:
        def run(number: int) -> int:
            order.append((name, number))
            return number

        return Candidate(name, name, "made", run)

    timed = race([way("a"), way("b"), way("c")], 3, clock=lambda: float(next(ticks)))
    assert [name for name, _ in order] == list("abc" + "abc" + "bca" + "cab")
    assert [number for _, number in order[3:]] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert all(each.results == (0, 1, 2) and each.low == each.middle == each.high == 1 for each in timed)


def test_a_part_of_a_job_counts_as_the_whole_and_errors_are_averaged_over_the_rounds() -> None:
    ticks = itertools.count()
    tenth = Candidate("tenth", "a tenth of it", "made", lambda number: number, share=0.1)
    (timed,) = race([tenth], 4, clock=lambda: float(next(ticks)))
    choice = timed.choice(float)
    assert choice.cost == pytest.approx(10)
    assert choice.error == pytest.approx(np.sqrt((0 + 1 + 4 + 9) / 4))


def _chart() -> Chart:
    choices = tuple(
        Choice(
            f"way {i}", f"setting <{i}>", "one" if i % 2 else "other", 10.0**-i, 0.9 * 10.0**-i, 2 * 10.0**-i, 0.1 * i
        )
        for i in range(1, 7)
    )
    return Chart("made", "Made up", "Nothing is compared.", Axis("time", "s"), Axis("error", ""), choices)


def test_every_choice_has_its_name_and_tells_its_setting_when_pointed_at() -> None:
    drawn = tradeoff_chart(_chart())
    for i in range(1, 7):
        assert f">way {i}<" in drawn
        assert f"<title>setting &lt;{i}&gt;: time" in drawn
    assert "time / s" in drawn
    assert ">error<" in drawn


def test_no_two_names_lie_on_each_other() -> None:
    close = tuple(Choice(f"name {i}", "", "one", 1 + 0.01 * i, 1.0, 1.1, 1 + 0.01 * ((7 * i) % 5)) for i in range(6))
    drawn = tradeoff_chart(Chart("close", "Close", "", Axis("time", "s"), Axis("error", ""), close))
    found = re.findall(r'text-anchor: (\w+)[^>]*x="([\d.]+)" y="([\d.]+)"[^>]*>name', drawn)
    width, height = 24, 6  # of such a name in letters of 8 points
    left = {"start": 0, "middle": width / 2, "end": width}
    at = [(float(x) - left[anchor], float(y)) for anchor, x, y in found]
    assert len(at) == 6
    for (x, y), (other_x, other_y) in itertools.combinations(at, 2):
        assert abs(x - other_x) > width or abs(y - other_y) > height


def test_page_and_json_say_the_same_of_the_front() -> None:
    chart = _chart()
    told = charts_json([chart])[0]["choices"]
    assert [choice["on_front"] for choice in told] == [i in chart.front for i in range(6)]
    assert tradeoff_chapter(chart).count("●") == len(chart.front)
