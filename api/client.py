"""The Python client of a running service, once for scripts that wait for each answer and once for asyncio.

Both carry out the same `api.calls`. What the service refuses arrives as the exception that the same work raises here,
e.g. `goniometer.errors.NotInStore` or `api.errors.Conflict`, with the `Refused` of the service as its `__cause__`; or,
as `RawDamaged` does, as a base of it: see `api.named_errors`.

ServiceError
├── Refused      the service did not do what it was asked
├── Unreachable  nothing answers, or something that is not the service, or the connection broke
│   └── TimedOut   it answers, but this answer did not come in time
└── JobFailed    a job did not come to its end
"""

import asyncio
import re
import ssl
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Iterator
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar, cast, get_args

import httpx
import httpx_sse
from pydantic import ValidationError

from api import calls
from api.bodies.base import Page
from api.bodies.events import AnyData, EventKind, read_data
from api.bodies.jobs import OPEN, JobView
from api.bodies.service import PROBLEM, Problem
from api.call import Call
from api.errors import ServiceError
from api.named_errors import error_named
from goniometer.errors import InputError

T = TypeVar("T")

_TIMEOUT = httpx.Timeout(60.0, connect=10.0)
_QUIET = 45.0
"""Seconds without a word, of three heartbeats, after which a stream of events is taken for dead."""
_AGAIN = 1.0
"""Seconds until a broken stream of events is opened anew."""
_TRIES = 30
"""How often that is tried in a row."""
_LOOK = 0.3
"""Seconds between two looks at a job."""


class Refused(ServiceError):
    """The service did not do what it was asked; `problem` says why, `method` and `path` what was asked."""

    def __init__(self, problem: Problem, request: httpx.Request) -> None:
        super().__init__(problem.detail)
        self.problem = problem
        self.method, self.path = request.method, request.url.path


class Unreachable(ServiceError):
    """Nothing answers at the address of the service, or something that is not it, or the connection broke.

    `method` and `path` say what was asked.
    """

    def __init__(self, message: str, request: httpx.Request) -> None:
        super().__init__(message)
        self.method, self.path = request.method, request.url.path


class TimedOut(Unreachable):
    """The answer did not come in time; what was asked for may be done nevertheless."""


class JobFailed(ServiceError):
    """A job did not come to its end; `job` says why."""

    def __init__(self, job: JobView) -> None:
        super().__init__(f"Job {job.id} ({job.kind}) is {job.state}: {job.reason}")
        self.job = job


@dataclass(frozen=True)
class Event:
    """Something that happened on the bench or around it."""

    kind: EventKind
    """Of what it tells; "reset": some were missed, so read everything anew."""
    data: AnyData
    """What it tells: `api.bodies.events.EventData` says which model each kind has."""
    name: str
    """By which the stream goes on after it."""


class Client:
    """A service, as a script sees it that waits for each answer; use it in a `with` block, or `close` it."""

    def __init__(self, url: str, token: str, *, verify: ssl.SSLContext | bool = True) -> None:
        """`url` is e.g. http://127.0.0.1:8000, `token` one of `goniometer token create`.

        `verify` is how the certificate of an https address is checked, as httpx takes it. Raises `InputError` for what
        can be no address or no token.
        """
        self._http = httpx.Client(base_url=_address(url), headers=_headers(token), timeout=_TIMEOUT, verify=verify)

    def __enter__(self) -> Self:
        """Begin to use it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connections."""
        self.close()

    def close(self) -> None:
        """Close the connections; nothing can be asked then."""
        self._http.close()

    def __call__(self, call: Call[T]) -> T:
        """Carry out a call; raises what the service refuses, and `Unreachable`."""
        try:
            response = self._http.send(_request(self._http, call))
        except httpx.TransportError as error:
            raise _unreachable(self._http.base_url, error) from error
        return _answer(call, response)

    def every(self, call: Call[Page[T]]) -> Iterator[T]:
        """All items of a list, page after page."""
        while True:
            page = self(call)
            yield from page.items
            if page.next is None:
                return
            call = _next(call, page.next)

    def wait(self, job: JobView, watch: Callable[[JobView], object] = lambda _: None) -> dict[str, Any]:
        """The result of a job, once it is there; `watch` is called with every look at it. Raises `JobFailed`."""
        while job.state in OPEN:
            watch(job)
            time.sleep(_LOOK)
            job = self(calls.job(job.id))
        watch(job)
        return self(_result(job))

    def events(self, after: str | None = None) -> Generator[Event, None, None]:
        """What happens from now on, or after the event of that name; through breaks of the network, until it is closed.

        Raises `Unreachable` where the service does not come back for half a minute, and what it refuses.
        """
        tries = 0
        while True:
            try:
                with httpx_sse.connect_sse(self._http, "GET", "/api/events", **_stream(after)) as source:
                    _check_stream(source.response, source.response.read)
                    tries = 0
                    for sent in source.iter_sse():
                        after = sent.id or after
                        if sent.data:  # a heartbeat has none
                            yield _event(sent, source.response)
            except httpx.TransportError as error:
                tries += 1
                if tries > _TRIES:
                    raise _unreachable(self._http.base_url, error) from error
            time.sleep(_AGAIN)


