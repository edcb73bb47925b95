"""Answers to the questions that people ask about the log: pure functions over its records."""
