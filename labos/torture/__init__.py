"""One suite for every driver: what it does to them, and the badge that they come away with.

The driver's node runs in a process of its own, on a real bus, and is killed there. Its simulated device
stands at the far end of a real line, with a relay in between that is cut and spoiled. Both are asked what
happened: the node by its answers, the device by the bench's own motion log.
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
