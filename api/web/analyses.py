"""Questions about speed, stability and models, whose answers take minutes: each is a job with a page."""

from typing import Annotated

from fastapi import APIRouter

from api.job_arguments import ChooseArguments, StabilityArguments, TradeoffArguments
from api.views.jobs import JobView
from api.web.access import Caller, needs
from api.web.context import Here
from api.web.jobs import submit

router = APIRouter(prefix="/api", tags=["analyses"])

Operator = Annotated[Caller, needs("operator")]


@router.post("/tradeoff", status_code=202)
def tradeoff(asked: TradeoffArguments, live: Here, caller: Operator) -> JobView:
    """Chart speed against accuracy on this machine: scans, fits, models, simulations."""
    return submit(live, caller, "tradeoff", asked)


@router.post("/stability", status_code=202)
def stability(asked: StabilityArguments, live: Here, caller: Operator) -> JobView:
    """Fit difficult measurements of known truth with every method, and map what fails and what says so."""
    return submit(live, caller, "stability", asked)


@router.post("/choose", status_code=202)
def choose(asked: ChooseArguments, live: Here, caller: Operator) -> JobView:
    """The simplest model whose colours in a scene stay within a tolerance, and why each cheaper one does not do."""
    return submit(live, caller, "choose", asked)
