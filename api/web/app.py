"""The web application of a running service."""

import asyncio
import os
import sys
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from anyio import CapacityLimiter
from fastapi import FastAPI

from api.web import (
    analyses,
    calibration,
    campaigns,
    datasets,
    events,
    fits,
    imports,
    instrument,
    jobs,
    log,
    login,
    metrics,
    operation,
    pages,
    queue,
    samples,
    scans,
    tokens,
    users,
)
from api.web.access import LOCAL, Access
from api.web.answers import Answers
from api.web.gate import Gate
from api.web.live import Live
from api.web.problems import describe_problems, install
from goniometer.storage.derived import software_version

NICE = 5
"""How far threads that answer requests step back, on Linux; of a core that the bench wants, too, it gets 3/4."""
LARGEST_BODY = 4 << 20
"""Octets of a request; endpoints that take files allow more."""

ROUTERS = (
    operation.router,
    metrics.router,
    events.router,
    instrument.router,
    login.router,
    users.router,
    tokens.router,
    log.router,
    campaigns.router,
    queue.router,
    scans.router,
    imports.router,  # before what has a number in the same place
    datasets.router,
    samples.router,
    fits.router,
    calibration.router,
    analyses.router,
    jobs.router,
    pages.router,  # the last, because it answers to every path
)


def make_app(live: Live, access: Access = LOCAL) -> FastAPI:
    """The application through which `live` is used, reached as `access` says."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        live.events.attach(asyncio.get_running_loop())
        live.worker.start()
        _step_back()
        threading.Thread(target=live.datasets.warm_up, name="warm-up", daemon=True).start()
        try:
            live.datasets.start()
            yield
        finally:
            await asyncio.to_thread(live.datasets.close)
            await asyncio.to_thread(live.worker.close)

    app = _Application(
        title="goniometer",
        version=software_version(),
        description=__doc__,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
    )
    app.state.live, app.state.access = live, access
    app.state.logins = CapacityLimiter(2)
    app.state.answers = Answers(live)
    install(app)
    app.state.metrics = metrics.Metrics(live)
    # the last is the first to see a request
    app.add_middleware(Gate, store=live.store, callers=live.callers, access=access)
    app.add_middleware(pages.Careful)
    app.add_middleware(metrics.Counted, metrics=app.state.metrics)
    for router in ROUTERS:
        app.include_router(router, max_body_size=LARGEST_BODY)  # here, so that the gate sees it refused
    return app


def _step_back() -> None:
    """Let this thread, and those that it starts, have a processor after the process that drives the bench."""
    if sys.platform == "linux":  # elsewhere it would concern the whole process
        here = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, here, os.getpriority(os.PRIO_PROCESS, here) + NICE)


class _Application(FastAPI):
    """Its OpenAPI document tells of the problems that every operation may answer, and of events."""

    def openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            self.openapi_schema = describe_problems(events.describe_events(super().openapi()))
        return self.openapi_schema
