"""What was measured, by the name of the sample."""

from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, Field

from api.views.listing import DatasetRow, row
from api.web.access import Caller, needs
from api.web.context import Here
from goniometer.catalogue import Wanted
from goniometer.errors import NotInStore

router = APIRouter(prefix="/api/samples", tags=["datasets"])

_NEWEST = 200


class SampleRow(BaseModel):
    """A sample."""

    name: str
    datasets: int = Field(description="How many there are of it.")
    newest: DatasetRow | None = Field(description="Null where it was not measured to the end yet.")


class SampleView(SampleRow):
    """A sample and its datasets."""

    all: list[DatasetRow] = Field(description=f"The newest {_NEWEST}, newest first.")


@router.get("")
def samples(live: Here, caller: Annotated[Caller, needs("viewer")]) -> list[SampleRow]:
    """All samples that have a dataset or that a campaign asked for, in alphabetical order."""
    counts = live.store.dataset_counts()
    rows = []
    for name in live.store.samples():
        newest = live.store.entries(Wanted(sample=name), 1)
        rows.append(SampleRow(name=name, datasets=counts.get(name, 0), newest=row(newest[0]) if newest else None))
    return rows


@router.get("/{name}")
def sample(name: str, live: Here, caller: Annotated[Caller, needs("viewer")]) -> SampleView:
    """One sample."""
    known = next((each for each in live.store.samples() if each.lower() == name.lower()), None)
    if known is None:
        raise NotInStore(f'There is no sample "{name[:100]}"; list what there is')
    found = [row(entry) for entry in live.store.entries(Wanted(sample=known), _NEWEST)]
    count = live.store.dataset_counts().get(known, 0)
    return SampleView(name=known, datasets=count, newest=found[0] if found else None, all=found)
