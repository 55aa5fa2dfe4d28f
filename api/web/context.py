"""How an endpoint gets at the running service."""

from typing import Annotated, cast

from fastapi import Depends, Path, Request

from api.web.live import Live


async def _live(
    request: Request,
) -> Live:  # what is no coroutine would go to a thread, and take longer for that than all else
    return cast(Live, request.app.state.live)


Here = Annotated[Live, Depends(_live)]
"""The running service, as the parameter of an endpoint."""

Number = Annotated[int, Path(ge=1, lt=2**63, description="Its id.")]
"""The id of something, in the path of an endpoint; what is larger is no number of SQLite."""
