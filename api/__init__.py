"""Faces and wiring: the service and the command line."""
