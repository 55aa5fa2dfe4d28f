"""Answers about a dataset, which change with its fits only, so that a client need not read them twice."""

from collections.abc import Callable

from fastapi import Request, Response
from pydantic import BaseModel

from api.views.opened import Opened
from api.web.live import Live
from api.web.paging import etag, unchanged

# a browser keeps the answer and asks each time whether it still holds
_CACHE = {"Cache-Control": "private, no-cache"}


def shown(
    request: Request,
    live: Live,
    dataset_id: int,
    make: Callable[[Opened], BaseModel | bytes],
    *asked: object,
    media_type: str = "application/json",
) -> Response:
    """The answer of `make`, or "not modified" to who has it; `asked` is all that it depends on beside the dataset.

    Raises `NotInStore`, and what `make` raises.
    """
    tag = etag(request.scope["route"].path, dataset_id, live.datasets.version(dataset_id), *asked)
    known = unchanged(request, Response(), tag)
    if known is not None:
        return known
    content = live.datasets.answer(tag, lambda: _packed(make(live.datasets.open(dataset_id))))
    return Response(content, media_type=media_type, headers=_CACHE | {"ETag": tag})


def _packed(made: BaseModel | bytes) -> bytes:
    return made if isinstance(made, bytes) else made.model_dump_json().encode()
