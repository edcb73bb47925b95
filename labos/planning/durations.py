"""How long actions take, learned from what they took: by module, action and arguments.

Kept beside the fold, which does not need it: it can be read from the end of any log again. The time is that
between the two events, request and success, as that is what whoever waits has to wait.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict, deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from labos.core.actions import (
    Action,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.ids import ActionId
from labos.core.model import PlanStep
from labos.core.registry import Event

KEPT = 50
"""The last times that are kept of each kind of action."""

KINDS = 2_000
"""Kinds of actions that are kept: those that were carried out last."""

ENOUGH = 3
"""Times from which on what was learned goes before what a driver says of itself."""

RECENT = 10
"""The last times, which are held against the earlier ones."""

DRIFT = 1.25
"""From which ratio of their medians on the last times tell that something has changed."""

LEVELS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""The quantiles that a spread gives."""

NOMINAL = (0.9, 0.92, 0.96, 1.0, 1.04, 1.08, 1.1)
"""What is assumed of an action of which nothing is known but its nominal duration: these parts of it."""

LEARNED_FROM = (
    ActionRequested.TYPE,
    ActionSucceeded.TYPE,
    ActionRejected.TYPE,
    ActionFailed.TYPE,
    ActionReconciled.TYPE,
    ActionUnknown.TYPE,
)
"""The types of the events from which durations are learned."""

LONGEST_WORD = 60
OPEN = 10_000


class Drift(msgspec.Struct, frozen=True):
    """An action that takes longer or shorter than it did: medians in seconds of wall time."""

    module: str
    action: str
    was_s: float
    is_s: float


class Spreads(msgspec.Struct, frozen=True):
    """Durations at ``LEVELS`` (ns of wall time) by kind of action."""

    known: dict[str, tuple[int, ...]] = {}

    def lasts(self, action: Action, step: PlanStep, pace: float, level: float) -> int:
        """How long an action takes (ns of wall time), at a level between 0 and 1."""
        fine = kind_of(action.module, action.name, action.args, action.files)
        spread = self.known.get(fine) or self.known.get(kind_of(action.module, action.name))
        if spread is None:
            spread = tuple(int(step.duration_s * 1e9 / pace * part) for part in NOMINAL)
        return at_level(spread, level)


class Durations:
    """What actions took, the last times of each kind."""

    def __init__(self) -> None:
        self._open: OrderedDict[ActionId, tuple[int, str, str]] = OrderedDict()
        self._times: OrderedDict[str, deque[int]] = OrderedDict()

    def learn(self, event: Event, at: int) -> None:
        """Take in an event of a log, in order; ``at`` is when it was recorded (UTC ns)."""
        match event:
            case ActionRequested():
                fine = kind_of(event.module, event.name, event.args, event.files)
                began = self._open.get(event.action, (at, "", ""))[0]
                self._open[event.action] = began, fine, kind_of(event.module, event.name)
                if len(self._open) > OPEN:
                    self._open.popitem(last=False)
            case ActionSucceeded():
                began, *kinds = self._open.pop(event.action, (0, "", ""))
                for kind in kinds if began else ():
                    self._keep(kind, max(0, at - began))
            case ActionRejected() | ActionFailed() | ActionReconciled() | ActionUnknown():
                self._open.pop(event.action, None)

    def _keep(self, kind: str, took: int) -> None:
        times = self._times.setdefault(kind, deque(maxlen=KEPT))
        self._times.move_to_end(kind)
        times.append(took)
        if len(self._times) > KINDS:
            self._times.popitem(last=False)

    def spreads(self) -> Spreads:
        """What is known well enough."""
        known = {kind: sorted(times) for kind, times in self._times.items() if len(times) >= ENOUGH}
        return Spreads({kind: tuple(_spread(times)) for kind, times in known.items()})

    def drifts(self) -> list[Drift]:
        """The actions whose last times differ much from their earlier ones."""
        found: list[Drift] = []
        for kind, times in self._times.items():
            module, action, *more = kind.split("\x1f")
            old, new = sorted([*times][:-RECENT]), sorted([*times][-RECENT:])
            if more or len(old) < RECENT:
                continue
            was, now = quantile(old, 0.5), quantile(new, 0.5)
            if max(was, now) > DRIFT * max(1, min(was, now)):
                found.append(Drift(module, action, was / 1e9, now / 1e9))
        return found


def _spread(ordered: Sequence[int]) -> Iterator[int]:
    """The durations at ``LEVELS`` of all that could be, of which these are a few. Few values lie closer
    together than all: of n that are equally likely within bounds the ends are (n - 1) / (n + 1) of these
    apart."""
    middle, wider = quantile(ordered, 0.5), (len(ordered) + 1) / (len(ordered) - 1)
    for level in LEVELS:
        yield max(0, int(middle + (quantile(ordered, level) - middle) * wider))


def kind_of(
    module: str, action: str, args: Mapping[str, Any] | None = None, files: Mapping[str, str] | None = None
) -> str:
    """The kind of an action: without arguments that of all of them. Numbers count with two digits, files by
    their content, long words and tables by their sizes."""
    if args is None:
        return f"{module}\x1f{action}"
    told = [f"{name}={_coarse(value, files or {})}" for name, value in sorted(args.items())]
    mark = hashlib.sha256("\x1f".join(told).encode()).hexdigest()[:16]
    return f"{module}\x1f{action}\x1f{mark}"


def _coarse(value: Any, files: Mapping[str, str]) -> str:
    if isinstance(value, str):
        return files.get(value) or (value if len(value) <= LONGEST_WORD else f"{len(value):.1g}")
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:.2g}"
    if isinstance(value, list | tuple | dict):
        return f"{type(value).__name__} of {len(value)}"
    return str(value)


def quantile(ordered: Sequence[float], level: float) -> float:
    """The value at a level between 0 and 1 of values in order, between two of them in proportion."""
    place = level * (len(ordered) - 1)
    below = min(int(place), len(ordered) - 1)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)


def at_level(spread: Sequence[int], level: float) -> int:
    """The duration at a level between 0 and 1 of a spread."""
    for (low, first), (high, last) in zip(
        zip(LEVELS, spread, strict=True), zip(LEVELS[1:], spread[1:], strict=True), strict=False
    ):
        if level <= high:
            return int(first + (last - first) * (level - low) / (high - low))
    return spread[-1]
