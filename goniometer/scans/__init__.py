"""How a scan is run: exposures, darks, batches of points, waiting and going on."""
