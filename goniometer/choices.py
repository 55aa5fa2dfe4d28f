"""What may be chosen of a file that was measured elsewhere, by name; loads nothing, see `analysis.choices`."""

from typing import Literal

Quantity = Literal["brdf", "brdf-cos-in", "brdf-cos-out", "radiance-factor"]
"""BRDF in 1/sr; BRDF times the cosine of the incident or of the reflected angle, 1/sr; or pi times the BRDF."""
