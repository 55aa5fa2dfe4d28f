"""Instruments that answer on the wire, and the optical bench behind them."""