class AsyncClient:
    """A service, as an asyncio program sees it; use it in an `async with` block."""

    def __init__(self, url: str, token: str, *, verify: ssl.SSLContext | bool = True) -> None:
        """As of `Client`."""
        self._http = httpx.AsyncClient(base_url=_address(url), headers=_headers(token), timeout=_TIMEOUT, verify=verify)

    async def __aenter__(self) -> Self:
        """Begin to use it."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def __call__(self, call: Call[T]) -> T:
        """Carry out a call; raises what the service refuses, and `Unreachable`."""
        try:
            response = await self._http.send(_request(self._http, call))
        except httpx.TransportError as error:
            raise _unreachable(self._http.base_url, error) from error
        return _answer(call, response)

    async def every(self, call: Call[Page[T]]) -> AsyncIterator[T]:
        """All items of a list, page after page."""
        while True:
            page = await self(call)
            for item in page.items:
                yield item
            if page.next is None:
                return
            call = _next(call, page.next)

    async def wait(self, job: JobView, watch: Callable[[JobView], object] = lambda _: None) -> dict[str, Any]:
        """The result of a job, once it is there; `watch` is called with every look at it. Raises `JobFailed`."""
        while job.state in OPEN:
            watch(job)
            await asyncio.sleep(_LOOK)
            job = await self(calls.job(job.id))
        watch(job)
        return await self(_result(job))

    async def events(self, after: str | None = None) -> AsyncGenerator[Event, None]:
        """What happens, as `Client.events` tells it."""
        tries = 0
        while True:
            try:
                async with httpx_sse.aconnect_sse(self._http, "GET", "/api/events", **_stream(after)) as source:
                    if source.response.is_error:
                        await source.response.aread()
                    _check_stream(source.response, lambda: None)
                    tries = 0
                    async for sent in source.aiter_sse():
                        after = sent.id or after
                        if sent.data:  # a heartbeat has none
                            yield _event(sent, source.response)
            except httpx.TransportError as error:
                tries += 1
                if tries > _TRIES:
                    raise _unreachable(self._http.base_url, error) from error
            await asyncio.sleep(_AGAIN)


def _address(url: str) -> str:
    if not re.fullmatch(r"https?://[^\s/]\S*", url or ""):
        raise InputError(f'"{url}" is not the address of a service; give e.g. http://127.0.0.1:8000')
    return url


def _headers(token: str) -> dict[str, str]:
    if not re.fullmatch("[!-~]+", token or ""):  # whatever it is, it is not told: it is a secret
        raise InputError(
            "The token is empty, or has characters that none has, as a line break; "
            "give it as goniometer token create prints it"
        )
    return {"Authorization": f"Bearer {token}"}


def _request(http: httpx.Client | httpx.AsyncClient, call: Call[Any]) -> httpx.Request:
    headers = {"Accept": call.accept} | ({} if call.content is None else {"Content-Type": call.content_type})
    query = {name: value for name, value in call.query.items() if value is not None}
    return http.build_request(call.method, call.path, params=query, content=call.content, headers=headers)


def _answer(call: Call[T], response: httpx.Response) -> T:
    if not response.is_success:
        raise _refusal(response)
    try:
        return call.read(response)
    except ValidationError as error:
        raise _stranger(response) from error


def _stranger(response: httpx.Response) -> Unreachable:
    told = f"{response.url} answers something else than this client expects; use the client of its version"
    return Unreachable(told, response.request)


def _refusal(response: httpx.Response) -> Exception:
    """The exception that a response stands for."""
    if response.headers.get("content-type") != PROBLEM:
        told = f"{response.url} answers {response.status_code} and is no service of this kind"
        return Unreachable(told, response.request)
    problem = Problem.model_validate_json(response.content)
    refused = Refused(problem, response.request)
    error = error_named(problem.type.rpartition(":")[2], problem.detail)
    if error is None:
        return refused
    error.__cause__ = refused
    return error


def _unreachable(url: httpx.URL, error: httpx.TransportError) -> Unreachable:
    asked, why = f"{error.request.method} {error.request.url.path}", error or type(error).__name__
    match error:
        case httpx.ReadTimeout() | httpx.WriteTimeout():
            told = f"{url} has not answered {asked} in time; it may do it nevertheless, so look before you ask again"
            return TimedOut(told, error.request)
        case httpx.ReadError() | httpx.WriteError() | httpx.RemoteProtocolError():
            told = f"{url} broke off {asked} ({why}); it may be done nevertheless, so look before you ask again"
            return Unreachable(told, error.request)
        case _:
            return Unreachable(f"{url} does not answer ({why}); start it with: goniometer serve", error.request)


def _next(call: Call[T], after: str) -> Call[T]:
    return replace(call, query=call.query | {"after": after})


def _result(job: JobView) -> Call[dict[str, Any]]:
    if job.state != "done":
        raise JobFailed(job)
    return calls.job_result(job.id)


def _stream(after: str | None) -> dict[str, Any]:
    timeout = httpx.Timeout(10.0, read=_QUIET)
    return {"timeout": timeout, "headers": {} if after is None else {"Last-Event-ID": after}}


def _check_stream(response: httpx.Response, read: Callable[[], object]) -> None:
    if response.is_error:
        read()
        raise _refusal(response)


def _event(sent: httpx_sse.ServerSentEvent, response: httpx.Response) -> Event:
    kind = cast(EventKind, sent.event)
    if kind not in get_args(EventKind):
        raise _stranger(response)
    try:
        return Event(kind, read_data(kind, sent.data), sent.id)
    except ValidationError as error:
        raise _stranger(response) from error
