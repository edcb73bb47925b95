"""How long a step takes, at a quantile of its past durations."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from labos.core.lengths import Lengths
from labos.core.model import PlanStep

SPREAD = 0.1
"""The assumption for a step that was not carried out often enough: its duration differs from the nominal one
by at most this part, and all such durations are equally likely."""


def estimate_at_level(lengths: Lengths, step: PlanStep, pace: float, level: float) -> int:
    """How long a step takes (ns of wall time) at a level between 0 and 1."""
    planned = step.duration_s * 1e9 / pace
    times, is_part = lengths.find_times(step)
    if times is None:
        return int(planned * (1 + SPREAD * (2 * level - 1)))
    found = find_quantile(sorted(times.took), level)
    return int(found * planned / 1e6 if is_part else found)


def find_quantile(ordered: Sequence[float], level: float) -> float:
    """The value at a level between 0 and 1 of sorted values, interpolated linearly."""
    place = level * (len(ordered) - 1)
    below = min(int(place), len(ordered) - 1)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)


def draw(what: str) -> float:
    """A number between 0 and 1; the same words always give the same number."""
    return int.from_bytes(hashlib.blake2b(what.encode(), digest_size=8).digest()) / 2**64
