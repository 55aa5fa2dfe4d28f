"""Errors become RFC 9457 problems: `application/problem+json` with one sentence for the person who asked."""

import logging
import math
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from analysis.errors import AnalysisError, SceneError, UnknownConductor
from api.bodies.service import PROBLEM, Fault, Problem
from api.errors import Conflict, Misdirected, NotAllowed, Outdated, TooLarge, TooManyFailures, Unauthorised
from api.named_errors import name_of
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, InputError, NotInStore, OptionError, StoreBusy, StoreFull
from goniometer.wording import and_more, key_path

log = logging.getLogger(__name__)


STATUS: dict[type[Exception], HTTPStatus] = {
    NotInStore: HTTPStatus.NOT_FOUND,
    Conflict: HTTPStatus.CONFLICT,
    StoreBusy: HTTPStatus.CONFLICT,
    Unauthorised: HTTPStatus.UNAUTHORIZED,
    NotAllowed: HTTPStatus.FORBIDDEN,
    Outdated: HTTPStatus.PRECONDITION_FAILED,
    TooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    Misdirected: HTTPStatus.MISDIRECTED_REQUEST,
    TooManyFailures: HTTPStatus.TOO_MANY_REQUESTS,
    InputError: HTTPStatus.UNPROCESSABLE_ENTITY,
    UnknownConductor: HTTPStatus.UNPROCESSABLE_ENTITY,
    SceneError: HTTPStatus.UNPROCESSABLE_ENTITY,
    StoreFull: HTTPStatus.INSUFFICIENT_STORAGE,
    # what was asked for was right, and what is there does not allow it
    AnalysisError: HTTPStatus.CONFLICT,
    GoniometerError: HTTPStatus.CONFLICT,
    DriverError: HTTPStatus.BAD_GATEWAY,
}
"""Status of an error, by the nearest of its bases."""

TOLD = {
    401: "Nobody knows who asks: log in, or send a token.",
    403: "Who asks may not do this.",
    404: "It is not there.",
    405: "There is no such method here.",
    406: "It does not come in a form that is accepted.",
    408: "What was being sent did not come for half a minute.",
    409: "It is not possible now; the detail says why and what is.",
    412: "It was changed since it was read.",
    413: "More was sent than is read.",
    415: "What was sent has a form that is not read.",
    421: "This service does not have the name by which it was called.",
    422: "What was sent cannot be right.",
    429: "Logins failed so often that the next must wait.",
    502: "A device of the bench does not do what it should.",
    507: "There is no room left on the disk.",
}
"""What every operation may answer instead of its result."""


def status_of(error: Exception) -> HTTPStatus:
    """The status that tells of an error of our floors."""
    return next(STATUS[base] for base in type(error).__mro__ if base in STATUS)


def problem(
    status: int, detail: str, kind: str, errors: list[Fault] | None = None, headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """The response that tells of a problem; `kind` names it for programs, as "not-in-store"."""
    title = HTTPStatus(status).phrase
    content = Problem(type=f"urn:goniometer:{kind}", title=title, status=status, detail=detail, errors=errors or [])
    return JSONResponse(content.model_dump(), status, headers, PROBLEM)


def install(app: FastAPI) -> None:
    """Let `app` answer errors as problems. What nobody foresaw is logged, and told without what is inside."""
    for kind in (GoniometerError, AnalysisError, DriverError):
        app.add_exception_handler(kind, _known)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _refused)
    app.add_exception_handler(Exception, _unforeseen)


def describe_problems(schema: dict[str, Any]) -> dict[str, Any]:
    """An OpenAPI document in which every operation may answer every problem of `TOLD`."""
    parts = schema.setdefault("components", {}).setdefault("schemas", {})
    parts["Fault"] = Fault.model_json_schema()
    parts["Problem"] = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    parts["Problem"].pop("$defs", None)
    content = {PROBLEM: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    for operations in schema["paths"].values():
        for operation in operations.values():
            operation["responses"] |= {
                str(status): {"description": text, "content": content} for status, text in TOLD.items()
            }
    for unused in ("HTTPValidationError", "ValidationError"):
        parts.pop(unused, None)
    return schema


def told(error: Exception) -> JSONResponse:
    """The response that tells of an error of our floors."""
    status = status_of(error)
    headers = {"WWW-Authenticate": "Bearer"} if status is HTTPStatus.UNAUTHORIZED else {}
    if isinstance(error, TooManyFailures):
        headers["Retry-After"] = str(math.ceil(error.seconds))
    detail = error.by_field if isinstance(error, OptionError) else str(error)
    return problem(status, detail, name_of(type(error)), headers=headers)


async def _known(_: Request, error: Exception) -> JSONResponse:
    return told(error)


async def _invalid(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    faults = []
    for fault in error.errors():
        message = str(fault["msg"]).removeprefix("Value error, ").replace("Input should", "it must")
        # the first part says whether it was the body, the path, ...: of no use to who reads a key
        faults.append(Fault(where=key_path(fault["loc"][1:]), message=message))
    first = f"{faults[0].where}: {faults[0].message}" if faults[0].where else faults[0].message
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, first + and_more(len(faults) - 1), "input-error", faults)


async def _refused(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    detail = error.detail if error.detail != HTTPStatus(error.status_code).phrase else TOLD.get(error.status_code, "")
    kind = HTTPStatus(error.status_code).name.lower().replace("_", "-")
    return problem(error.status_code, detail, kind, headers=error.headers)


async def _unforeseen(request: Request, error: Exception) -> JSONResponse:
    log.error("%s %s", request.method, request.url.path, exc_info=error)
    detail = "The service has met a fault of its own; its log says which."
    return problem(HTTPStatus.INTERNAL_SERVER_ERROR, detail, "internal")
