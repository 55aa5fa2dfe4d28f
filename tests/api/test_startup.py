"""What only asks loads nothing that does the work: the help of the command line, and scripts on another machine."""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from api.commands.main import app

# pydantic is not among them: typer itself reads the options of a command with it
HEAVY = (
    "numpy",
    "scipy",
    "lmfit",
    "sqlalchemy",
    "numba",
    "matplotlib",
    "colour",
    "fastapi",
    "distributed",
    "asyncio",
    "rich",
)

LOADED = f"""
import sys
from api.commands.main import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)
"""


def paths(command: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """All commands and groups."""
    below = getattr(command, "commands", {})
    return [path, *(each for name in below for each in paths(below[name], (*path, name)))]


@pytest.mark.parametrize("arguments", [("--help",), ("fit", "--help"), ("simulate", "waves", "--help")])
def test_help_in_a_new_process_loads_no_numbers_and_no_database(arguments: tuple[str, ...]) -> None:
    done = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True)
    assert "Usage: " in done.stdout
    assert done.stderr.strip() == "[]"


def test_one_can_say_which_version_has_a_fault() -> None:
    stated = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["version"]
    done = subprocess.run([sys.executable, "-c", LOADED, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"goniometer {stated}\n"
    assert done.stderr.strip() == "[]"


def test_the_help_of_no_command_loads_them() -> None:
    known = paths(get_command(app))
    assert len(known) > 40
    code = f"""
import sys
from typer.main import get_command
from api.commands.main import app
for path in {known!r}:
    try:
        get_command(app)([*path, "--help"], prog_name="goniometer")
    except SystemExit as end:
        assert not end.code
print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_a_script_on_another_machine_loads_nothing_of_the_service_and_no_numerics() -> None:
    absent = ("fastapi", "starlette", "sqlalchemy", "scipy", "numba", "matplotlib", "lmfit")
    code = f"import sys, api.client; print([name for name in {absent!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
