"""Where to measure next: pure functions of what was asked for and what has been measured."""
