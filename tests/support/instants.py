"""Random instants at which processes of a lab are killed: drawn from a seed and told in one line."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import NamedTuple

NODES = ("pf400", "sciclops", "ot2_pcr_alpha", "sealer", "biometra", "peeler", "camera_module")

AT_WORK = "whoever is at work"
"""What is hit, as often as not, if it is a node: one that has an action in flight just then."""

KINDS: Mapping[str, int] = {
    "kernel": 6,
    "node": 6,
    "kernel+node": 3,
    "router": 3,
    "kernel+router": 2,
    "everything": 1,
    "server": 3,
    "kernel+server": 1,
}
"""What is killed, and how often. ``everything`` is a power cut; ``server`` is PostgreSQL, stopped ``-m
immediate`` and started again."""

LATEST_MS = 60.0
LONGEST_AWAY_S = 1.0
GAP = 40


class Instant(NamedTuple):
    """``gap`` events after the one before, and ``late_ms`` of real time later, whatever happens just then;
    what is killed; which node, if it is one; how long a router is away."""

    gap: int
    late_ms: float
    kind: str
    node: str
    away_s: float

    def __str__(self) -> str:
        who = self.kind.replace("node", self.node)
        return f"{who} {self.gap} events and {self.late_ms:.0f} ms on"


class Ordeal(NamedTuple):
    """What one lab goes through: whether its bus is a process of its own, whether its nodes outlive
    its kernel, and when what is killed."""

    seed: int
    own_bus: bool
    detached: bool
    instants: Sequence[Instant]

    def __str__(self) -> str:
        bus = "a bus of its own" if self.own_bus else "the kernel's bus"
        nodes = "nodes detached" if self.detached else "nodes with their kernel"
        return f"seed {self.seed}: {bus}, {nodes}; " + "; ".join(map(str, self.instants))


def draw(seed: int, count: int, *, server: bool) -> Ordeal:
    """``count`` instants; ``server`` says whether there is one that can be restarted."""
    rng = random.Random(f"instants/{seed}")
    own_bus, detached = seed % 3 != 0, seed // 2 % 2 == 1
    kinds = {
        kind: weight
        for kind, weight in KINDS.items()
        if (own_bus or "router" not in kind) and (server or "server" not in kind)
    }
    instants = [
        Instant(
            rng.randint(1, GAP),
            rng.uniform(0.0, LATEST_MS),
            rng.choices(list(kinds), list(kinds.values()))[0],
            rng.choice((*NODES, *[AT_WORK] * len(NODES))),
            rng.uniform(0.0, LONGEST_AWAY_S),
        )
        for _ in range(count)
    ]
    return Ordeal(seed, own_bus, detached, instants)
