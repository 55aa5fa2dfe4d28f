"""Materials as `.bsdf` files for Mitsuba 3 and PBRT, and how far they are from their models."""
