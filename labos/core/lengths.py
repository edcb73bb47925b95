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


class Length(msgspec.Struct, frozen=True):
    """The shortest, usual and longest duration of a step (ns of wall time)."""

    low: int
    usual: int
    high: int


class Times(msgspec.Struct, array_like=True):
    """The last durations of a kind of action, oldest first. For actions with the same arguments they are in
    ns of wall time. For actions with different arguments they are in millionths of the planned duration;
    then ``planned`` has the planned durations (ns of wall time)."""

    took: list[int] = []
    planned: list[int] = []

    @property
    def suffices(self) -> bool:
        return len(self.took) >= ENOUGH

    def measure(self) -> Length:
        """The shortest, usual and longest of the durations, in their unit."""
        ordered = sorted(self.took)
        usual = ordered[len(ordered) // 2]
        return Length(ordered[0], usual, min(ordered[-1], int(OUTLIER * usual)))


class Lengths(msgspec.Struct):
    """Durations by kind: of a module's action with its arguments, and of the action with any arguments
    (``make_kinds``). Those of the action carried out last are at the end."""

    by_kind: dict[str, Times] = {}

    def estimate(self, step: PlanStep, pace: float) -> Length | None:
        """The learned duration of a step; None if there are too few. Durations with the same arguments are
        preferred; otherwise those with other arguments are used, relative to the planned duration."""
        times, is_part = self.find_times(step)
        if times is None:
            return None
        found = times.measure()
        if not is_part:
            return found
        planned = step.duration_s * 1e3 / pace  # ns of each millionth
        return Length(int(found.low * planned), int(found.usual * planned), int(found.high * planned))

    def find_times(self, step: PlanStep) -> tuple[Times | None, bool]:
        """The durations for a step, if there are enough, and whether they are relative to the planned
        duration (durations with other arguments)."""
        if not self.by_kind:
            return None, False
        same_arguments, any_arguments = make_kinds(step)
        fine = self.by_kind.get(same_arguments)
        if fine is not None and fine.suffices:
            return fine, False
        coarse = self.by_kind.get(any_arguments)
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
    same_arguments, any_arguments = make_kinds(step)
    took, planned = max(0, at - action.requested_at), int(step.duration_s * 1e9 / pace)
    _move_to_end(lengths.by_kind, same_arguments).took.append(took)
    if planned > 0:
        times = _move_to_end(lengths.by_kind, any_arguments)
        times.took.append(took * 1_000_000 // planned)
        times.planned.append(planned)
    while len(lengths.by_kind) > KINDS:
        del lengths.by_kind[next(iter(lengths.by_kind))]


def _move_to_end(by_kind: dict[str, Times], kind: str) -> Times:
    """Move a kind to the end, and return its durations, to which one more is added. If there are ``KEPT``
    already, the oldest is deleted."""
    times = by_kind[kind] = by_kind.pop(kind) if kind in by_kind else Times()
    if len(times.took) >= KEPT:
        del times.took[0], times.planned[:1]
    return times


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
        takes = planned * times.measure().usual // 1_000_000
        longer, shorter = max(takes, planned), min(takes, planned)
        if longer > DRIFT_RATIO * shorter and longer - shorter > LEAST_DRIFT_S * 1e9:
            found.append(Drift(ModuleName(module), action, takes * pace / 1e9, planned * pace / 1e9))
    return found


_kinds: dict[int, tuple[PlanStep, str, str]] = {}
"""Kinds by the ids of step objects. The step is kept too, so that its id is not reused."""


def make_kinds(step: PlanStep) -> tuple[str, str]:
    """The kinds of a step: its module, action and arguments as in its plan, with numbers of two digits, and
    its planned duration; and only its module and action."""
    known = _kinds.get(id(step))
    if known is not None:
        return known[1], known[2]
    text = "\x1f".join(f"{name}={_round_value(value)}" for name, value in sorted(step.args.items()))
    text = f"{step.duration_s!r}\x1f{text}"
    mark = hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=6).hexdigest()
    any_arguments = f"{step.module}\x1f{step.action}"
    same_arguments = f"{any_arguments}\x1f{mark}"
    _kinds[id(step)] = step, same_arguments, any_arguments
    if len(_kinds) > SHARED:
        del _kinds[next(iter(_kinds))]
    return same_arguments, any_arguments


def _round_value(value: object) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:.2g}"
    return str(value)
