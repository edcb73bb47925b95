"""Learned durations of actions, from their last executions in the log, by module, action and arguments.

They are a part of the state, so every process that folds the same log plans with the same numbers. They are
only estimates: no invariant and no rule depends on them."""

from __future__ import annotations

import hashlib

import msgspec

from labos.core.actions import Action, ActionStatus
from labos.core.ids import ModuleName
from labos.core.model import PlanStep

KEPT = 20
"""The number of last durations that are kept of each kind of action."""

KINDS = 1_000
"""The most kinds of actions that are kept; those carried out last stay."""

ENOUGH = 3
"""From this number of durations on, the learned duration replaces the driver's nominal one."""

OUTLIER = 2.0
"""A duration of more than this many times the usual one counts as an interruption. It is stored as exactly
this multiple."""

SHARED = 4096


class Times(msgspec.Struct, array_like=True):
    """The last durations of a kind of action, oldest first, with the shortest, usual and longest of them. For
    actions with the same arguments they are in ns of wall time. For actions with different arguments they are
    in millionths of the planned duration; then ``planned`` has the planned durations (ns of wall time)."""

    took: list[int] = []
    planned: list[int] = []
    low: int = 0
    usual: int = 0
    high: int = 0

    @property
    def suffices(self) -> bool:
        return len(self.took) >= ENOUGH

    def add(self, took: int, planned: int | None = None) -> None:
        self.took.append(took)
        if planned is not None:
            self.planned.append(planned)
        if len(self.took) > KEPT:
            del self.took[0], self.planned[:-KEPT]
        ordered = sorted(self.took)
        self.usual = ordered[len(ordered) // 2]
        self.low, self.high = ordered[0], min(ordered[-1], int(OUTLIER * self.usual))


class Length(msgspec.Struct, frozen=True):
    """The shortest, usual and longest duration of a step (ns of wall time)."""

    low: int
    usual: int
    high: int


class Lengths(msgspec.Struct):
    """Durations by kind: of a module's action with its arguments, and of the action with any arguments
    (``make_kind``)."""

    by_kind: dict[str, Times] = {}

    def estimate(self, step: PlanStep, pace: float) -> Length | None:
        """The learned duration of a step; None if there are too few. Durations with the same arguments are
        preferred; otherwise those with other arguments are used, relative to the planned duration."""
        times, is_part = self.find_times(step)
        if times is None:
            return None
        if not is_part:
            return Length(times.low, times.usual, times.high)
        planned = step.duration_s * 1e3 / pace  # ns of each millionth
        return Length(*(int(part * planned) for part in (times.low, times.usual, times.high)))

    def find_times(self, step: PlanStep) -> tuple[Times | None, bool]:
        """The durations for a step, if there are enough, and whether they are relative to the planned
        duration (durations with other arguments)."""
        if not self.by_kind:
            return None, False
        fine = self.by_kind.get(make_kind(step))
        if fine is not None and fine.suffices:
            return fine, False
        coarse = self.by_kind.get(f"{step.module}\x1f{step.action}")
        return (coarse, True) if coarse is not None and coarse.suffices else (None, False)


class Drift(msgspec.Struct, frozen=True):
    """An action that takes a quarter more or less than planned, and differs by more than a second. Both
    durations are medians of its last times (at most ``KEPT``), in lab seconds."""

    module: ModuleName
    action: str
    takes_s: float
    planned_s: float


def learn(lengths: Lengths, action: Action, step: PlanStep, at: int, pace: float) -> None:
    """An action of a step has succeeded. Steps of people, actions that were sent again and those whose
    outcome was unknown do not count."""
    if step.by_person or action.status == ActionStatus.UNKNOWN or action.attempt > 1:
        return
    kind = make_kind(step)
    took, planned = max(0, at - action.requested_at), int(step.duration_s * 1e9 / pace)
    known = lengths.by_kind
    times = known.pop(kind, Times())
    times.add(took)
    known[kind] = times
    if planned > 0:
        any_arguments = f"{step.module}\x1f{step.action}"
        times = known.pop(any_arguments, Times())
        times.add(took * 1_000_000 // planned, planned)
        known[any_arguments] = times
    while len(known) > KINDS:
        del known[next(iter(known))]


DRIFT_RATIO, LEAST_DRIFT_S = 1.25, 1.0


def find_drifts(lengths: Lengths, pace: float) -> list[Drift]:
    """The drifts of all actions that were carried out often enough, in the order in which they were last
    carried out; ``pace`` is the lab's speed-up factor."""
    found: list[Drift] = []
    for kind, times in lengths.by_kind.items():
        module, action, *more = kind.split("\x1f")
        if more or not times.suffices:
            continue
        planned = sorted(times.planned)[len(times.planned) // 2]
        takes = planned * times.usual // 1_000_000
        longer, shorter = max(takes, planned), min(takes, planned)
        if longer > DRIFT_RATIO * shorter and longer - shorter > LEAST_DRIFT_S * 1e9:
            found.append(Drift(ModuleName(module), action, takes * pace / 1e9, planned * pace / 1e9))
    return found


_kinds: dict[int, tuple[PlanStep, str]] = {}
"""Kinds by the ids of step objects. The step is kept too, so that its id is not reused."""


def make_kind(step: PlanStep) -> str:
    """The kind of a step: its module, action and arguments as in its plan, with numbers of two digits, and
    its planned duration."""
    known = _kinds.get(id(step))
    if known is not None:
        return known[1]
    text = "\x1f".join(f"{name}={_round_value(value)}" for name, value in sorted(step.args.items()))
    text = f"{step.duration_s!r}\x1f{text}"
    mark = hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=6).hexdigest()
    kind = f"{step.module}\x1f{step.action}\x1f{mark}"
    _kinds[id(step)] = step, kind
    if len(_kinds) > SHARED:
        del _kinds[next(iter(_kinds))]
    return kind


def _round_value(value: object) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:.2g}"
    return str(value)
