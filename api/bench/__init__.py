"""The bench in a process of its own: its queue, who drives it, and what it does now."""
