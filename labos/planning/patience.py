"""Runs inside that younger runs have overtaken too often.

Priority and fair share decide which run goes first; age decides only between equal runs. Without a limit, a
run could wait without end while younger runs of higher priority pass. So each run inside counts the younger
runs that have started a step on what its own waiting step needs. After ``PATIENCE`` such runs, it goes before
all runs without a deadline of a window. Until it has started a step, some younger runs are not admitted:
those that use one of its modules, or of the places that its step waits for.
"""

from __future__ import annotations

from labos.core import reasons
from labos.core.actions import ActionStatus
from labos.core.effects import Carrying
from labos.core.ids import RunId, module_key, station_key, zone_key
from labos.core.model import PlanStep
from labos.core.runs import RunState, find_holds
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.core.zones import find_zones
from labos.planning.forecast import list_left
from labos.planning.wait_list import WaitList
from labos.planning.waiting import PATIENCE

NOT_OVERTAKEN = (
    reasons.TooEarly,
    reasons.RetryLater,
    reasons.Booked,
    reasons.BookedSoon,
    reasons.After,
    reasons.Cancelling,
    reasons.NotPending,
    reasons.Gone,
    reasons.StillToCome,
    reasons.ForOthers,
)
"""The reasons for a wait that no start of another run makes longer: it is a wait for a time, or for the run
itself."""

MOST_SHAPES = 4096
"""The most shapes of plans whose keys are remembered."""


class OvertakeCounts:
    """How many younger runs have overtaken each run inside. It only counts; the counts begin at zero when the
    kernel starts."""

    def __init__(self) -> None:
        self._overtaken: dict[RunId, dict[RunId, bool]] = {}
        self._keys: dict[str, frozenset[str]] = {}

    def is_over(self, run: RunId) -> bool:
        """Whether a run inside was overtaken too often."""
        return len(self._overtaken.get(run, ())) >= PATIENCE

    def count_start(self, state: LabState, run: RunState, step: int, wait_list: WaitList) -> None:
        """Count a start for the older runs inside that wait for what it takes. The count of the run that
        starts is reset."""
        plan = state.runs.plan_of(run)
        self._overtaken.pop(run.id, None)
        takes: frozenset[str] | None = None
        for name in wait_list.list_among(state.runs.in_cell.get(plan.workcell, {})):
            elder = state.runs.active[RunId(name)]
            if elder.position >= run.position:
                continue
            for index in _list_overtakable(wait_list, elder.id):
                if takes is None:
                    takes = list_keys(state, plan.steps[step])
                if takes & list_keys(state, state.runs.plan_of(elder).steps[index]):
                    self.overtake(elder.id, run.id)
                    break

    def overtake(self, elder: RunId, younger: RunId) -> None:
        """Note that a younger run has started a step on what an older run waits for."""
        self._overtaken.setdefault(elder, {})[younger] = True

    def forget(self, run: RunId) -> None:
        """Forget a run that has ended."""
        self._overtaken.pop(run, None)

    def forget_keys(self) -> None:
        """Forget the keys of plans, because the bench of a workcell has changed."""
        self._keys.clear()

    def _list_all_keys(self, state: LabState, run: RunState) -> frozenset[str]:
        """The keys of everything that the steps of a run need."""
        shape, steps = state.runs.plans[run.plan].shape, state.runs.plan_of(run).steps
        found = self._keys.get(shape)
        if found is None:
            if len(self._keys) >= MOST_SHAPES:
                self._keys.clear()
            keys = (key for step in steps for key in (module_key(step.module), *list_keys(state, step)))
            found = self._keys[shape] = frozenset(keys)
        return found

    def find_run_that_goes_first(self, state: LabState, run: RunState, wait_list: WaitList) -> RunId | None:
        """The run inside for which this run is not admitted; None if there is none. While nothing moves in
        the workcell, no run is kept out, because the older run may wait for something that this run
        brings."""
        plan = state.runs.plan_of(run)
        flying = state.actions.list_in_cell(plan.workcell) if self._overtaken else ()
        if all(action.status == ActionStatus.UNKNOWN for action in flying):
            return None
        mine: frozenset[str] = frozenset()
        for elder in state.runs.list_inside(plan.workcell):
            if elder.position >= run.position or not self.is_over(elder.id) or find_holds(elder):
                continue
            waiting = _list_overtakable(wait_list, elder.id)
            if not waiting:
                continue
            mine = mine or self._list_all_keys(state, run)
            steps = state.runs.plan_of(elder).steps
            theirs = {module_key(step.module) for step in list_left(state, elder)}.union(
                *(list_keys(state, steps[i]) for i in waiting)
            )
            if mine & theirs:
                return elder.id
        return None


def _list_overtakable(wait_list: WaitList, run: RunId) -> list[int]:
    """The steps of a run that wait for something that other runs have."""
    return [step for step, waits in wait_list.find_waits(run).items() if any(map(_is_overtakable, waits))]


def _is_overtakable(wait: Wait) -> bool:
    return not wait.blocked and not isinstance(wait.reason, NOT_OVERTAKEN)


def list_keys(state: LabState, step: PlanStep) -> frozenset[str]:
    """The keys of the modules, stations and zones that a step needs."""
    found: list[str] = []
    if step.exclusive:
        found += [module_key(step.module), *map(zone_key, find_zones(state, step.module, step.effects))]
    for what in step.effects:
        for place in what.entered if isinstance(what, Carrying) and not what.stock else what.room:
            spec = state.bench.stations[place].spec
            if spec.kind != "waste":
                found.append(station_key(place))
            if spec.module and not spec.stands_apart:
                found.append(module_key(spec.module))
    return frozenset(found)
