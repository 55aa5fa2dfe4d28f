"""`goniometer stability` as a user runs it."""

import json
from pathlib import Path
from typing import Any


def test_the_map_is_printed_as_json_and_drawn_on_a_page(cli: Any, tmp_path: Path) -> None:
    asked = ["stability", "--regime", "few points", "--method", "local", "--method", "global", "--runs", 1]
    done = cli(*asked, "--workers", 1, "--json", "--page", "map.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["silent_failures"] == []
    assert {(cell["level"], cell["method"]) for cell in found["cells"]} >= {
        ("6 points", "local"),
        ("50 points", "global"),
    }
    page = (tmp_path / "map.html").read_text()
    assert "too few directions" in page
    assert "100 / 100" in page


def test_an_unknown_method_is_refused_in_one_line(cli: Any, tmp_path: Path) -> None:
    done = cli("stability", "--method", "guess", cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cook-torrance-shift" in done.stderr
