"""Instruments that answer on the wire, the optical bench behind them, and simulations of rough surfaces."""
