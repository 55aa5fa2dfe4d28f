"""The house stands: nothing imports upward and nothing imports in a circle."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_no_floor_imports_from_a_floor_above_it() -> None:
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "2 kept, 0 broken" in result.stdout


@pytest.mark.parametrize("floor", ["drivers", "goniometer", "analysis", "simulators", "api"])
def test_who_looks_for_a_module_finds_it_where_the_floor_says_what_stands_where(floor: str) -> None:
    package = importlib.import_module(floor)
    _, where = (package.__doc__ or "").split("Where what stands:")
    there = [module.name for module in pkgutil.iter_modules(package.__path__)]
    named = [word for line in where.splitlines() for word in line[24:].replace(",", " ").split()]
    assert sorted(named) == sorted(there)
