"""Device interfaces and the drivers of real instruments."""
