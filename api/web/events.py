"""GET /api/events: the stream of `api.events` as server-sent events."""

import time
from collections.abc import AsyncIterator
from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Header, Request
from fastapi.responses import StreamingResponse

from api.errors import Unauthorised
from api.events import Event, Events
from api.web.access import Caller, needs, shown_by
from api.web.context import Here
from api.web.live import Live

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


async def _lines(request: Request, live: Live, source: AsyncIterator[tuple[Event, ...]]) -> AsyncIterator[bytes]:
    looked = time.monotonic()
    async for told in source:
        if time.monotonic() - looked >= LOOK_AGAIN:
            looked = time.monotonic()
            if not await _may_still(request, live):
                return
        yield _chunk(live.events, told)


async def _may_still(request: Request, live: Live) -> bool:
    """Whether who asked has not been logged out or kept out since."""
    shown = shown_by(request, request.app.state.access)
    try:
        return shown is not None and await live.callers.anew(shown) is not None
    except Unauthorised:
        return False


@lru_cache(maxsize=8)  # most listeners are told the same
def _chunk(source: Events, told: tuple[Event, ...]) -> bytes:
    lines = "".join(f"id: {source.name(event)}\nevent: {event.kind}\ndata: {event.text}\n\n" for event in told)
    return (lines or ": alive\n\n").encode()
