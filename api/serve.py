"""`goniometer serve`: the service in the foreground, until a signal ends it."""

import asyncio
import logging
import signal
import socket
from pathlib import Path
from types import FrameType

import uvicorn

from api.live import Live, open_live
from api.logs import log_as_json
from api.settings import InstrumentSettings
from api.web.app import make_app
from goniometer.errors import InputError

ENDING = 3
"""Seconds that requests may take to end once the service is told to."""

log = logging.getLogger(__name__)


def serve(
    database: Path | str,
    output: Path,
    settings: InstrumentSettings | None,
    host: str,
    port: int,
    *,
    mounts_by_itself: bool = False,
) -> None:
    """Serve until SIGTERM or SIGINT; the bench is parked then.

    Raises `StoreError` where the database cannot be opened, and `InputError` where nobody can listen there.
    """
    log_as_json()
    with _listening(host, port) as listener:
        url = f"http://{host}:{listener.getsockname()[1]}"
        with open_live(database, output, settings, url=url, mounts_by_itself=mounts_by_itself) as live:
            config = uvicorn.Config(
                make_app(live),
                log_config=None,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=ENDING,
            )
            log.info("Serves %s", url)
            _Server(config, live).run([listener])


class _Server(uvicorn.Server):
    """Ends the streams of events, which would else keep it from ending, and has the bench parked at once."""

    def __init__(self, config: uvicorn.Config, live: Live) -> None:
        super().__init__(config)
        self._live = live

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        log.info("Ends (%s)", signal.Signals(sig).name)
        # not here: a signal comes in the middle of anything, also of what these do
        loop = asyncio.get_running_loop()
        loop.call_soon_threadsafe(self._live.events.close)
        loop.call_soon_threadsafe(self._live.worker.end)
        super().handle_exit(sig, frame)


def _listening(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise InputError(f"--host {host} --port {port}: cannot listen there: {error.strerror or error}") from None
