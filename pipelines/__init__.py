"""How it runs: definitions, resources, storage, jobs, schedules and presets."""
