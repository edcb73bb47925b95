"""Logs that earlier versions wrote: every later one must fold them to the same state."""
