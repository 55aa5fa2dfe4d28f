"""The command line as a user runs it: a process of its own, with its exit code, stdout and stderr."""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TIMEOUT = 300.0
"""Seconds that a command may take."""
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
def cli(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cli]:
    """Run the command line with these arguments in this folder, in a process of its own that is loaded already."""
    folder = tmp_path_factory.mktemp("cli")
    out, err = folder / "stdout", folder / "stderr"
    with (folder / "nursery").open("w+") as log:
        nursery = subprocess.Popen(
            [sys.executable, "-m", "tests.api.nursery"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        assert nursery.stdin is not None
        assert nursery.stdout is not None

        def run(*arguments: object, cwd: Path, typed: str = "") -> subprocess.CompletedProcess[str]:
            command = [str(argument) for argument in arguments]
            files = {"stdin": folder / "stdin", "stdout": out, "stderr": err}
            files["stdin"].write_text(typed)
            names = {name: str(path) for name, path in files.items()}
            job = {"arguments": command, "cwd": str(cwd), "timeout": TIMEOUT, **names}
            print(json.dumps(job), file=nursery.stdin, flush=True)
            answer = nursery.stdout.readline()
            assert answer, (folder / "nursery").read_text()
            code = json.loads(answer)
            if code is None:
                raise subprocess.TimeoutExpired(command, TIMEOUT, out.read_text(), err.read_text())
            return subprocess.CompletedProcess(command, code, out.read_text(), err.read_text())

        yield run
        nursery.stdin.close()
        nursery.wait()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two campaign files in it and nothing else."""
    (tmp_path / "small.yaml").write_text(SMALL)
    (tmp_path / "long.yaml").write_text(LONG)
    return tmp_path


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the small campaign, run once for all workers from end to end without interruption, from cold."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder, printed = shared / "finished", shared / "finished.json"
    with (shared / "finished.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not printed.exists():
            folder.mkdir()
            (folder / "small.yaml").write_text(SMALL)
            command = [COMMAND, "run", "small.yaml", "--json"]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=TIMEOUT)
            assert done.returncode == 0, done.stderr
            printed.write_text(done.stdout)
    return folder


@pytest.fixture
def small(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A copy of the finished small campaign, for one test to do with as it likes, and the JSON that the run printed."""
    folder = tmp_path_factory.mktemp("small") / "copy"
    shutil.copytree(finished, folder)
    return folder, json.loads(finished.with_name("finished.json").read_text())
