"""What a simulation is told as: facts, tables and pages."""
