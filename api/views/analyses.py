"""What came of questions about speed, stability and models, so that pages can draw it and act on it."""

import json
from typing import Any

from api.bodies.analyses import ChoiceView, Ensemble, RunView, StabilityCell, StabilityMap, Tradeoff
from goniometer.errors import NotInStore


def tradeoff(job: int, result: dict[str, Any]) -> Tradeoff:
    """The charts of a job."""
    return Tradeoff(job=job, charts=result["charts"])


def stability_map(job: int, result: dict[str, Any]) -> StabilityMap:
    """The map of a job."""
    cells = [StabilityCell(**cell) for cell in result["cells"]]
    about = {regime: result["regimes"][regime] for regime in dict.fromkeys(cell.regime for cell in cells)}
    return StabilityMap(job=job, regimes=about, methods=list(dict.fromkeys(cell.method for cell in cells)), cells=cells)


def ensemble(job: int, result: dict[str, Any], regime: str, level: str, method: str) -> Ensemble:
    """The runs behind a cell; raises `NotInStore` where there is no such cell, or an older version kept no runs."""
    asked = regime, level, method
    cell = next((c for c in result["cells"] if (c["regime"], c["level"], c["method"]) == asked), None)
    if cell is None:
        raise NotInStore(f"Job {job} has no cell {regime}, {level}, {method}; its map lists them")
    if "runs" not in result:
        raise NotInStore(f"Job {job} was run by a version that did not keep single runs; run it again")
    mine = [run for run in result["runs"] if tuple(run["job"][k] for k in ("regime", "level", "method")) == asked]
    runs = [RunView(**{"seed": run["job"]["seed"]} | run) for run in mine]
    return Ensemble(
        job=job,
        about=result["regimes"][regime],
        cell=StabilityCell(**cell),
        runs=sorted(runs, key=lambda run: run.seed),
    )


def choice(job: int, arguments: str, result: dict[str, Any]) -> ChoiceView:
    """What a job has chosen; raises `NotInStore` where an older version wrote it down otherwise."""
    if "words" not in result:
        raise NotInStore(f"Job {job} was run by a version that kept less of it; run it again")
    return ChoiceView(
        job=job,
        dataset=result["dataset"],
        sample=result["sample"],
        scene=json.loads(arguments)["scene"],
        tolerance=result["tolerance"],
        words=result["words"],
        chosen=result["chosen"],
        rungs=result["rungs"],
        fewer=result["too_few_wavelengths"],
        rendered=result["rendered"] or [],
        pictures=result["pictures"],
    )
