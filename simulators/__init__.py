"""Instruments that answer on the wire, the optical bench behind them, and simulations of rough surfaces.

Where what stands:

instruments             devices
the optical bench       bench
what lies on it         materials
a camera                photographs
height maps             topographies
their reflectance       waves, rays
where fits fail         stability
speed against accuracy  costs
what all rooms share    computed, npz_file, choices
what can go wrong       errors
"""
