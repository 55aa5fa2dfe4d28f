"""Answers about a dataset, which change with its fits only, so that a client need not read them twice."""

from collections.abc import Callable

from fastapi import Request, Response
from pydantic import BaseModel

from api.live import Live
from api.views.opened import Opened
from api.web.paging import etag, unchanged

# a browser keeps the answer and asks each time whether it still holds
_CACHE = {"Cache-Control": "private, no-cache"}


def shown(
    request: Request, live: Live, dataset_id: int, make: Callable[[Opened], BaseModel | bytes], *asked: object
) -> Response:
    """The answer of `make`, or "not modified" to who has it; `asked` is all that it depends on beside the dataset.

    Raises `NotInStore`, and what `make` raises.
    """
    tag = etag(request.scope["route"].path, dataset_id, live.datasets.version(dataset_id), *asked)
    known = unchanged(request, Response(), tag)
    if known is not None:
        return known
    made = make(live.datasets.open(dataset_id))
    headers = _CACHE | {"ETag": tag}
    if isinstance(made, bytes):
        return Response(made, media_type="application/octet-stream", headers=headers)
    return Response(made.model_dump_json(), media_type="application/json", headers=headers)
