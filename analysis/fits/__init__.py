"""Models fitted to measurements, and whether a fit can be trusted."""
