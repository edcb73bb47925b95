"""How long a run may wait before each of its steps, so that all its windows are kept.

A window limits the sum of the waits before some consecutive steps: at least and at most. Here each single
step gets its limits. If each wait is within the limits of its step, no window is missed.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec


class WaitSpan(msgspec.Struct, frozen=True):
    """The limits on the sum of the waits before the steps from ``first`` to ``last``: ``least`` and ``most``
    (ns; None: no limit)."""

    first: int
    last: int
    least: int
    most: int | None


def share_waits(
    count: int, spans: Sequence[WaitSpan]
) -> tuple[tuple[int, ...], tuple[int | None, ...]] | None:
    """The shortest and the longest wait before each of ``count`` steps (ns; None: no limit). None if not all
    windows can be kept. Waits that are necessary come as late as possible, time to spare as early as
    possible."""
    earliest = _find_earliest(count, spans)
    if earliest is None:
        return None
    least = [at - before for at, before in zip(earliest, [0, *earliest], strict=False)]
    most: list[int | None] = [None] * count
    left = [
        None if span.most is None else span.most - sum(least[span.first : span.last + 1]) for span in spans
    ]
    for step in range(count):
        around = [n for n, s in enumerate(spans) if s.first <= step <= s.last and left[n] is not None]
        spare = min((left[n] or 0 for n in around), default=None)
        if spare is not None:
            most[step] = least[step] + spare
            for number in around:
                left[number] = (left[number] or 0) - spare
    return tuple(least), tuple(most)


def _find_earliest(count: int, spans: Sequence[WaitSpan]) -> list[int] | None:
    """The sum of the waits before the start of each step (ns), if each starts as early as its windows allow.
    None if the windows contradict one another: otherwise nothing changes any more after ``count`` rounds."""
    waited = [0] * count
    for _ in range(count + 1):
        before = list(waited)
        for step in range(1, count):
            waited[step] = max(waited[step], waited[step - 1])
        for span in spans:
            start = waited[span.first - 1]
            waited[span.last] = max(waited[span.last], start + span.least)
            if span.most is not None:
                waited[span.first - 1] = max(start, waited[span.last] - span.most)
        if waited == before:
            return waited
    return None
