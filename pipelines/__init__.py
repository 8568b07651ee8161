"""How the assets run: definitions, jobs, sensors, storage, tracking and commands."""
