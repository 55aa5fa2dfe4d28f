"""`goniometer serve`: the service in the foreground, until a signal ends it."""

import asyncio
import logging
import signal
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import uvicorn

from api.access.audit import record, record_done
from api.access.tokens import first_token
from api.jobs.retention import KEPT, Retention
from api.logs import log_to_stderr
from api.preflight import check_output
from api.settings import InstrumentSettings
from api.web.access import check_listen
from api.web.app import make_app
from api.web.live import Live, open_live
from api.web.patience import Patient
from goniometer.errors import ConfigurationError
from goniometer.storage.store import Store
from goniometer.storage.tables import BENCH

ENDING = 3
"""Seconds that requests may take to end once the service is told to."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Listen:
    """Where the service is reached, and how."""

    host: str = "127.0.0.1"
    """Address to listen on."""
    port: int = 8000
    """0 takes any that is free."""
    tls_cert: Path | None = None
    """Certificate with its chain, PEM; with `tls_key`, or there is no https."""
    tls_key: Path | None = None
    behind_proxy: bool = False
    """Whether something in front of it speaks https, and nobody comes past it."""
    names: tuple[str, ...] = ()
    """Under which it is known besides those of the machine."""


def serve(
    database: Path | str,
    output: Path,
    settings: InstrumentSettings | None,
    listen: Listen,
    *,
    mounts_by_itself: bool = False,
    bench: str = BENCH,
    cluster: str | None = None,
    kept: Retention = KEPT,
) -> None:
    """Serve until SIGTERM or SIGINT; the bench, which has the name `bench`, is parked then.

    Heavy work goes to the Dask scheduler `cluster`, if any. Of jobs that are over, so many are `kept`.

    Raises `StoreError` where the database cannot be opened, `ConfigurationError` where nobody can, or may, listen
    there, and `StoreFull` where results cannot be written to `output`.
    """
    if (listen.tls_cert is None) != (listen.tls_key is None):
        raise ConfigurationError("--tls-cert and --tls-key belong together; give both, or none")
    tls = listen.tls_cert is not None
    if listen.tls_cert is not None:
        _check_certificate(listen.tls_cert, listen.tls_key)
    store = Store.open(database, bench)
    access = check_listen(listen.host, store, tls=tls, behind_proxy=listen.behind_proxy, hosts=listen.names)
    log_to_stderr()
    with _listening(listen.host, listen.port) as listener:
        host = f"[{listen.host}]" if ":" in listen.host else listen.host
        url = f"{'https' if tls else 'http'}://{host}:{listener.getsockname()[1]}"
        check_output(output)  # before the token, which is shown once
        token = first_token(store) if access.loopback else None
        # to the terminal and not to the log, which is kept; "goniometer token create" makes another token
        print(f"Open {url}" if token is None else f"Open {url}/#token={token}", flush=True)
        store.close()
        with open_live(
            database,
            output,
            settings,
            url=url,
            mounts_by_itself=mounts_by_itself,
            bench=bench,
            cluster=cluster,
            kept=kept,
        ) as live:
            config = uvicorn.Config(
                make_app(live, access),
                http=Patient,
                ws="none",
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=listen.behind_proxy,
                ssl_certfile=listen.tls_cert,
                ssl_keyfile=listen.tls_key,
                timeout_graceful_shutdown=ENDING,
            )
            log.info("Serves %s", url)
            for each in (signal.SIGTERM, signal.SIGINT):
                signal.signal(each, signal.SIG_IGN)  # uvicorn takes them up, and when it has ended raises them again
            record(live.store, "service", "start", {"url": url, "bench": bench})
            try:
                _Server(config, live).run([listener])
            finally:
                record_done(live.store, "service", "end", {"url": url})


def _check_certificate(certificate: Path, key: Path | None) -> None:
    """Raises `ConfigurationError` for what uvicorn could not serve with, before anybody is given an address."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key)
    except OSError as error:  # of which ssl.SSLError is one
        told = error.strerror or error
        raise ConfigurationError(
            f"--tls-cert {certificate} --tls-key {key}: {told}; give a certificate and its key, both as PEM"
        ) from None


class _Server(uvicorn.Server):
    """Ends the streams of events, which would else keep it from ending, and has the bench parked at once."""

    def __init__(self, config: uvicorn.Config, live: Live) -> None:
        super().__init__(config)
        self._live = live

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Take up a signal."""
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
        told = str(error.strerror or error).partition(" (while ")[0]  # Python repeats the address
        raise ConfigurationError(
            f"--host {host} --port {port}: cannot listen there: {told}; name another, or end what listens there"
        ) from None
