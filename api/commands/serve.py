"""`goniometer serve`."""

from pathlib import Path
from typing import Annotated

import typer

from api.commands.arguments import DATABASE, BenchName, DatabaseFile, bench_of
from goniometer.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""

    @app.command()
    def serve(
        context: typer.Context,
        database: DatabaseFile = DATABASE,
        output: Annotated[Path, typer.Option("--output", "-o", help="Folder for results.")] = Path("results"),
        instrument: Annotated[
            Path | None, typer.Option(help="Instrument file (TOML); without it the simulated bench is driven.")
        ] = None,
        mount_by_itself: Annotated[
            bool, typer.Option("--mount-by-itself", help="Simulated bench: lay samples on it without asking anybody.")
        ] = False,
        host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
        port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes any.")] = 8000,
        tls_cert: Annotated[
            Path | None, typer.Option(exists=True, dir_okay=False, help="Certificate with its chain (PEM), for https.")
        ] = None,
        tls_key: Annotated[Path | None, typer.Option(exists=True, dir_okay=False, help="Its key (PEM).")] = None,
        behind_proxy: Annotated[
            bool, typer.Option("--behind-proxy", help="A proxy in front of it speaks https; nobody comes past it.")
        ] = False,
        host_name: Annotated[
            list[str] | None, typer.Option(help="Name under which it is known, besides the machine's; may be repeated.")
        ] = None,
        keep_jobs: Annotated[
            int, typer.Option(min=0, help="Jobs that are over and kept with their results, however old they are.")
        ] = 1000,
        keep_jobs_days: Annotated[float, typer.Option(min=0, help="Days for which all others are kept, too.")] = 90.0,
        bench: BenchName = None,
    ) -> None:
        """Serve REST, events and the pages of the bench until it is stopped."""
        from api.jobs.retention import Retention
        from api.settings import load_instrument
        from api.web.serve import Listen
        from api.web.serve import serve as run

        settings = load_instrument(instrument) if instrument else None
        if settings is not None and mount_by_itself:
            raise InputError("--mount-by-itself is for the simulated bench; leave it out, or leave out --instrument.")
        listen = Listen(host, port, tls_cert, tls_key, behind_proxy, tuple(host_name or ()))
        name = bench_of(bench, settings)
        run(
            database,
            output,
            settings,
            listen,
            mounts_by_itself=mount_by_itself,
            bench=name,
            cluster=context.obj,
            kept=Retention(keep_jobs, keep_jobs_days),
        )
