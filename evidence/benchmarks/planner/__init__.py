"""The planner's search core beside OMPL, and the properties that its speed rests on."""
