"""The command line."""

import typer

app = typer.Typer(help="Drives a spectral gonioreflectometer, calibrates, fits and exports.", no_args_is_help=True)


def main() -> None:
    """Entry point of `goniometer`."""
    app()
