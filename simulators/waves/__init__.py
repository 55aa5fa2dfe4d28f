"""Reflectance of height maps by scalar wave optics."""
