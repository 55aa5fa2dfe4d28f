"""A BRDF between the directions in which it was measured, with the uncertainty of reading it there."""
