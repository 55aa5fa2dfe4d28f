"""Answers that hold until the database or the bench changes, each made once for all who ask meanwhile.

When something happens, every page that is open asks for the same lists, all in one moment.
"""

import asyncio
from collections.abc import Callable
from typing import Annotated, cast

from fastapi import Depends, Request, Response
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from api.web.live import Live
from api.web.paging import etag, unchanged

_MOST = 100
"""Answers that are kept; a part of a list may begin anywhere."""


class Answers:
    """The answers of one application; to be asked in its event loop."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._version: object = None
        self._made: dict[str, asyncio.Future[tuple[str, str]]] = {}

    async def of(self, request: Request, make: Callable[[], BaseModel]) -> Response:
        """What `make` makes in a thread, or "not modified" to who has it.

        It must depend on nothing but the path and the query of `request`, the database, and the state of the bench.
        Raises what `make` raises.
        """
        version = self._live.store.version(), self._live.worker.shown
        if version != self._version or version[0] is None or len(self._made) >= _MOST:
            self._version = version
            self._made.clear()
        asked = f"{request.url.path}?{request.url.query}"
        made = self._made.get(asked)
        if made is None or made.cancelled():
            made = self._made[asked] = asyncio.ensure_future(run_in_threadpool(_packed, make))
        text, tag = await asyncio.shield(made)  # who goes away does not take it from the others
        return unchanged(request, Response(), tag) or Response(
            text, media_type="application/json", headers={"ETag": tag}
        )


def _packed(make: Callable[[], BaseModel]) -> tuple[str, str]:
    text = make().model_dump_json()
    return text, etag(text)


async def _answers(request: Request) -> Answers:
    return cast(Answers, request.app.state.answers)


Shared = Annotated[Answers, Depends(_answers)]
"""The answers that are made once for all, as the parameter of an endpoint."""
