"""Reflectance of height maps by geometric optics."""
