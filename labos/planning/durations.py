"""Whether actions take longer or shorter than they did: their last times against the earlier ones.

Kept beside the fold, which does not need it: it can be read from the end of any log again. The time is that
between the two events, request and success, as that is what whoever waits has to wait.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Sequence

import msgspec

from labos.core.actions import (
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import ActionId
from labos.core.registry import Event

KEPT = 50
"""The last times that are kept of each action of a module."""

KINDS = 2_000
"""Actions that are kept: those that were carried out last."""

RECENT = 10
"""The last times, which are held against the earlier ones."""

DRIFT = 1.25
"""From which ratio of their medians on the last times tell that something has changed."""

LEARNED_FROM = (
    ActionRequested.TYPE,
    ActionSucceeded.TYPE,
    ActionRejected.TYPE,
    ActionFailed.TYPE,
    ActionReconciled.TYPE,
    ActionUnknown.TYPE,
)
"""The types of the events from which durations are learned."""

OPEN = 10_000


class Drift(msgspec.Struct, frozen=True):
    """An action that takes longer or shorter than it did: medians in seconds of wall time."""

    module: str
    action: str
    was_s: float
    is_s: float


class Durations:
    """What actions took, the last times of each action of a module."""

    def __init__(self) -> None:
        self._open: OrderedDict[ActionId, tuple[int, str, str]] = OrderedDict()
        self._times: OrderedDict[tuple[str, str], deque[int]] = OrderedDict()

    def learn(self, event: Event, at: int) -> None:
        """Take in an event of a log, in order; ``at`` is when it was recorded (UTC ns)."""
        match event:
            case ActionRequested():
                began = self._open.get(event.action, (at, "", ""))[0]
                self._open[event.action] = began, event.module, event.name
                if len(self._open) > OPEN:
                    self._open.popitem(last=False)
            case ActionSucceeded() if event.action in self._open:
                began, module, name = self._open.pop(event.action)
                self._keep((module, name), max(0, at - began))
            case ActionRejected() | ActionFailed() | ActionReconciled() | ActionUnknown():
                self._open.pop(event.action, None)

    def _keep(self, kind: tuple[str, str], took: int) -> None:
        times = self._times.setdefault(kind, deque(maxlen=KEPT))
        self._times.move_to_end(kind)
        times.append(took)
        if len(self._times) > KINDS:
            self._times.popitem(last=False)

    def drifts(self) -> list[Drift]:
        """The actions whose last times differ much from their earlier ones."""
        found: list[Drift] = []
        for (module, action), times in self._times.items():
            old, new = sorted([*times][:-RECENT]), sorted([*times][-RECENT:])
            if len(old) < RECENT:
                continue
            was, now = quantile(old, 0.5), quantile(new, 0.5)
            if max(was, now) > DRIFT * max(1, min(was, now)):
                found.append(Drift(module, action, was / 1e9, now / 1e9))
        return found


def quantile(ordered: Sequence[float], level: float) -> float:
    """The value at a level between 0 and 1 of values in order, between two of them in proportion."""
    place = level * (len(ordered) - 1)
    below = min(int(place), len(ordered) - 1)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)
