"""The page of figures holds every benchmark, says what was missed or failed, and keeps what was measured before."""

import doctest
import importlib
from pathlib import Path

import pytest

from tests.benchmarks import __main__ as benchmarks
from tests.benchmarks import figures, page

PROOFS = {"A proof": ["kills", "year"]}


def outcome(*rows: str, failure: str = "") -> page.Outcome:
    return page.Outcome("python -m it", "2026-01-02", "abc", "a machine", 0.1, 1.0, 0.9, list(rows), failure)


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(page, "PAGE", tmp_path / "measured.md")
    monkeypatch.setattr(page, "MEMORY", tmp_path / "measured.json")
    return tmp_path / "measured.md"


def test_every_benchmark_has_its_place_on_the_page() -> None:
    modules = Path(benchmarks.__file__).parent.glob("[!_]*.py")
    assert {each.stem for each in modules if "import tell" in each.read_text()} == set(benchmarks.BENCHMARKS)


def test_every_benchmark_finds_what_it_imports() -> None:
    for name in benchmarks.BENCHMARKS:
        assert importlib.import_module(f"tests.benchmarks.{name}").__doc__


def test_a_figure_says_whether_it_is_what_was_aimed_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctest.testmod(figures).failed == 0
    figures.tell("answer", 61.5, "ms", "< 50", "the disk is slow")
    assert capsys.readouterr().out == "| answer | 61.5 ms | < 50 | **missed**: the disk is slow |\n"
    with pytest.raises(ValueError, match="nothing was measured"):
        figures.tell("answer", float("nan"))


def test_the_page_names_what_was_missed_what_failed_and_what_was_not_run(written: Path) -> None:
    missed = "| answer | 61.5 ms | < 50 | **missed**: the disk is slow |"
    page.write(PROOFS, {"kills": outcome(missed, "| size | 3 MB |  |  |", failure="it ended with exit code 1")})
    text = written.read_text()
    assert "2 figures, 1 of them with an aim: 0 met, 1 missed:" in text
    assert "- [kills](#kills): answer: 61.5 ms, aim < 50: the disk is slow" in text
    assert "- [kills](#kills): it ended with exit code 1" in text
    assert "### year" in text
    assert "Not run yet; `python -m tests.benchmarks year` does." in text
    assert "says nothing of itself" not in text
    assert "- `test_measured.py`: The page of figures" in text


def test_what_is_not_run_again_keeps_its_figures_and_its_date(written: Path) -> None:
    page.write(PROOFS, {"kills": outcome("| kills | 200 | >= 200 | met |")})
    page.write(PROOFS, page.remembered() | {"year": outcome("| file | 3 MB |  |  |")})
    assert "| kills | 200 | >= 200 | met |" in written.read_text()
    assert set(page.remembered()) == {"kills", "year"}
