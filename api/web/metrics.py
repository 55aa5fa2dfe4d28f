"""GET /metrics: what the service counts and what the bench does, for Prometheus."""

import time
from collections.abc import Iterator

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.bench import queue
from api.bodies.bench import BenchState
from api.errors import Unauthorised
from api.web.access import Access
from api.web.live import Live

router = APIRouter(tags=["operation"])

PHASES = ("disconnected", "connecting", "ready", "busy", "running", "stopping")


class Metrics:
    """The counters of one application; its `registry` tells them."""

    def __init__(self, live: Live) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "goniometer_requests", "Requests that were answered.", ["method", "route", "status"], registry=self.registry
        )
        self.seconds = Histogram(
            "goniometer_request_seconds",
            "Time until the answer to a request began, seconds.",
            buckets=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5),
            registry=self.registry,
        )
        self.registry.register(_Bench(live))


class Counted:
    """Counts the requests to `app`."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and count its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()

        async def counting(message: Message) -> None:
            if message["type"] == "http.response.start":
                # a path that leads nowhere would make a row of its own each time
                route = getattr(scope.get("route"), "path", "other")
                self._metrics.requests.labels(scope["method"], route, str(message["status"])).inc()
                self._metrics.seconds.observe(time.perf_counter() - began)
            await send(message)

        await self._app(scope, receive, counting)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(request: Request) -> Response:
    """What the service counts, in the text format of Prometheus; from elsewhere than this machine with a token."""
    access: Access = request.app.state.access
    if not access.loopback and request.state.caller is None:
        raise Unauthorised("Send a token as: Authorization: Bearer TOKEN")
    registry: CollectorRegistry = request.app.state.metrics.registry
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


class _Bench(Collector):
    """What the bench and the queue are at, read when somebody asks."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def collect(self) -> Iterator[Metric]:
        """All gauges."""
        yield _gauge("events", "Events that were published since the start.", float(self._live.events.count))
        waiting = queue.entries(self._live.store)
        entries = GaugeMetricFamily("goniometer_queue_entries", "Entries of the queue.", labels=["phase"])
        for phase in ("idle", "queued", "running"):
            entries.add_metric([phase], sum(entry.phase == phase for entry in waiting))
        yield entries
        lives = float(self._live.worker.lives)
        yield _gauge("bench_up", "Whether the process that drives the bench lives.", lives)
        yield from _bench(self._live.worker.state)


def _bench(state: BenchState) -> Iterator[Metric]:
    here = state.driver is not None and state.driver.here
    yield _gauge("bench_drives", "Whether this service drives the bench.", float(here))
    phases = GaugeMetricFamily("goniometer_bench_phase", "1 for what the bench is at.", labels=["phase"])
    for phase in PHASES:
        phases.add_metric([phase], float(state.phase == phase))
    yield phases
    yield _gauge("alarms", "Things that somebody must look at.", float(len(state.alarms)))
    yield _gauge("waits_for_sample", "Whether somebody must mount a sample.", float(state.prompt is not None))
    if state.detector_temperature is not None:
        yield _gauge("detector_celsius", "Temperature of the detector.", state.detector_temperature)
    if state.running is not None:
        yield _gauge("scan_points_done", "Finished points of the scan that is measured.", float(state.running.done))
        yield _gauge("scan_points_expected", "Points that it will have.", float(state.running.expected))
        yield _gauge("scan_remaining_seconds", "Bench time to go.", state.running.bench_remaining.seconds)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"goniometer_{name}", text, value=value)
