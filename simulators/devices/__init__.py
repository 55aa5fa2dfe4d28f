"""Instruments that answer on the wire, their faults, and the time on their bench."""
