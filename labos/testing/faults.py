"""The faults of a simulated lab, drawn from one seed."""

from __future__ import annotations

import asyncio
import contextvars
import random
from collections import Counter
from collections.abc import Callable

import msgspec

from labos.node.world import MISHAPS
from labos.testing.loop import PROCESS, Killed, Process

CRASH_POINTS = (
    "kernel.before_commit",
    "kernel.unsynced_commit",
    "kernel.after_commit",
    "kernel.before_send",
    "kernel.after_send",
    "node.before_journal",
    "node.torn_journal",
    "node.unsynced_journal",
    "node.after_journal",
    "node.before_send",
    "node.after_send",
)
"""The points at which processes may die: before and after each durable write and each send, and during a
write. At an *unsynced* point, the operating system has all of the data, but the disk does not."""

FAULTS = (
    "loss",
    "duplication",
    "delay",
    "reordering",
    "commit_error",
    "power_cut",
    "both_die",
    "kernel_frozen",
    "node_frozen",
    "clock_jump",
    "mishap",
)
"""The other faults, by their names in ``Faults.occurred``."""

LONG_S = 0.5
"""A message that takes longer than this counts as delayed."""

LONGEST_JUMP_S = 6 * 3600.0
MENDS_AFTER_S = 900.0
"""The longest time until a clock that jumped is corrected."""


class FaultRates(msgspec.Struct, frozen=True):
    """Probabilities per message (loss, duplication, reordering), per visit of a crash point (crash,
    kernel_frozen, node_frozen, clock_jump), per commit, per death (power_cut: the machine loses its power;
    both_die: a process that it talks to dies too) or per motion of a gripper (mishap); delays in seconds."""

    loss: float = 0.0
    duplication: float = 0.0
    longest_delay_s: float = 0.01
    crash: float = 0.0
    commit_error: float = 0.0
    restart_s: tuple[float, float] = (0.5, 5.0)
    mishap: float = 0.0
    reordering: float = 0.0
    power_cut: float = 0.0
    both_die: float = 0.0
    kernel_frozen: float = 0.0
    node_frozen: float = 0.0
    frozen_s: tuple[float, float] = (1.0, 60.0)
    clock_jump: float = 0.0


QUIET = FaultRates()
STORMY = FaultRates(loss=0.03, duplication=0.03, longest_delay_s=1.0, crash=0.004, commit_error=0.003)


class Faults:
    """Draws faults; ``visit`` kills or freezes the running process at a crash point.

    ``occurred`` and ``deaths`` list the faults that happened, with the virtual time of each.
    """

    def __init__(self, rates: FaultRates, rng: random.Random) -> None:
        self.rates, self.rng = rates, rng
        self.visits: Counter[str] = Counter()
        self.crashes: Counter[str] = Counter()
        self.struck: Counter[str] = Counter()
        self.occurred: list[tuple[str, float]] = []
        self.deaths: list[tuple[str, float]] = []
        self.torn = 0
        """Journals that lost data in a power cut before these were synced."""
        self.only: str = ""
        self.calm = False
        self.on_freeze: Callable[[Process], None] = lambda _: None
        self.on_jump: Callable[[Process], None] = lambda _: None
        self.choose_peer: Callable[[Process], Process | None] = lambda _: None

    # -- at crash points ---------------------------------------------------------------------

    def visit(self, point: str) -> None:
        """Perhaps kill the process here, so that it carries out nothing after this line; or freeze it, so
        that the code after the next ``await`` runs later."""
        process = PROCESS.get()
        if process is None:
            return
        self.visits[point] += 1
        if not process.alive:
            raise Killed
        if self.calm or (self.only and point != self.only):
            return
        if self.rng.random() < self.chance("crash", point):
            self.crashes[point] += 1
            self._die(process, point)
            raise Killed
        role = point.partition(".")[0]
        if not process.frozen and self._draw(f"{role}_frozen", point):
            self._freeze(process, f"{role}_frozen")
        if process.clock is not None and self._draw("clock_jump", point):
            self._jump(process)

    async def pass_point(self, point: str) -> None:
        """Like ``visit``, but a process that freezes stops before the next line."""
        self.visit(point)
        process = PROCESS.get()
        if process is not None and process.frozen:
            await asyncio.sleep(0)

    def chance(self, fault: str, point: str = "") -> float:
        """The probability of a fault now."""
        rate: float = getattr(self.rates, fault)
        return rate

    def _die(self, process: Process, point: str) -> None:
        self.deaths.append((point, self.now()))
        powerless = self._draw("power_cut", point)
        if powerless:
            self.record("power_cut")
        other = self.choose_peer(process) if self._draw("both_die", point) else None
        process.kill(powerless=powerless)
        if other is not None and other.alive:
            self.record("both_die")
            other.kill(powerless=powerless)

    def _freeze(self, process: Process, fault: str) -> None:
        self.record(fault)
        process.freeze()
        low, high = self.rates.frozen_s
        loop, outside = asyncio.get_running_loop(), contextvars.Context()
        loop.call_later(self.rng.uniform(low, high), process.thaw, context=outside)
        self.on_freeze(process)

    def _jump(self, process: Process) -> None:
        """Set the clock of the machine wrong by hours, until a person corrects it."""
        assert process.clock is not None
        self.record("clock_jump")
        process.clock.set(self.rng.uniform(-LONGEST_JUMP_S, LONGEST_JUMP_S))
        loop, outside = asyncio.get_running_loop(), contextvars.Context()
        loop.call_later(self.rng.uniform(1.0, MENDS_AFTER_S), process.clock.set, 0.0, context=outside)
        self.on_jump(process)

    # -- anywhere ----------------------------------------------------------------------------

    def strikes(self, fault: str) -> bool:
        """Whether the fault happens now."""
        if self.calm or self.rng.random() >= self.chance(fault):
            return False
        self.record(fault)
        return True

    def waits_for_next(self) -> bool:
        """Whether a message should wait until the next one has overtaken it."""
        return not self.calm and self._draw("reordering")

    def _draw(self, fault: str, point: str = "") -> bool:
        """Draw a random number, unless the probability is 0. In this way, the labs of a seed do not
        change."""
        chance = self.chance(fault, point)
        return chance > 0 and self.rng.random() < chance

    def mishap(self) -> str:
        """The unnoticed mishap of a gripper's motion; empty if none."""
        if not self.rates.mishap or not self.strikes("mishap"):
            return ""
        return self.rng.choice(MISHAPS)

    def delay(self) -> float:
        """The duration of a message, which is sometimes very long."""
        longest = 0.01 if self.calm else self.rates.longest_delay_s
        takes = self.rng.random() ** 3 * longest + 0.0001
        if takes > LONG_S:
            self.record("delay")
        return takes

    def record(self, fault: str) -> None:
        """Record that a fault has occurred."""
        self.struck[fault] += 1
        self.occurred.append((fault, self.now()))

    @staticmethod
    def now() -> float:
        return asyncio.get_running_loop().time()
