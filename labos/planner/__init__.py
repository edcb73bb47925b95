"""The planner: searches for a good order of the runs in progress and the waiting runs, and suggests it to the
lab."""
