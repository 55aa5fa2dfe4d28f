"""Questions about speed, stability and models, whose answers take minutes: each is a job, and this is what it says."""

import base64
import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response

from api.bodies.analyses import ChoiceView, Ensemble, StabilityMap, Tradeoff
from api.bodies.jobs import ChooseArguments, JobView, StabilityArguments, TradeoffArguments
from api.jobs.rows import Job, job
from api.views import analyses
from api.web.access import Operator, Viewer
from api.web.context import Here, Number
from api.web.jobs import result_text, submit
from api.web.live import Live
from goniometer.errors import NotInStore

router = APIRouter(prefix="/api", tags=["analyses"])

Name = Annotated[str, Query(max_length=100)]

_PICTURE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}
}


@router.post("/tradeoff", status_code=202)
def tradeoff(asked: TradeoffArguments, live: Here, caller: Operator) -> JobView:
    """Chart speed against accuracy on this machine: scans, fits, models, simulations."""
    return submit(live, caller, "tradeoff", asked)


@router.get("/tradeoff/{number}")
def tradeoff_charts(number: Number, live: Here, caller: Viewer) -> Tradeoff:
    """The charts of a job, with how to ask for each way oneself."""
    return analyses.tradeoff(number, _result(live, number, "tradeoff"))


@router.post("/stability", status_code=202)
def stability(asked: StabilityArguments, live: Here, caller: Operator) -> JobView:
    """Fit difficult measurements of known truth with every method, and map what fails and what says so."""
    return submit(live, caller, "stability", asked)


@router.get("/stability/{number}")
def stability_map(number: Number, live: Here, caller: Viewer) -> StabilityMap:
    """The map of a job."""
    return analyses.stability_map(number, _result(live, number, "stability"))


@router.get("/stability/{number}/ensemble")
def ensemble(number: Number, live: Here, caller: Viewer, regime: Name, level: Name, method: Name) -> Ensemble:
    """The runs behind a cell of the map."""
    return analyses.ensemble(number, _result(live, number, "stability"), regime, level, method)


@router.post("/choose", status_code=202)
def choose(asked: ChooseArguments, live: Here, caller: Operator) -> JobView:
    """The simplest model whose colours in a scene stay within a tolerance, and why each cheaper one does not do."""
    return submit(live, caller, "choose", asked)


@router.get("/choose/{number}")
def choice(number: Number, live: Here, caller: Viewer) -> ChoiceView:
    """What a job has chosen, and why."""
    return analyses.choice(number, _of_kind(live, number, "choose").arguments, _result(live, number, "choose"))


@router.get("/choose/{number}/pictures/{by}/{name}", response_class=Response, responses=_PICTURE)
def picture(
    number: Number,
    by: Annotated[Literal["shaded", "rendered"], Path(description="By this program, or by Mitsuba.")],
    name: Literal["measurement", "model", "difference"],
    live: Here,
    caller: Viewer,
) -> Response:
    """A picture of the scene, PNG."""
    for each in _result(live, number, "choose").get("pictures", []):
        if (each["by"], each["name"]) == (by, name):
            content = base64.b64decode(each["png"])
            return Response(content, media_type="image/png", headers={"Cache-Control": "private, max-age=86400"})
    raise NotInStore(f"Job {number} has no {by} picture of the {name}")


def _of_kind(live: Live, number: int, kind: str) -> Job:
    found = job(live.store, number)
    if found.kind != kind:
        raise NotInStore(f"Job {number} is of another kind, {found.kind}; this is the place of {kind}")
    return found


def _result(live: Live, number: int, kind: str) -> dict[str, Any]:
    _of_kind(live, number, kind)
    content: dict[str, Any] = json.loads(result_text(live, number))
    return content
