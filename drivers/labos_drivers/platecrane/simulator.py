"""A simulated PlateCrane."""

from __future__ import annotations

from labos.node import Setup
from labos_drivers._arm import Arm

STACKS = tuple(f"Stack{number}" for number in range(1, 6))
STACK_HOLDS = 20


class PlateCraneSimulator(Arm):
    """An arm that leaves every lift and turn to a single axis, and takes its time."""

    transfer_s = 60.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.furnish(STACK_HOLDS, *STACKS)
