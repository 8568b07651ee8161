"""Steps of the chain on logged scenes: occupancy fields, motions, executions, safety report."""
