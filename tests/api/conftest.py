"""The command line as a user runs it: a process of its own, with its exit code, stdout and stderr."""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

COMMAND = str(Path(sys.executable).with_name("goniometer"))

LONG = """
name: Long
samples:
  - {name: Sample 1, material: sample-1}
  - {name: Sample 2, material: sample-2}
  - {name: Sample 3, material: sample-3}
"""
"""A campaign that takes long enough for another command to reach it."""

Cli = Callable[..., subprocess.CompletedProcess[str]]

SMALL = """
name: Small
seed: 3
samples:
  - {name: Sample 1, material: sample-1}
  - {name: Mirror, material: mirror}
incident: [20, 60]
resolution: {tolerance: 0.02, colour_tolerance: 1}
monitor: null
"""
"""A campaign of two incident angles that takes seconds; without monitors an interruption changes nothing."""


@pytest.fixture(scope="session")
def cli() -> Cli:
    """Run the command line with these arguments in this folder."""

    def run(*arguments: object, cwd: Path, **options: Any) -> subprocess.CompletedProcess[str]:
        command: Sequence[str] = [COMMAND, *map(str, arguments)]
        return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=300, **options)

    return run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two campaign files in it and nothing else."""
    (tmp_path / "small.yaml").write_text(SMALL)
    (tmp_path / "long.yaml").write_text(LONG)
    return tmp_path


@pytest.fixture(scope="session")
def small(cli: Cli, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder and JSON of the small campaign, run once from end to end without interruption."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.yaml").write_text(SMALL)
    done = cli("run", "small.yaml", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)
