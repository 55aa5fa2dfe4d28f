"""The bench measures itself: zeros of its stages, its signature, its noise and its wavelength scale."""
