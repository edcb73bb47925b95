"""A simulated PlateCrane."""

from __future__ import annotations

from labos.node import Setup
from labos_drivers._arm import Arm

STACKS = tuple(f"Stack{number}" for number in range(1, 6))
STACK_HOLDS = 20


class PlateCraneSimulator(Arm):
    """A slow arm, because it moves one axis after the other."""

    transfer_s = 60.0

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.furnish(STACK_HOLDS, *STACKS)
