"""Who did what."""

import json
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from api.access import audit
from api.web.access import Caller, needs
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, After, Limit, Page, after_number, page

router = APIRouter(prefix="/api/log", tags=["access"])


class Row(BaseModel):
    """One thing that somebody did."""

    sequence: int = Field(description="Counted from 1 without gaps.")
    time: str = Field(description="ISO 8601, UTC.")
    who: str = Field(description='Name of a user; of an account of the machine where `via` is "cli".')
    via: audit.Via = Field(description="How they were known.")
    action: str = Field(examples=["POST /api/queue"])
    about: dict[str, Any] = Field(description="What with, and with which outcome.")
    hash: str = Field(description="SHA-256 of the row and the hash before it.")


class Verified(BaseModel):
    """Whether the log is as it was written."""

    rows: int
    head: str = Field(description="Hash of the last row; note it elsewhere, to compare later.")
    fault: str | None = Field(description="The first thing that is wrong; null: nothing.")


class Log(Page[Row]):
    """A part of the log, newest first."""

    verified: Verified | None = Field(description="Of the whole log; null where `verify` does not ask for it.")


@router.get("")
def log(
    live: Here,
    caller: Annotated[Caller, needs("operator")],
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
    verify: Annotated[bool, Query(description="Compute all hashes anew: about 2 s for 100 000 rows.")] = False,
) -> Log:
    """Who did what, newest first."""
    found = audit.entries(live.store, None if after is None else after_number(after), limit + 1)
    part = page(found, limit, _row, lambda entry: entry.sequence)
    verdict = audit.verify(live.store) if verify else None
    verified = None if verdict is None else Verified(rows=verdict.rows, head=verdict.head, fault=verdict.fault)
    return Log(items=part.items, next=part.next, verified=verified)


def _row(entry: audit.Entry) -> Row:
    return Row(
        sequence=entry.sequence,
        time=entry.time,
        who=entry.who,
        via=entry.via,
        action=entry.action,
        about=json.loads(entry.about),
        hash=entry.hash,
    )
