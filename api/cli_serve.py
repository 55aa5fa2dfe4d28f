"""`goniometer serve`."""

from pathlib import Path
from typing import Annotated

import typer

from api.arguments import DATABASE, DatabaseFile
from api.settings import load_instrument


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""

    @app.command()
    def serve(
        database: DatabaseFile = DATABASE,
        output: Annotated[Path, typer.Option("--output", "-o", help="Folder for results.")] = Path("results"),
        instrument: Annotated[
            Path | None, typer.Option(help="Instrument file (TOML); without it the simulated bench is driven.")
        ] = None,
        host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
        port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes any.")] = 8000,
    ) -> None:
        """Serve REST, events and the pages of the bench until it is stopped."""
        from api.serve import serve as run  # noqa: PLC0415  (FastAPI takes half a second)

        run(database, output, load_instrument(instrument) if instrument else None, host, port)
