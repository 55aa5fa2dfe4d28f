"""A simulated camera, and sessions with it."""
