"""Reflectance models as functions of direction and wavelength."""
