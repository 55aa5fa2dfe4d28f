"""Calibrated datasets, and what they say about themselves."""
