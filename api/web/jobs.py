"""Work that takes longer than an answer may: what is asked for, how far it is, and what came of it."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import HTMLResponse

from api.access.accounts import at_least
from api.access.tokens import Caller
from api.bodies.base import Asked, Page
from api.bodies.jobs import JobView, State
from api.errors import Conflict, NotAllowed
from api.jobs.checks import check
from api.jobs.kinds import KINDS
from api.jobs.rows import all_jobs, job, page_of, result_of
from api.jobs.view import job_view
from api.web.access import Operator, Viewer
from api.web.context import Here, Number
from api.web.live import Live
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, page
from goniometer.errors import NotInStore

router = APIRouter(prefix="/api/jobs", tags=["jobs"])


_SEALED = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; sandbox"
"""A page holds its own style and pictures, and no script has anything to do in it."""


@router.get("")
def list_jobs(
    live: Here,
    caller: Viewer,
    state: Annotated[tuple[State, ...], Query(description="Only those in one of these states.")] = (),
    kind: Annotated[str | None, Query(max_length=40, description="Only those of this kind.")] = None,
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
) -> Page[JobView]:
    """All jobs, newest first."""
    before = None if after is None else after_number(after)
    return page(all_jobs(live.store, limit + 1, before, state, kind), limit, job_view, lambda row: row.id)


@router.get("/{number}")
def one_job(number: Number, live: Here, caller: Viewer) -> JobView:
    """A job."""
    return job_view(job(live.store, number))


@router.get("/{number}/result", responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}})
def result(number: Number, live: Here, caller: Viewer) -> Response:
    """What came of a job, as the command of the same name prints it with --json."""
    return Response(result_text(live, number), media_type="application/json")


@router.get("/{number}/page", response_class=HTMLResponse)
def job_page(number: Number, live: Here, caller: Viewer) -> HTMLResponse:
    """The page that a job made: self-contained HTML with its figures."""
    text = page_of(live.store, number)
    if text is None:
        raise _without(live, number, "page")
    return HTMLResponse(text, headers={"Content-Security-Policy": _SEALED})


@router.post("/{number}/again", status_code=202)
def again(number: Number, live: Here, caller: Operator) -> JobView:
    """Run a job anew that is over, with the same arguments; needs whatever role the first one needed."""
    role = KINDS[job(live.store, number).kind].role
    if not at_least(caller.role, role):
        raise NotAllowed(f"This needs the role {role}, and {caller.name} has the role {caller.role} here")
    return job_view(live.jobs.again(number, caller.name))


@router.delete("/{number}")
def cancel(number: Number, live: Here, caller: Operator) -> JobView:
    """End a job, whatever it is doing; what it has written so far stays."""
    return job_view(live.jobs.cancel(number))


def submit(live: Live, caller: Caller, kind: str, arguments: Asked) -> JobView:
    """Have a job done for who asks, unless it is plain now that it cannot be done."""
    check(live.store, arguments)
    return job_view(live.jobs.submit(kind, arguments, caller.name))


def result_text(live: Live, number: int) -> str:
    """What came of a job as JSON; raises `Conflict` where it has not ended, and `NotInStore`."""
    text = result_of(live.store, number)
    if text is None:
        raise _without(live, number, "result")
    return text


def _without(live: Live, number: int, what: str) -> Conflict | NotInStore:
    found = job(live.store, number)
    if found.state in {"waiting", "running"}:
        return Conflict(f"Job {number} is {found.state} and has no {what} yet; wait for its end")
    return NotInStore(f"Job {number} is {found.state} and has no {what}")
