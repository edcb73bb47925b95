"""The reasons for which runs waited: they are not events, so they are computed again.

Each pause between events is charged to the reason that was valid at its beginning.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.actions import ActionStatus
from labos.core.envelope import Envelope
from labos.core.fold import evolve
from labos.core.modules import ModuleStatus
from labos.core.reasons import ModuleBusy, ModuleDown, NotPending, Unsettled
from labos.core.registry import Event
from labos.core.rules import NODE_AWAY_S
from labos.core.runs import IN_FLIGHT, UNKNOWN, RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.obstacle import explain_wait
from labos.planning.scheduler import Scheduler, list_ready_steps

NOTICED_NS = 1_000_000
"""For shorter pauses between events, no reason is computed."""

QUEUED_JUDGED = 12
"""The reason is determined for at most so many waiting runs; those behind them wait for their turn."""

BEHIND = "runs that were submitted before go first"
READY = "it may start and will start next"
KEPT = "it may start; probably the lab lets others go first, so that all work ends sooner"

KEPT_NS = 1_000_000_000
"""A step that may start does so much sooner (wall time), unless the lab lets others go first."""


class WaitReason(msgspec.Struct, frozen=True):
    """Why a run does not continue: the step, a sentence, and what a person can do about it."""

    step: int
    why: str
    blocked: bool = False
    remedy: str = ""


class WaitBook:
    """Charges time to reasons while events are read, in wall nanoseconds."""

    def __init__(self) -> None:
        self.state = LabState()
        self.scheduler = Scheduler()
        self.charged: dict[str, dict[str, int]] = {}

    def add(self, event: Event, head: Envelope) -> None:
        """Take in one event, in order."""
        if self.state.position and head.recorded_at - self.state.recorded_at > NOTICED_NS:
            self.charge(head.recorded_at)
        evolve(self.state, event, head.position, head.recorded_at)

    def charge(self, until: int) -> None:
        """Charge the time from the last event to ``until``."""
        state = self.state
        now, length = state.recorded_at, until - state.recorded_at
        for run in state.runs.active.values():
            if not run.has(IN_FLIGHT, UNKNOWN):
                self._charge(run, now, length)
        for number, run in enumerate(state.runs.queued.values()):
            if number < QUEUED_JUDGED:
                self._charge(run, now, length)
            else:
                self._note(run.id, BEHIND, length)

    def _charge(self, run: RunState, now: int, length: int) -> None:
        found = list_reasons(self.state, run, now, self.scheduler, causes=False)
        self._note(run.id, found[0].why if found else READY, length)

    def _note(self, run: str, why: str, length: int) -> None:
        times = self.charged.setdefault(run, {})
        times[why] = times.get(why, 0) + length


def list_reasons(
    state: LabState, run: RunState, now: int, scheduler: Scheduler | None = None, *, causes: bool = True
) -> list[WaitReason]:
    """Why a run does not continue now; empty if one of its steps may start, or is in flight at a node that is
    present. With ``causes``, also the obstacles for a run that the safety check holds back."""
    scheduler = scheduler or Scheduler()

    def words(wait: Wait) -> str:
        return explain_wait(scheduler.safety, state, run, wait) if causes else wait.reason.sentence

    return [
        *_list_absent_nodes(state, run),
        *(
            WaitReason(step, words(wait), wait.blocked, wait.reason.remedy)
            for step, wait in (
                (step, _name_unknown(state, wait)) for step, wait in scheduler.list_waits(state, run, now)
            )
            if not isinstance(wait.reason, NotPending)
        ),
    ]


def list_unknown_reasons(state: LabState, run: RunState, now: int) -> list[WaitReason]:
    """Why a run probably does not continue for which ``list_reasons`` finds nothing."""
    if not is_kept_back(state, run, now):
        return []
    ready = list_ready_steps(state, run) if run.has_started else state.runs.plans[run.plan].starts
    return [WaitReason(step, KEPT) for step in ready[:1]]


def is_kept_back(state: LabState, run: RunState, now: int) -> bool:
    """Whether the lab lets others go before a run for which ``list_reasons`` finds no reason. The orders that
    the lab has found are not in its log. But it keeps a step waiting only while something moves in the
    workcell, and every other step has started after ``KEPT_NS``."""
    is_moving = state.actions.is_any_moving(state.runs.plan_of(run).workcell)
    return is_moving and not run.has(IN_FLIGHT, UNKNOWN) and now - state.recorded_at > KEPT_NS


def _name_unknown(state: LabState, wait: Wait) -> Wait:
    """A module whose last action has an unknown outcome is busy until a person has answered."""
    busy = wait.reason.module if isinstance(wait.reason, ModuleBusy) else ""
    for action in state.actions.open.values() if busy else ():
        question = state.interventions.find_about(action.id) if action.module == busy else None
        if question is not None and action.status == ActionStatus.UNKNOWN:
            return Wait(Unsettled(action.module, question.id), wait.on)
    return wait


def _list_absent_nodes(state: LabState, run: RunState) -> Iterable[WaitReason]:
    """Steps in flight whose nodes are away: only the nodes know how the actions ended."""
    steps = state.runs.plan_of(run).steps
    for index, step in enumerate(run.steps):
        module = state.modules.by_name.get(steps[index].module) if step.status == IN_FLIGHT else None
        if module is not None and module.status == ModuleStatus.GONE:
            wait = Wait(ModuleDown(module.spec.name, "GONE", module.error))
            asked = f"; {NODE_AWAY_S:g} s after it went a person is asked how {steps[index].action!r} ended"
            yield WaitReason(index, wait.reason.sentence + asked, True, wait.reason.remedy)
