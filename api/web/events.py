"""GET /api/events: the stream of `api.events` as server-sent events."""

import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Request
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from api.errors import Unauthorised
from api.events import Event, Events
from api.live import Live
from api.web.access import Caller, caller_of, needs
from api.web.context import Here

LOOK_AGAIN = 15.0
"""Seconds after which a stream asks anew whether it may still be read."""

router = APIRouter(prefix="/api", tags=["events"])


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def events(
    request: Request,
    live: Here,
    caller: Annotated[Caller, needs("viewer")],
    last_event_id: Annotated[str | None, Header(description="The last event that was seen, to go on after it.")] = None,
) -> StreamingResponse:
    """What happens, as it happens: state, progress, point, spectrum, queue, mount, job, alarm and log.

    A stream that cannot go on where it stopped begins with `reset`: read everything anew. A comment comes every 15 s
    where nothing happens. The stream ends soon after the session or the token with which it was asked for.
    """
    stream = _lines(request, live, live.events.subscribe(last_event_id))
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


async def _lines(request: Request, live: Live, source: AsyncIterator[list[Event]]) -> AsyncIterator[str]:
    looked = time.monotonic()
    async for told in source:
        if time.monotonic() - looked >= LOOK_AGAIN:
            looked = time.monotonic()
            if not await run_in_threadpool(_may_still, request, live):
                return
        yield "".join(_text(live.events, event) for event in told) or ": alive\n\n"


def _may_still(request: Request, live: Live) -> bool:
    """Whether who asked has not been logged out or kept out since."""
    try:
        return caller_of(request, live.store, request.app.state.access) is not None
    except Unauthorised:
        return False


def _text(source: Events, event: Event) -> str:
    return f"id: {source.name(event)}\nevent: {event.kind}\ndata: {event.text}\n\n"
