"""The page of all figures, docs/measured.md, and what is remembered of every benchmark to write it again."""

import ast
import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from tests.benchmarks.figures import HEAD, MISSED

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "measured.md"
MEMORY = ROOT / "docs" / "measured.json"
VERSIONS = ("numpy", "scipy", "numba", "mitsuba")


@dataclass(frozen=True)
class Outcome:
    """What one run of a benchmark told."""

    command: str
    date: str
    commit: str
    machine: str
    load: float
    """Load average when it began: what else the machine did."""
    minutes: float
    """By the clock."""
    processors: float
    """Minutes of processors."""
    rows: list[str]
    """Figures, as rows of a table."""
    failure: str
    """Why it is not to be trusted; empty where it ended well."""
    pace: float | None = None
    """Milliseconds of a million additions in Python when it began: how fast the machine was."""


def machine() -> str:
    """What this runs on."""
    models = [line for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines() if line.startswith("model name")]
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    software = ", ".join([f"Python {platform.python_version()}", *(f"{name} {version(name)}" for name in VERSIONS)])
    system = platform.freedesktop_os_release()["PRETTY_NAME"]
    return f"{models[0].partition(': ')[2]}, {len(models)} cores, {memory:.0f} GiB; {system}; {software}"


def remembered() -> dict[str, Outcome]:
    """The last outcome of every benchmark that was ever run."""
    if not MEMORY.exists():
        return {}
    return {name: Outcome(**each) for name, each in json.loads(MEMORY.read_text("utf-8")).items()}


def write(proofs: Mapping[str, Iterable[str]], outcomes: Mapping[str, Outcome]) -> None:
    """Write the page, and remember what it is made of; `proofs` are names of benchmarks under their headings."""
    memory = {name: asdict(each) for name, each in outcomes.items()}
    MEMORY.write_text(json.dumps(memory, indent=1, ensure_ascii=False) + "\n", "utf-8")
    machines = list(dict.fromkeys(each.machine for each in outcomes.values()))
    parts = [
        "# What was measured",
        "Written by `python -m tests.benchmarks`; please do not edit. `python -m tests.benchmarks NAME ...` runs some "
        "of the benchmarks again and leaves all other figures, with their dates. Every figure was printed by the "
        "command above it. Sizes were chosen so that all takes about 40 minutes on two idle cores; the text of "
        "each benchmark says how to ask for more. Clock times depend on what else the machine did, which `load` tells, "
        "and on how fast it was: `pace` is the time of a million additions in Python on one core.",
        *(f"Machine{f' {number}' * (len(machines) > 1)}: {each}." for number, each in enumerate(machines, 1)),
        *_summary(outcomes),
    ]
    for proof, names in proofs.items():
        parts.append(f"## {proof}")
        for name in names:
            parts += [f"### {name}", *_section(name, outcomes.get(name), machines)]
    parts += ["## What the tests prove", "The rest is no matter of figures: it holds, or a test fails.", *_tests()]
    PAGE.write_text("\n\n".join(parts) + "\n", "utf-8")


def _summary(outcomes: Mapping[str, Outcome]) -> list[str]:
    rows = [(name, row.strip("| ").split(" | ")) for name, each in outcomes.items() for row in each.rows]
    judged = [(name, cells) for name, cells in rows if len(cells) == 4]
    missed = [(name, cells) for name, cells in judged if cells[3].startswith(MISSED)]
    told = f"{len(rows)} figures, {len(judged)} of them with an aim: {len(judged) - len(missed)} met"
    lines = [
        f"- [{name}](#{name}): {what}: {measured}, aim {aim}{verdict.removeprefix(MISSED)}"
        for name, (what, measured, aim, verdict) in missed
    ]
    failed = [f"- [{name}](#{name}): {each.failure}" for name, each in outcomes.items() if each.failure]
    return [
        f"{told}, {len(missed)} missed{':' if missed else '.'}",
        *(["\n".join(lines)] if lines else []),
        *(["Benchmarks that failed:", "\n".join(failed)] if failed else []),
    ]


def _section(name: str, outcome: Outcome | None, machines: list[str]) -> list[str]:
    about = first_sentence(Path(__file__).with_name(f"{name}.py"))
    if outcome is None:
        return [about, f"Not run yet; `python -m tests.benchmarks {name}` does."]
    when = (
        f"{outcome.date}, code {outcome.commit}, {outcome.minutes:.1f} min, {outcome.processors:.1f} min of processors"
    )
    when += f", load {outcome.load:.1f} before" + (f", pace {outcome.pace:.0f} ms" if outcome.pace else "")
    where = f", machine {machines.index(outcome.machine) + 1}" if len(machines) > 1 else ""
    failure = [f"**Failed**: {outcome.failure}."] if outcome.failure else []
    table = ["\n".join([HEAD, *outcome.rows])] if outcome.rows else []
    return [about, f"`{outcome.command}` ({when}{where})", *failure, *table]


def first_sentence(module: Path) -> str:
    """What a module says of itself in its first line."""
    text = ast.get_docstring(ast.parse(module.read_text("utf-8")))
    return "**says nothing of itself**" if text is None else text.partition("\n\n")[0].replace("\n", " ")


def _tests() -> list[str]:
    folders: dict[str, list[str]] = {}
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        folder = str(file.parent.relative_to(ROOT))
        folders.setdefault(folder, []).append(f"- `{file.name}`: {first_sentence(file)}")
    return [part for folder, lines in folders.items() for part in (f"### {folder}", "\n".join(lines))]
