"""Files of datasets: those of this program, and those of others."""
