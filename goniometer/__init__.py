"""What a measurement is and how one is run, calibrated, kept and exchanged."""
