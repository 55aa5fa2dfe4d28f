"""Long lists in pages, and answers that need not be sent twice."""

import hashlib
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

from fastapi import Query, Request, Response

from api.bodies.base import Page
from api.errors import Outdated
from goniometer.errors import InputError

T = TypeVar("T")
R = TypeVar("R")

Limit = Annotated[int, Query(ge=1, le=200, description="Most items of the answer.")]
After = Annotated[str | None, Query(max_length=100, description="`next` of the page before; none: the first page.")]
DEFAULT_LIMIT = 50


def after_number(after: str | None, start: int = 0) -> int:
    """The id behind which a page begins that is ordered by ids; raises `InputError` where `after` is none."""
    if after is None:
        return start
    # more digits than an id of SQLite has would not be its neighbour either
    if not (after.isascii() and after.isdecimal() and len(after) < 19):
        raise InputError(f"after: {after!r} is no cursor; give the `next` of the page before")
    return int(after)


def page(rows: Sequence[R], limit: int, show: Callable[[R], T], cursor: Callable[[R], object]) -> Page[T]:
    """The page of `rows`, of which there is one more than `limit` where another page follows."""
    items = rows[:limit]
    return Page(items=[show(row) for row in items], next=str(cursor(items[-1])) if len(rows) > limit else None)


def etag(*parts: object) -> str:
    """A strong entity tag of whatever the answer is made from."""
    return f'"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}"'


def unchanged(request: Request, response: Response, tag: str) -> Response | None:
    """The answer "not modified" to who has what `tag` names; else None, and `response` carries the tag."""
    response.headers["ETag"] = tag
    asked = request.headers.get("if-none-match", "")
    known = {each.strip().removeprefix("W/") for each in asked.split(",")}
    return Response(status_code=304, headers={"ETag": tag}) if known & {tag, "*"} else None


def check_match(request: Request, tag: str) -> None:
    """Raise `Outdated` where the caller wants to change what it has read, and that is not what `tag` names any more."""
    asked = request.headers.get("if-match")
    if asked is not None and not {each.strip() for each in asked.split(",")} & {tag, "*"}:
        raise Outdated("It was changed since you read it; read it again, then change it.")
