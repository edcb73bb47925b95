"""Schedules of LabOS beside the best that are known."""
