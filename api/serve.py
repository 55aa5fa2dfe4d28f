"""`goniometer serve`: the service in the foreground, until a signal ends it."""

from pathlib import Path

import uvicorn

from api.live import open_live
from api.settings import InstrumentSettings
from api.web.app import make_app


def serve(database: Path | str, output: Path, settings: InstrumentSettings | None, host: str, port: int) -> None:
    """Serve until SIGTERM or SIGINT. Raises `StoreError` where the database cannot be opened."""
    with open_live(database, output, settings) as live:
        uvicorn.run(make_app(live), host=host, port=port, log_config=None, access_log=False, server_header=False)
