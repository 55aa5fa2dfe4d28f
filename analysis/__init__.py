"""Reflectance models, their fits, colour, exports and figures."""
