"""GET /api/events: the stream of `api.events` as server-sent events."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from api.events import Event, Events
from api.web.access import Caller, needs
from api.web.context import Here

router = APIRouter(prefix="/api", tags=["events"])


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def events(
    live: Here,
    caller: Annotated[Caller, needs("viewer")],
    last_event_id: Annotated[str | None, Header(description="The last event that was seen, to go on after it.")] = None,
) -> StreamingResponse:
    """What happens, as it happens: state, progress, point, spectrum, queue, mount, job, alarm and log.

    A stream that cannot go on where it stopped begins with `reset`: read everything anew. A comment comes every 15 s
    where nothing happens.
    """
    stream = _lines(live.events, last_event_id)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


async def _lines(source: Events, after: str | None) -> AsyncIterator[str]:
    async for told in source.subscribe(after):
        yield "".join(_text(source, event) for event in told) or ": alive\n\n"


def _text(source: Events, event: Event) -> str:
    return f"id: {source.name(event)}\nevent: {event.kind}\ndata: {event.text}\n\n"
