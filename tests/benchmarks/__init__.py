"""What LabOS costs, held against the bare limit of the same machine in the same run.

``python -m tests.benchmarks`` measures everything and prints one table; ``python -m
tests.benchmarks action replay`` measures some. Absolute times drift from machine to machine and
from minute to minute, so every figure that can be is a ratio: the limit and ours are measured in
turns, and the median of the rounds counts. Nothing here is asserted in a test; the smoke test only
sees to it that each benchmark still runs.
"""
