"""The questions people ask of the log: pure functions over records."""
