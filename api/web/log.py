"""Who did what."""

import json
from typing import Annotated

from fastapi import APIRouter, Query

from api.access import audit
from api.bodies.access import Log, Row, Verified
from api.web.access import Operator
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, page

router = APIRouter(prefix="/api/log", tags=["access"])


@router.get("")
def log(
    live: Here,
    caller: Operator,
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
