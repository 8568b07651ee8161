"""The planner against OMPL, and how its time scales: `python -m evidence.benchmarks.planner`."""
