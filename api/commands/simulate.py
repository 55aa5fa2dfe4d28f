"""The commands that simulate what light does on a surface."""

import typer

from api.commands.simulate_grating import register as add_grating
from api.commands.simulate_material import register as add_material
from api.commands.simulate_photos import register as add_photos
from api.commands.simulate_rays import register as add_rays
from api.commands.simulate_surface import register as add_surface
from api.commands.simulate_waves import register as add_waves

simulate = typer.Typer(help="Simulate a surface, and what rays and waves do on it.", rich_markup_mode=None)
for _add in (add_surface, add_rays, add_waves, add_grating, add_photos, add_material):
    _add(simulate)
