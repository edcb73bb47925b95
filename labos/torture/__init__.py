"""One test suite for every driver, which determines its badge. The driver's node runs in its own process on a
real bus, and is killed there. Its simulated device is at the far end of a real line. A relay in between cuts
and spoils the line. The suite compares the answers of the node with the motion log of the simulated bench.
"""

from labos.torture.report import MEANING, RANKS, Badge, Finding, Report
from labos.torture.suite import CHECKS, describe_check, find_declaration, is_person, torture

__all__ = [
    "CHECKS",
    "MEANING",
    "RANKS",
    "Badge",
    "Finding",
    "Report",
    "describe_check",
    "find_declaration",
    "is_person",
    "torture",
]
