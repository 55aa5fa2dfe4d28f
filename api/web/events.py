"""GET /api/events: the stream of `api.events` as server-sent events."""

import time
from collections.abc import AsyncIterator
from functools import lru_cache
from typing import Annotated, Any, get_args

from fastapi import APIRouter, Header, Request
from fastapi.responses import StreamingResponse

from api.bodies.events import EventData, EventKind
from api.errors import Unauthorised
from api.events import Event, Events
from api.web.access import Viewer, shown_by
from api.web.context import Here
from api.web.live import Live

LOOK_AGAIN = 15.0
"""Seconds after which a stream asks anew whether it may still be read."""

router = APIRouter(prefix="/api", tags=["events"])

_SCHEMAS = "#/components/schemas/"


def _line(kind: EventKind) -> dict[str, Any]:
    """The schema of an event of that kind, as OpenAPI 3.2 describes server-sent events."""
    told = {"$ref": f"{_SCHEMAS}{EventData.__name__}/properties/{kind}"}
    fields = {
        "id": {"type": "string"},
        "event": {"const": kind},
        "data": {"type": "string", "contentMediaType": "application/json", "contentSchema": told},
    }
    return {"type": "object", "required": list(fields), "properties": fields}


_STREAM = {"schema": {"type": "string"}, "itemSchema": {"oneOf": [_line(kind) for kind in get_args(EventKind)]}}


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": _STREAM}}},
)
async def events(
    request: Request,
    live: Here,
    caller: Viewer,
    last_event_id: Annotated[str | None, Header(description="The last event that was seen, to go on after it.")] = None,
) -> StreamingResponse:
    """What happens, as it happens: state, progress, point, spectrum, queue, mount, job, alarm and log.

    The schema `EventData` says what an event of each kind tells. `reset` says that events were missed: read everything
    anew. A stream that cannot go on where it stopped begins with it. A comment comes every 15 s where nothing happens.
    The stream ends soon after the session or the token with which it was asked for.
    """
    stream = _lines(request, live, live.events.subscribe(last_event_id))
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


def describe_events(schema: dict[str, Any]) -> dict[str, Any]:
    """An OpenAPI document with the schema of what events tell, which is the model of no answer."""
    told = EventData.model_json_schema(ref_template=_SCHEMAS + "{model}", mode="serialization")
    parts = schema["components"]["schemas"]
    schema["components"]["schemas"] = told.pop("$defs") | {EventData.__name__: told} | parts
    return schema


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
