"""Runs that nobody has submitted yet: drawn from those that were submitted last.

A forecast is missed most by what others submit after it. So it is carried on with newcomers as well: they
come as others came in the past, after such as have come last. Kept beside the fold, as it can be read from
the end of any log again. Runs of experiments, campaigns and closings are not among them.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from typing import TypeVar

import msgspec

from labos.core.decide.runs import SubmitRun
from labos.core.model import Plan
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.registry import Event
from labos.core.runs import RunSubmitted

KEPT = 40
"""The last runs that are kept."""

PLANS = 200
"""Plans that are kept of runs that may come."""

ENOUGH = 8
"""With fewer of them nobody is expected."""

BEFORE = 3
"""So many pauses before are compared: who comes in fours comes so again."""

MOST = 20
"""So many newcomers are drawn at most."""

T = TypeVar("T")

HEARD_OF = (RunSubmitted.TYPE, PlanRecorded.TYPE, PlanStepsRecorded.TYPE)
"""The types of the events from which it is learned who comes."""


class Newcomer(msgspec.Struct, frozen=True):
    """What somebody submitted, so long after the one before (ns of wall time)."""

    pause: int
    plans: tuple[Plan, ...]
    user: str
    priority: int


class Newcomers(msgspec.Struct, frozen=True):
    """The last runs that were submitted, oldest first, and when the last one was (UTC ns)."""

    known: tuple[Newcomer, ...] = ()
    last_at: int = 0

    def draw(self, now: int, pick: Callable[[str], float]) -> list[tuple[int, SubmitRun]]:
        """Who comes after ``now`` and when (UTC ns), in order; ``pick`` gives a number between 0 and 1 for a
        word."""
        pauses = [known.pause for known in self.known]
        if len(pauses) < ENOUGH:
            return []
        alike = self._alike(pauses, now - self.last_at)
        if not alike:
            return []  # nobody has come for longer than ever: perhaps nobody does any more
        found: list[tuple[int, SubmitRun]] = []
        index, at = _one(alike, pick("from")), self.last_at
        for number in range(MOST):
            known = self.known[index]
            at += known.pause
            first, *others = known.plans
            run = SubmitRun(first, known.user, priority=known.priority, others=tuple(others))
            found.append((max(at, now + 1), run))
            index += 1
            if index == len(pauses):
                index = _one(range(len(pauses)), pick(f"from {number}"))
        return found

    def _alike(self, pauses: Sequence[int], waited: int) -> list[int]:
        """Who came, in the past, when those before had come as the last ones have now, and after no shorter
        pause than there was since: the most alike of them."""
        places = [i for i in range(BEFORE, len(pauses)) if pauses[i] >= waited]
        last = pauses[-BEFORE:]

        def differs(index: int) -> float:
            pairs = zip(pauses[index - BEFORE : index], last, strict=True)
            return sum(abs(math.log1p(a / 1e9) - math.log1p(b / 1e9)) for a, b in pairs)

        return sorted(places, key=differs)[: max(5, len(pauses) // 5)]


def _one(values: Sequence[T], level: float) -> T:
    return values[min(len(values) - 1, int(level * len(values)))]


class SubmissionHistory:
    """Learns who comes, from the events of a log in order."""

    def __init__(self) -> None:
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._runs: deque[tuple[RunSubmitted, int]] = deque(maxlen=KEPT)
        self._last_at = 0

    def learn(self, event: Event, at: int) -> None:
        """Take in an event; ``at`` is when it was recorded (UTC ns)."""
        match event:
            case PlanRecorded():
                plan = Plan(event.workflow, event.workcell, (), event.feeds, event.files, event.holds)
                self._plans[event.plan] = plan
                self._plans.move_to_end(event.plan)
                if len(self._plans) > PLANS:
                    self._plans.popitem(last=False)
            case PlanStepsRecorded() if event.plan in self._plans:
                known = self._plans[event.plan]
                steps = (*known.steps[: event.first], *event.steps)
                self._plans[event.plan] = msgspec.structs.replace(known, steps=steps)
            case RunSubmitted() if not (event.experiment or event.campaign or event.closing):
                for name in event.choices or (event.plan,):
                    if name in self._plans:
                        self._plans.move_to_end(name)
                pause = at - self._last_at if self._last_at else 0
                if self._last_at:
                    self._runs.append((event, pause))
                self._last_at = at

    def pause(self) -> None:
        """What comes next comes from another lab: the time until then tells nothing."""
        self._last_at = 0

    def newcomers(self) -> Newcomers:
        """Those whose plans are known."""
        found = []
        for run, pause in self._runs:
            names = run.choices or (run.plan,)
            if all(name in self._plans for name in names):
                plans = tuple(self._plans[name] for name in names)
                found.append(Newcomer(pause, plans, run.user, run.priority))
        return Newcomers(tuple(found), self._last_at)
