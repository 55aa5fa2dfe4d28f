"""The bench as one object in degrees and seconds: arm, light and spectrometer, and where the arm may go."""
