"""The commands that simulate what light does on a surface."""

import typer

from api.simulate_photos import register as add_photos
from api.simulate_surface import register as add_surface

simulate = typer.Typer(help="Simulate a surface, and what rays and waves do on it.")
for _add in (add_photos, add_surface):
    _add(simulate)
