"""The queue: which campaigns are measured, in which order, and what a running one shall do."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api.bench import queue
from api.bodies.base import Page
from api.bodies.campaigns import EntryView, Mounted, Order, Place
from api.bodies.events import EntryChanged
from api.errors import Conflict
from api.preflight import with_materials
from api.web.access import Operator, Viewer
from api.web.answers import Shared
from api.web.campaigns import checked
from api.web.context import Here, Number
from api.web.live import Live
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, check_match, etag, page
from api.web.queue_view import entry_view
from goniometer.errors import NotInStore
from goniometer.states import ACTIVE_PHASES, Command

router = APIRouter(prefix="/api/queue", tags=["queue"])


@router.get("", response_model=Page[EntryView])
async def entries(
    request: Request,
    live: Here,
    answers: Shared,
    caller: Viewer,
    finished: Annotated[
        bool, Query(description="Those that are finished, newest first, instead of the others.")
    ] = False,
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
) -> Response:
    """What is to be measured, in its order; or what was."""
    return await answers.of(request, lambda: _entries(live, after, limit, finished=finished))


@router.post("", status_code=201)
def add(live: Here, caller: Operator, order: Order) -> EntryView:
    """Append a campaign. It is measured once it is started, or after `start_after`.

    What else must be so before it can be measured, as a certificate, may still come; POST /api/campaigns/preview tells.
    """
    campaign = checked(order.campaign, live)
    if live.settings is None:
        with_materials(campaign)
    return _changed(live, queue.add_entry(live.store, campaign, caller.name, order.start_after))


@router.get("/{number}")
def entry(live: Here, response: Response, caller: Viewer, number: Number) -> EntryView:
    """One entry."""
    found = queue.entry(live.store, number)
    response.headers["ETag"] = etag(found)
    return _view(live, found)


@router.patch("/{number}")
def move(request: Request, live: Here, caller: Operator, number: Number, place: Place) -> EntryView:
    """Put an entry at another place; what is running goes on."""
    check_match(request, etag(queue.entry(live.store, number)))
    return _changed(live, queue.move_entry(live.store, number, place.position))


@router.delete("/{number}", status_code=204)
def remove(request: Request, live: Here, caller: Operator, number: Number) -> None:
    """Forget an entry; what was measured stays."""
    check_match(request, etag(queue.entry(live.store, number)))
    queue.remove_entry(live.store, number)
    live.events.publish("queue", EntryChanged(entry=number))


@router.post("/{number}/start")
def start(live: Here, caller: Operator, number: Number) -> EntryView:
    """Let an entry run when its turn comes; one that was aborted or failed goes on where it stood."""
    return _changed(live, queue.start_entry(live.store, number))


@router.post("/{number}/pause")
def pause(live: Here, caller: Operator, number: Number) -> EntryView:
    """Let a running entry pause after the point in hand; `pause_takes_effect` says when."""
    return _request(live, number, "pause")


@router.post("/{number}/resume")
def resume(live: Here, caller: Operator, number: Number) -> EntryView:
    """Let a paused entry go on; nothing happens where it is not paused."""
    return _request(live, number, "resume")


@router.post("/{number}/abort")
def abort(live: Here, caller: Operator, number: Number) -> EntryView:
    """End a running entry at once, with all that is measured kept; one that is queued waits to be started again.

    Of an entry that is "fitting" the fits are stopped; the datasets stay, and starting it again makes the fits.
    """
    wanted = queue.entry(live.store, number)
    if wanted.phase == "queued":
        return _changed(live, queue.unqueue(live.store, number))
    if wanted.campaign_id is not None and queue.is_fitting(wanted, live.store.scans(wanted.campaign_id)):
        queue.abort_fits(live.store, number)
        return _changed(live, queue.entry(live.store, number))
    return _request(live, number, "abort")


@router.post("/{number}/mounted")
async def mounted(live: Here, caller: Operator, number: Number, what: Mounted | None = None) -> EntryView:
    """Say that the sample which the prompt asks for lies on the bench."""
    queue.entry(live.store, number)
    await live.worker.call("mounted", entry=number, scan=None if what is None else what.scan)
    return _view(live, queue.entry(live.store, number))


def _entries(live: Live, after: str | None, limit: int, *, finished: bool) -> Page[EntryView]:
    if finished:
        before = None if after is None else after_number(after)
        rows = queue.finished_entries(live.store, before, limit + 1)
        return page(rows, limit, lambda row: _view(live, row), lambda row: row.id)
    start = after_number(after)
    rows = [row for row in queue.entries(live.store) if row.position > start][: limit + 1]
    return page(rows, limit, lambda row: _view(live, row), lambda row: row.position)


def _request(live: Live, number: int, command: Command) -> EntryView:
    """Ask the scan of a running entry for something. Raises `Conflict` where there is none that could do it."""
    wanted = queue.entry(live.store, number)
    if wanted.phase != "running":
        able = "start it first" if wanted.outcome != "completed" else "its campaign is completed"
        raise Conflict(f'Entry {number}, "{wanted.name}", is {wanted.phase}, so it cannot {command}; {able}')
    scans = [] if wanted.campaign_id is None else live.store.scans(wanted.campaign_id)
    active = next((scan for scan in scans if scan.phase in ACTIVE_PHASES), None)
    if active is None:
        raise Conflict(
            f'Entry {number}, "{wanted.name}", cannot {command} just now, as no scan of it is under way: the bench is '
            f"made ready, or all is measured and its fits are made; try again in a moment, or stop the bench"
        )
    if command == "resume" and active.phase == "running":
        return _view(live, wanted)
    try:
        live.store.request(active.id, command)
    except NotInStore as error:
        raise Conflict(str(error)) from None
    return _changed(live, wanted)


def _changed(live: Live, entry: queue.Entry) -> EntryView:
    """The entry as it is shown; all listeners are told that it has changed."""
    live.events.publish("queue", EntryChanged(entry=entry.id))
    return _view(live, entry)


def _view(live: Live, entry: queue.Entry) -> EntryView:
    return entry_view(live, entry, live.worker.state)
