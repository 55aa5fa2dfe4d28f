"""Figures as SVG text, and the pieces of the pages in which they stand."""
