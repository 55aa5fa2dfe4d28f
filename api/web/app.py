"""The web application of a running service."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI

from api.live import Live
from api.web import events, operation
from api.web.access import LOCAL, Access
from api.web.gate import Gate
from api.web.problems import describe_problems, install
from goniometer.derived import software_version

ROUTERS = (operation.router, events.router)


def make_app(live: Live, access: Access = LOCAL) -> FastAPI:
    """The application through which `live` is used, reached as `access` says."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        live.events.attach(asyncio.get_running_loop())
        yield

    app = _Application(
        title="goniometer",
        version=software_version(),
        description=__doc__,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
    )
    app.state.live = live
    install(app)
    app.add_middleware(Gate, store=live.store, access=access)
    for router in ROUTERS:
        app.include_router(router)
    return app


class _Application(FastAPI):
    """Its OpenAPI document tells of the problems that every operation may answer."""

    def openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            self.openapi_schema = describe_problems(super().openapi())
        return self.openapi_schema
