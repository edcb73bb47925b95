"""The planner: looks for a good order of what is under way and what waits, and suggests it to the lab."""
