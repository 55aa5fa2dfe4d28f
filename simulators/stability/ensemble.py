"""Many runs of `simulators.stability.stability`, in parallel and resumable, and the map that they make."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import analysis
import drivers
import goniometer
import simulators
from goniometer.errors import DataFileError, InputError
from simulators.choices import METHODS
from simulators.stability.regimes import REGIMES
from simulators.stability.stability import Estimate, Job, Run, run

AT_ONCE = 4
"""Runs that are submitted together: a tenth of a second of work or more."""


@dataclass(frozen=True)
class Cell:
    """All runs of one level of a regime with one method."""

    regime: str
    level: str
    method: str
    runs: int
    right: float
    """Share that came out near enough to the truth to be of use; NaN where nothing has a truth."""
    trusted: float
    """Share with a good verdict."""
    silent: int
    """How many were wrong and did not say so."""
    covered: float
    """Share of the 95 % intervals under a good verdict that hold the truth; NaN of none."""
    worst: float
    """Largest deviation under a good verdict, in standard errors; 0 of none."""
    bias: dict[str, float]
    """Mean of fitted - true by parameter."""
    reached: float
    """Share of random starts that ended where the fit did; NaN where none was tried."""
    lower: int
    """How many ended lower."""
    said: str
    """What verdicts say most often; empty where they say nothing."""


def jobs(regimes: Sequence[str], methods: Sequence[str], runs: int) -> list[Job]:
    """`runs` of every level of the `regimes` with those of the `methods` to whose model it applies.

    Seeds come one after the other, so that an ensemble that was cut short has something of everything. Raises
    `InputError` for a name that is not there.
    """
    for what, names, known in (("regime", regimes, REGIMES), ("method", methods, METHODS)):
        for name in names:
            if name not in known:
                raise InputError(f'There is no {what} "{name}"; there are {"; ".join(known)}.')
    return [
        Job(regime, level.name, method, seed)
        for seed in range(1, runs + 1)
        for regime in regimes
        for level in REGIMES[regime].levels
        for method in methods
        if METHODS[method].model in REGIMES[regime].models
    ]


def ensemble(wanted: Sequence[Job], executor: Executor, resume: Path | None = None) -> Iterator[Run]:
    """All `wanted` runs, those first that the file `resume` already holds.

    New ones are appended to it, one JSON object a line, so that an ensemble that was killed goes on where it stood.
    Raises `DataFileError` for a file that this version of the program did not write.
    """
    known = {} if resume is None else _known(resume)
    yield from (known[job] for job in wanted if job in known)
    left = [job for job in wanted if job not in known]
    batches = [left[first : first + AT_ONCE] for first in range(0, len(left), AT_ONCE)]
    for batch in executor.map(_batch, batches):
        if resume is not None:
            with resume.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(_to_json(each)) + "\n" for each in batch)
        yield from batch


def cells(runs: Iterable[Run]) -> list[Cell]:
    """The map, in the order of the catalogue."""
    by_cell: dict[tuple[str, str, str], list[Run]] = {}
    for each in runs:
        by_cell.setdefault(each.job[:3], []).append(each)
    order = [
        (regime.name, level.name, method)
        for regime in REGIMES.values()
        for level in regime.levels
        for method in METHODS
    ]
    return [_cell(key, by_cell[key]) for key in order if key in by_cell]


def _batch(some: list[Job]) -> list[Run]:
    return [run(job) for job in some]


def _cell(key: tuple[str, str, str], runs: list[Run]) -> Cell:
    names = dict.fromkeys(name for each in runs for name in each.bias)
    starts = Counter(each.start for each in runs if each.start)
    said = Counter(reason for each in runs for reason in each.reasons[:1])
    return Cell(
        *key,
        runs=len(runs),
        right=_mean([each.right for each in runs]),
        trusted=_mean([float(each.trusted) for each in runs]),
        silent=sum(each.silent for each in runs),
        covered=_mean([each.covered for each in runs]),
        worst=max((abs(z) for each in runs for z in each.z.values()), default=0.0),
        bias={name: _mean([each.bias.get(name, math.nan) for each in runs]) for name in names},
        reached=starts["reached"] / starts.total() if starts else math.nan,
        lower=starts["lower"],
        said=said.most_common(1)[0][0] if said else "",
    )


def _mean(values: list[float]) -> float:
    """Of those that are known; NaN of none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


@cache
def _code() -> str:
    """Tells the code that made a run: a run is a function of nothing else."""
    digest = hashlib.sha256()
    for floor in (drivers, goniometer, analysis, simulators):
        for file in sorted(Path(floor.__path__[0]).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _to_json(each: Run) -> dict[str, Any]:
    return asdict(each) | {"job": list(each.job), "code": _code()}


def _known(resume: Path) -> dict[Job, Run]:
    """The runs of a file; a last line that a kill cut short is taken off."""
    if not resume.exists():
        return {}
    text = resume.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if whole != text:
        resume.write_bytes(whole)
    found = {}
    for number, line in enumerate(whole.decode("utf-8", "replace").splitlines(), start=1):
        try:
            content = json.loads(line)
            made_by = content.pop("code")
            content |= {"job": Job(*content["job"]), "reasons": tuple(content["reasons"])}
            content["estimates"] = {name: Estimate(**told) for name, told in content["estimates"].items()}
            each = Run(**content)
        except (ValueError, TypeError, KeyError, AttributeError):
            raise DataFileError(
                f"Line {number} of {resume} is not a run of an ensemble; name a file that this command wrote."
            ) from None
        if made_by != _code():
            raise DataFileError(f"{resume} was written by another version of this program; name a new file.")
        found[each.job] = each
    return found
