"""What every request passes before an endpoint sees it, and what is logged of it afterwards.

Nobody gets past who comes under a name that is not this service's (a name of another site that was made to lead here),
whose browser says that a page of another site asks, or who brings a session without its `X-CSRF-Token` to change
something. What changes something is refused unread where nobody knows who asks, and logged with its outcome where
somebody does.
"""

import asyncio
import json
import re
from hmac import compare_digest
from http import HTTPStatus
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.audit import record_done
from api.access.callers import Callers
from api.access.tokens import PREFIX, Caller, csrf_token
from api.bodies.access import Via
from api.errors import Misdirected, NotAllowed, ServiceError, TooLarge, Unauthorised
from api.web import patience
from api.web.access import Access, cookie_name, shown_by
from api.web.problems import told
from goniometer.errors import StoreError
from goniometer.storage.database import Database

SAFE = {"GET", "HEAD", "OPTIONS"}
LOGIN = "/api/login"
_PERSONAL = (LOGIN, "/api/me", "/api/users", "/api/tokens")
"""Below these, bodies hold secrets and are never logged, not even where a key is misspelt."""
_CHANGES_NOTHING = {"/api/campaigns/validate", "/api/campaigns/preview"}
"""A page asks for these while somebody types; the log would hold little else."""
_TOKEN = re.compile(re.escape(PREFIX) + r"[\w-]+")
_NOTED = 4096
"""Bytes of another body that the log may hold."""


class Gate:
    """The gate in front of `app`; an endpoint finds the caller (None: nobody knows) as `request.state.caller`.

    What it adds to the dictionary `request.state.about` is logged with a request that changes something.
    """

    def __init__(self, app: ASGIApp, store: Database, callers: Callers, access: Access) -> None:
        self._app = app
        self._store = store
        self._callers = callers
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or answer it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        request.state.caller, request.state.about = None, {}
        try:
            self._check_names(request)
            shown = shown_by(request, self._access)
            request.state.caller = None if shown is None else await self._callers.of(shown)
            self._check_unsafe(request)
        except (ServiceError, StoreError) as error:
            response = told(error)
            if request.state.caller is not None:
                await self._log(request, response.status_code, b"")
            await response(scope, receive, send)
            return
        if request.method in SAFE:
            await self._app(scope, receive, send)
        else:
            await self._watched(request, receive, send)

    def _check_names(self, request: Request) -> None:
        host = request.headers.get("host", "")
        if not self._access.answers_to(host):
            raise Misdirected(f'This service is not called "{host[:100]}"; allow the name with: serve --host-name')
        origin = request.headers.get("origin")
        if request.method not in SAFE and origin is not None and origin.partition("://")[2].lower() != host.lower():
            raise NotAllowed("A page of another site may not ask for this; open the pages of this service")

    def _check_unsafe(self, request: Request) -> None:
        """Refuse, before its body is read, what changes something and comes from nobody or unasked from a browser."""
        caller: Caller | None = request.state.caller
        if request.method in SAFE or request.url.path == LOGIN:
            return
        if caller is None:
            raise Unauthorised("Nobody knows who asks; log in, or send a token as: Authorization: Bearer TOKEN")
        if caller.via == "session":
            session = request.cookies[cookie_name(self._access)]
            if not compare_digest(request.headers.get("x-csrf-token", "").encode(), csrf_token(session).encode()):
                raise NotAllowed("The header X-CSRF-Token is not that of this session; GET /api/me tells it")

    async def _watched(self, request: Request, receive: Receive, send: Send) -> None:
        body, answered, refused, whole = bytearray(), False, False, False

        async def reading() -> Message:
            nonlocal whole
            try:
                # after the body, an application only waits for whoever asks to go away
                async with asyncio.timeout(None if whole else patience.BODY_TIME):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, headers={"Connection": "close"}) from None
            whole = not message.get("more_body", False)
            if len(body) <= _NOTED:
                body.extend(message.get("body", b"")[: _NOTED + 1])
            return message

        async def answering(message: Message) -> None:
            nonlocal answered, refused
            if message["type"] == "http.response.start":
                answered = True
                self._callers.forget()  # it may have been about them
                await self._log(request, message["status"], bytes(body))
                # the library's own answer to a large body is plain text
                plain = Headers(raw=message["headers"]).get("content-type", "").startswith("text/plain")
                refused = message["status"] == HTTPStatus.REQUEST_ENTITY_TOO_LARGE and plain
                if refused:
                    await told(TooLarge("More was sent than is read here"))(request.scope, receive, send)
            if not refused:
                await send(message)

        try:
            await self._app(request.scope, reading, answering)
        finally:
            if not answered:  # a fault of ours, or nobody waited for the answer
                await self._log(request, HTTPStatus.INTERNAL_SERVER_ERROR, bytes(body))

    async def _log(self, request: Request, status: int, body: bytes) -> None:
        """Note what somebody did before they learn how it went."""
        caller: Caller | None = request.state.caller
        if request.url.path in _CHANGES_NOTHING:
            return
        if caller is None and "login" not in request.state.about:
            return  # somebody who must wait for the next login would otherwise fill the log
        path = request.url.path
        action = f"{request.method} {getattr(request.scope.get('route'), 'path', path[:200])}"
        about: dict[str, Any] = {"status": status, "from": request.client.host if request.client else ""}
        if not action.endswith(path):
            about["path"] = path[:500]
        if not path.startswith(_PERSONAL):
            about |= _sent(request, body)
        about |= request.state.about
        who = "nobody" if caller is None else caller.name
        via: Via = "nobody" if caller is None else caller.via
        # whoever stops the bench must get an answer when the disk is full, too
        await run_in_threadpool(record_done, self._store, who, action, about, via)


def _sent(request: Request, body: bytes) -> dict[str, Any]:
    """What the log holds of the query and of a short JSON body, without tokens that stand where none is asked for."""
    found: dict[str, Any] = {}
    if request.url.query:
        found["query"] = {name: _TOKEN.sub("a token", value) for name, value in request.query_params.items()}
    if "json" in request.headers.get("content-type", "") and 0 < len(body) <= _NOTED:
        try:
            found["body"] = json.loads(_TOKEN.sub("a token", body.decode()))
        except (ValueError, RecursionError):
            found["body"] = "no JSON"
    return found
