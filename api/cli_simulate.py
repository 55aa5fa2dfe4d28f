"""The commands that simulate what light does on a surface."""

import typer

from api.simulate_grating import register as add_grating
from api.simulate_material import register as add_material
from api.simulate_rays import register as add_rays
from api.simulate_surface import register as add_surface
from api.simulate_waves import register as add_waves

simulate = typer.Typer(help="Simulate a surface, and what rays and waves do on it.")
for _add in (add_surface, add_rays, add_waves, add_grating, add_material):
    _add(simulate)
