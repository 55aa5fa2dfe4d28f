"""How an endpoint gets at the running service."""

from typing import Annotated, cast

from fastapi import Depends, Request

from api.live import Live


def _live(request: Request) -> Live:
    return cast(Live, request.app.state.live)


Here = Annotated[Live, Depends(_live)]
"""The running service, as the parameter of an endpoint."""
