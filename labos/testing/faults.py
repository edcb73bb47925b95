"""What can go wrong in a simulated lab, drawn from one seed."""

from __future__ import annotations

import random
from collections import Counter

import msgspec

from labos.node.world import MISHAPS
from labos.testing.loop import PROCESS, Killed

CRASH_POINTS = (
    "kernel.before_commit",
    "kernel.after_commit",
    "kernel.before_send",
    "kernel.after_send",
    "node.before_journal",
    "node.torn_journal",
    "node.after_journal",
    "node.before_send",
    "node.after_send",
)


class FaultRates(msgspec.Struct, frozen=True):
    """Probabilities per message, per visit of a crash point or per motion of a hand; delays in seconds."""

    loss: float = 0.0
    duplication: float = 0.0
    longest_delay_s: float = 0.01
    crash: float = 0.0
    commit_error: float = 0.0
    restart_s: tuple[float, float] = (0.5, 5.0)
    mishap: float = 0.0


QUIET = FaultRates()
STORMY = FaultRates(loss=0.03, duplication=0.03, longest_delay_s=1.0, crash=0.004, commit_error=0.003)


class Faults:
    """Draws faults; ``at`` kills the running process at a crash point."""

    def __init__(self, rates: FaultRates, rng: random.Random) -> None:
        self.rates, self.rng = rates, rng
        self.visits: Counter[str] = Counter()
        self.crashes: Counter[str] = Counter()
        self.only: str = ""
        self.calm = False

    def at(self, point: str) -> None:
        """Perhaps die here: nothing after this line happens in this process."""
        process = PROCESS.get()
        if process is None:
            return
        self.visits[point] += 1
        if not process.alive:
            raise Killed
        if self.calm or (self.only and point != self.only):
            return
        if self.rng.random() < self.rates.crash:
            self.crashes[point] += 1
            process.kill()
            raise Killed

    def happens(self, probability: float) -> bool:
        return not self.calm and self.rng.random() < probability

    def mishap(self) -> str:
        """What goes wrong unnoticed with a motion of a hand; empty if nothing does."""
        if not self.rates.mishap or not self.happens(self.rates.mishap):
            return ""
        return self.rng.choice(MISHAPS)

    def delay(self) -> float:
        """How long a message takes; now and then very long."""
        longest = 0.01 if self.calm else self.rates.longest_delay_s
        return self.rng.random() ** 3 * longest + 0.0001
