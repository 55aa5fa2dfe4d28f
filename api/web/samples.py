"""What was measured, by the name of the sample."""

from bisect import bisect_right
from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Query

from api.bodies.base import Page
from api.bodies.datasets import NEWEST, SampleRow, SampleView
from api.views.listing import row
from api.web.access import Viewer
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, Limit, page
from goniometer.errors import NotInStore
from goniometer.storage.catalogue import Entry, Wanted

router = APIRouter(prefix="/api/samples", tags=["datasets"])


@router.get("")
def samples(
    live: Here,
    caller: Viewer,
    limit: Limit = DEFAULT_LIMIT,
    after: Annotated[
        str | None, Query(max_length=4000, description="`next` of the page before; none: the first page.")
    ] = None,
) -> Page[SampleRow]:
    """All samples that have a dataset or that a campaign asked for, in alphabetical order."""
    names = live.store.samples()
    first = 0 if after is None else bisect_right(names, after)
    part = names[first : first + limit + 1]
    known = live.store.of_samples(part)
    return page(part, limit, lambda name: _row(name, known), lambda name: name)


@router.get("/{name}")
def sample(name: str, live: Here, caller: Viewer) -> SampleView:
    """One sample."""
    known = next((each for each in live.store.samples() if each.lower() == name.lower()), None)
    if known is None:
        raise NotInStore(f'There is no sample "{name[:100]}"; list what there is')
    found = [row(entry) for entry in live.store.entries(Wanted(sample=known), NEWEST)]
    return SampleView(**_row(known, live.store.of_samples([known])).model_dump(), all=found)


def _row(name: str, known: Mapping[str, tuple[int, Entry]]) -> SampleRow:
    count, newest = known.get(name, (0, None))
    return SampleRow(name=name, datasets=count, newest=None if newest is None else row(newest))
