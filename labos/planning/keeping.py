"""Which starts still allow every window with a running clock to be kept, if all steps take their usual time.

Each workcell has a plan that keeps the windows that can be kept. The plan is a rehearsal (``rehearsal``): the
workcell simulated from now on, with the advice that it needs. Steps that start now in the plan may start. Any
other start is tried: it is allowed if a rehearsal that begins with it makes no further step late. If
necessary, other advice is tried; this search is limited. A step that starts a clock is tried together with
all steps that have to follow in time. It waits if a later start would keep its windows. If no plan keeps
them, it starts once nothing else happens: no run waits without end.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping

import msgspec

from labos.core import reasons
from labos.core.booked import find_begun_booking
from labos.core.ids import ModuleName, RunId, module_key
from labos.core.rules import convert_lab_s, examine
from labos.core.runs import PENDING, UNKNOWN, RunState, StepStatus, find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested
from labos.core.waits import Wait
from labos.planning.advice import list_options
from labos.planning.forecast import find_earliest_start, find_run, is_pending
from labos.planning.layout import is_down
from labos.planning.passage import find_first_trap, find_late_step
from labos.planning.player import FAR, Player, Step, find_chained
from labos.planning.punctual import PunctualOrders
from labos.planning.rehearsal import NO_ADVICE, Advice, RehearsalResult, play
from labos.planning.safety import Safety
from labos.planning.scene import Scene
from labos.planning.suggested import bring_forward, find_order, find_suggested_order, find_suggested_times
from labos.planning.touch import cell_key, window_key
from labos.planning.window_order import PUNCTUAL_S

SEARCH_LIMIT = 24
"""The most rehearsals in one search for a plan."""

CALM_S = 1.0
"""How long (lab seconds) nothing must have happened before a step starts although its following steps would
be too late, because something is in their way."""

ALONE_LIMIT = 8
"""The most rehearsals in one search for a run that is alone in the workcell."""


class CellOutlook(msgspec.Struct):
    """How a workcell goes on from one position of the log and one time. ``obliged`` are the runs with steps
    that have to start in time, ``advice`` says what steps wait for, and ``outcome`` is the result of the
    rehearsal. ``as_suggested``: the outlook follows an order of a planner or of the lab. The scene is made
    when it is first used. For a run alone in the workcell, ``safety`` is None: no run can be trapped."""

    state: LabState
    safety: Safety | None
    cell: str
    now: int
    obliged: list[RunState]
    advice: Advice
    known_scene: Scene | None = None
    outcome: RehearsalResult = msgspec.field(default_factory=RehearsalResult)
    as_suggested: bool = False

    @property
    def scene(self) -> Scene:
        if self.known_scene is None:
            self.known_scene = Scene(self.state, self.cell, self.now)
        return self.known_scene

    def with_run_alone(self, run: RunState) -> CellOutlook:
        """The outlook if this run were alone in the workcell."""
        scene = self.scene.with_run_alone(run)
        return CellOutlook(self.state, None, self.cell, self.now, [], NO_ADVICE, scene)

    def follow(self, advice: Advice) -> CellOutlook:
        """The same outlook with other advice."""
        return CellOutlook(self.state, self.safety, self.cell, self.now, self.obliged, advice, self.scene)


class Trial(msgspec.Struct, frozen=True):
    """A step of a run whose start is tried. Without a ``run``, no start is tried, and the plan goes on by
    itself. ``known`` are the windowed steps that are late in any case."""

    plan: CellOutlook
    run: RunState | None
    step: int
    known: set[Step]

    @property
    def who(self) -> Step:
        return str(self.run.id if self.run is not None else ""), self.step

    def list_newly_late(self, outcome: RehearsalResult) -> list[Step]:
        """The late steps that are not ``known``, the earliest due time first."""
        return [who for who in outcome.late if who not in self.known]

    def has_fault(self, outcome: RehearsalResult) -> bool:
        """Whether a step is late that is not ``known``, or a step could not follow in time any more."""
        return bool(self.list_newly_late(outcome)) or outcome.will_be_late is not None


Standing = dict[str, tuple[StepStatus, ...]]
"""How far the runs inside have come: the status of each step, by run."""


class Windows:
    """Checks starts in one state after the other. ``plays`` counts rehearsals."""

    def __init__(self, safety: Safety, own: Mapping[str, OrderSuggested]) -> None:
        self.plays = 0
        self._safety, self._own = safety, own
        self._at: tuple[int, int] | None = None
        self._plans: dict[str, CellOutlook] = {}
        self._advice: dict[str, Advice] = {}
        self._accepted: dict[Step, tuple[Advice, list[Step]]] = {}
        self._surely_late: set[Step] = set()
        self._needed_modules: dict[Step, frozenset[ModuleName]] = {}
        self._inside_at_first: dict[Step, set[str]] = {}
        self._at_rest: dict[Step, tuple[Standing, int]] = {}
        self._put_off: dict[Step, tuple[Standing, int]] = {}
        self._punctual = PunctualOrders(self._own)

    def find_planned_start(self, state: LabState, run: RunState, step: int, now: int) -> int:
        """The time at which the step starts in the plan that keeps the windows (UTC ns); FAR if it does not
        start there."""
        cell = state.runs.plan_of(run).workcell
        if not state.runs.windowed_in.get(cell) and not self._punctual.find_starts(state, cell, now):
            return FAR
        plan, who = self._plan(state, cell, now), (str(run.id), step)
        found = plan.outcome.starts.get(who, FAR)
        if found == FAR and plan.as_suggested:
            suggested = plan.advice.not_before.get(who, FAR)  # the run is admitted later
            return suggested if suggested > now else FAR
        if found <= now or run.has_started:
            return found
        return now if self._is_as_suggested(self._make_trial(plan, run, step)) else found

    def check_start(self, state: LabState, run: RunState, step: int, now: int) -> Wait | None:
        """What a start has to wait for so that windows can be kept; None if the step may start."""
        what = state.runs.plans[run.plan]
        follow = find_chained(run, what.plan, [step]) if what.windowed else ()
        if not what.windowed and not state.runs.windowed_in.get(what.plan.workcell):
            return None
        if what.plan.steps[step].recovers:
            return None  # no run that needs the module can continue before this step
        plan = self._plan(state, what.plan.workcell, now)
        trial = self._make_trial(plan, run, step)
        waits = self._hold_off(trial)
        if waits is not None:
            return waits
        if not plan.obliged and not follow:
            return self._check_later_steps(trial)
        who = trial.who
        self._needed_modules.pop(who, None)
        advice, found = self._search(trial, forced=True, limit=1)
        if any(late[0] == who[0] for late in trial.list_newly_late(found)):
            trial.known.update(self._list_late_alone(trial))
        at_first = trial.list_newly_late(found)
        behind = at_first[:1] or ([found.will_be_late] if found.will_be_late is not None else [])
        if behind and plan.as_suggested and plan.scene.flying:
            # All runs follow an order, and all goes as suggested: no better advice is searched for.
            return self._wait(trial, behind[0])
        if behind:
            advice, found = self._search(trial, forced=True)
        late = trial.list_newly_late(found)
        others = [other for other in late if other[0] != who[0]]
        named, again = found.will_be_late, now
        if others:
            running = {str(other.id) for other in plan.obliged}
            at_stake = any(other[0] in running for other in others)
            # A run without a running clock is only expected to be late: the wait for it is limited.
            named, again = others[0], FAR if at_stake else self._find_rest_time(trial)
        elif late:
            named = next(other for other in (*at_first, *late) if other[0] == who[0])
            again = self._find_better_time(trial)
        elif found.will_be_late is not None:
            again = self._find_rest_time(trial)
        if named is not None and again > now:
            return self._wait(trial, named, again)
        self._needed_modules.pop(who, None)
        self._accepted[who] = advice, [other for other in trial.known if other[0] == who[0]]
        return None

    def _make_trial(self, plan: CellOutlook, run: RunState | None, step: int) -> Trial:
        return Trial(plan, run, step, set(plan.outcome.late) | self._surely_late)

    def follows_order(self, state: LabState, cell: str, now: int) -> bool:
        """Whether everything goes as in an order that keeps all windows."""
        return self._plan(state, cell, now).as_suggested

    def _is_as_suggested(self, trial: Trial) -> bool:
        """Whether the suggested order admits a run now, and a rehearsal of this start makes no further step
        late."""
        plan, who = trial.plan, trial.who
        suggested = self._find_suggested_advice(plan.state, plan.cell, plan.now)
        if suggested is None or not _is_on_time(plan.state, suggested, plan.now):
            return False
        if suggested.not_before.get(who, FAR) > plan.now:
            return False
        advice = suggested.let_leave(who[0])
        trial = msgspec.structs.replace(trial, plan=plan.follow(advice))
        if trial.has_fault(self._search(trial, forced=True, limit=1)[1]):
            return False
        self._needed_modules.pop(who, None)
        self._accepted[who] = advice, []
        return True

    def _find_suggested_advice(self, state: LabState, cell: str, now: int) -> Advice | None:
        """The advice to follow the suggested order; None if no order is valid. Every run inside goes on, each
        step at its suggested time. With a planner's order, runs whose time has come are admitted too. Like
        other advice, it counts only if a rehearsal shows that it keeps the windows."""
        times = find_suggested_times(state, find_order(state, self._own, cell, now), now)
        if not times:
            return None
        times = bring_forward(state, times, now)
        inside = state.runs.list_inside(cell)
        goes_on = {run.id for run in inside if not run.paused and not run.is_ending}
        if find_suggested_order(state, cell, now) is not None:
            goes_on |= {run for (run, _), at in times.items() if at <= now}
        return Advice(
            not_before={(str(run), step): at for (run, step), at in times.items()},
            leaving=frozenset(str(run) for run, _ in times if run in goes_on),
        )

    def _find_better_time(self, trial: Trial) -> int:
        """The time at which a step should start (UTC ns) that would be followed too late if it started now.
        If no later start is better, it is the time of ``_find_rest_time``."""
        run, state, now, who = trial.run, trial.plan.state, trial.plan.now, trial.who
        assert run is not None
        _, later = self._search(trial)
        at = later.starts.get(who, now)
        found = not trial.has_fault(later) and at > now
        others = state.runs.list_inside(trial.plan.cell)
        here = _describe_standing(others)
        if found:
            # Deadlock avoidance may stop the step that should go first. So delay only once for each change.
            put_off = self._put_off.get(who)
            if put_off is None or put_off[0] != here:
                self._put_off[who] = here, at
            elif now >= put_off[1]:
                found = False
        inside = {str(other.id) for other in others} - {who[0]}
        if not found or (inside and not inside & self._inside_at_first.setdefault(who, inside)):
            # No better time, or all runs that were inside at first are gone: later ones wait outside for it.
            plan = state.runs.plan_of(run)
            self._needed_modules[who] = frozenset(
                plan.steps[i].module for i in find_chained(run, plan, [who[1]])
            )
        return at if found else self._find_rest_time(trial)

    def _find_rest_time(self, trial: Trial) -> int:
        """The time at which nothing will have happened for ``CALM_S`` (UTC ns). If windows let a step of a
        run inside start only later, it is the latest of these times. FAR while an action is under way whose
        end is an event; actions without a known end do not count."""
        plan, who = trial.plan, trial.who
        inside = plan.state.runs.list_inside(plan.cell)
        if any(end < FAR for end, *_ in plan.scene.flying):
            self._at_rest.pop(who, None)
            return FAR
        later = max((_find_next_start(plan.state, run) for run in inside), default=0)
        if later > plan.now:
            self._at_rest.pop(who, None)
            return later
        here = _describe_standing(inside)
        known, since = self._at_rest.get(who, (None, plan.now))
        if known != here:
            self._at_rest[who] = here, plan.now
            since = plan.now
        return max(plan.now, since + convert_lab_s(plan.state, CALM_S))

    def _check_later_steps(self, trial: Trial) -> Wait | None:
        """What a start waits for after which a step could not follow in time, whichever run goes first; None
        if it may start. It starts in any case once nothing else goes on."""
        run, plan = trial.run, trial.plan
        assert run is not None
        assert plan.safety is not None
        if run.has_started and not plan.safety.changes_anything(plan.state, run, trial.step):
            return None
        late = find_late_step(plan.state, plan.cell, [trial.who], plan.safety)
        if late is None or find_late_step(plan.state, plan.cell, [], plan.safety) is not None:
            return None
        again = self._find_rest_time(trial)
        return self._wait(trial, late, again) if again > plan.now else None

    def _hold_off(self, trial: Trial) -> Wait | None:
        """The wait of a run outside that needs a module of a run which waits until nothing happens and could
        start by the rules. That run is inside, or outside and older. None if there is no such run."""
        run, state, now = trial.run, trial.plan.state, trial.plan.now
        if run is None or run.has_started or not self._needed_modules:
            return None
        mine = {item.module for item in state.runs.plan_of(run).steps}
        for (name, index), modules in self._needed_modules.items():
            other = state.runs.get(name)
            if other is None or other.id == run.id or not (mine & modules):
                continue
            if not other.has_started and other.position > run.position:
                continue
            if not isinstance(examine(state, other, index, now), Wait):
                # The other run may find a better time, and no event marks that: check again soon.
                return self._wait(trial, (name, index), now + convert_lab_s(state, CALM_S))
        return None

    def _list_late_alone(self, trial: Trial) -> list[Step]:
        """The steps of a run that would be late even if it were alone in the workcell from now on."""
        assert trial.run is not None
        alone = Trial(trial.plan.with_run_alone(trial.run), trial.run, trial.step, set())
        return list(self._search(alone, limit=ALONE_LIMIT)[1].late)

    def remember(self, other: Windows) -> None:
        """Copy what another one has found earlier and cannot compute again from the state."""
        self._advice, self._surely_late = dict(other._advice), set(other._surely_late)
        self._at_rest, self._put_off = dict(other._at_rest), dict(other._put_off)
        self._needed_modules = dict(other._needed_modules)
        self._inside_at_first = dict(other._inside_at_first)
        self._punctual = other._punctual

    # -- the plan ------------------------------------------------------------------------------

    def _plan(self, state: LabState, cell: str, now: int) -> CellOutlook:
        if self._at != (state.position, now):
            self._at = (state.position, now)
            self._plans.clear()
            for (name, step), (advice, late) in self._accepted.items():
                run = state.runs.active.get(RunId(name))
                if run is not None and run.steps[step].status != PENDING:
                    self._advice[state.runs.plan_of(run).workcell] = advice
                    self._surely_late.update(late)
            self._accepted.clear()
            for store in (self._at_rest, self._put_off, self._needed_modules, self._inside_at_first):
                for who in [who for who in store if not _is_waiting(state, who)]:
                    del store[who]
            self._surely_late = {who for who in self._surely_late if who[0] in state.runs.windowed}
        found = self._plans.get(cell)
        if found is None:
            found = self._plans[cell] = self._make_plan(state, cell, now)
            self._advice[cell] = found.advice
        return found

    def _make_plan(self, state: LabState, cell: str, now: int) -> CellOutlook:
        safety = self._safety
        obliged = [run for run in _find_obliged(state, cell) if not _is_shut_out(state, run, now, safety)]
        before = self._advice.get(cell, NO_ADVICE) if obliged else NO_ADVICE
        plan = CellOutlook(state, safety, cell, now, obliged, before)
        starts = self._punctual.find_starts(state, cell, now)
        suggested = self._find_suggested_advice(state, cell, now) if starts or obliged else None
        if starts and suggested is not None:
            plan.advice, plan.outcome, plan.as_suggested = suggested, RehearsalResult(starts), True
            return plan
        if obliged:
            trial = self._make_trial(plan, None, 0)
            if suggested is not None and _is_on_time(state, suggested, now):
                # An order for all these runs is tried first, and kept if it keeps all windows.
                plan.advice = suggested
                _, plan.outcome = self._search(trial, limit=1)
                if not trial.has_fault(plan.outcome):
                    plan.as_suggested = find_suggested_order(state, cell, now) is not None
                    return plan
                plan.advice = before
            plan.advice, plan.outcome = self._search(trial)
        return plan

    # -- searching -----------------------------------------------------------------------------

    def _search(
        self, trial: Trial, *, forced: bool = False, limit: int = SEARCH_LIMIT
    ) -> tuple[Advice, RehearsalResult]:
        """The best advice that was found, and its result. ``forced``: the step of the trial starts now."""
        plan = trial.plan
        start = trial.who if trial.run is not None and forced else None
        tried: list[tuple[tuple[int, int], int, Advice, RehearsalResult]] = []
        open_: list[tuple[tuple[int, int], int, Advice, RehearsalResult]] = []

        def rehearse(advice: Advice) -> None:
            self.plays += 1
            outcome = play(plan.scene.copy(), _make_players(trial, advice), advice, start)
            if not trial.list_newly_late(outcome):
                _note_trap(plan, outcome)
            late = trial.list_newly_late(outcome)
            rank = len(late) + (outcome.will_be_late is not None), sum(outcome.late[who] for who in late)
            tried.append((rank, len(tried), advice, outcome))
            heapq.heappush(open_, tried[-1])

        def goes_on() -> bool:
            return min(tried)[0][0] > 0 and len(tried) < limit

        rehearse(plan.advice)
        suggested = self._find_suggested_advice(plan.state, plan.cell, plan.now) if goes_on() else None
        if suggested is not None:
            rehearse(suggested)
        while open_ and goes_on():
            *_, advice, outcome = heapq.heappop(open_)
            late = next(iter(trial.list_newly_late(outcome)), None)
            options = list_options(plan.state, trial.run, advice, outcome, late, start) if late else ()
            for option in options:
                if goes_on() and all(option != known for *_, known, _ in tried):
                    rehearse(option)
        *_, advice, outcome = min(tried)
        return advice, outcome

    # -- explaining ----------------------------------------------------------------------------

    def _wait(self, trial: Trial, late: Step, again: int = FAR) -> Wait:
        """The wait of a start after which the step ``late`` would be late. It ends when something may have
        changed: at ``again``, or at the next planned start or end (UTC ns)."""
        run, plan, state = trial.run, trial.plan, trial.plan.state
        whose = find_run(state, late[0])
        assert run is not None
        key = state.runs.plan_of(run).steps[trial.step].key
        late_key = state.runs.plan_of(whose).steps[late[1]].key
        why = reasons.FollowsLate if whose.id == run.id else reasons.WouldDelay
        mine = plan.advice.not_before.get(trial.who, FAR)
        times = [again, mine, *plan.outcome.starts.values(), *(end for end, *_ in plan.scene.flying)]
        modules = [module_key(item[3].module) for item in plan.scene.flying]
        windows = [window_key(other.id) for other in plan.obliged]
        return Wait(
            why(key, late[0], late_key),
            tuple(dict.fromkeys([cell_key(plan.cell), *windows, *modules])),
            until=min((at for at in times if plan.now < at < FAR), default=None),
        )


def _describe_standing(inside: Iterable[RunState]) -> Standing:
    return {str(run.id): tuple(run.statuses) for run in inside}


def _find_next_start(state: LabState, run: RunState) -> int:
    """The time from which the windows of a run let all its pending steps start (UTC ns; 0: at any time)."""
    return max(
        (
            find_earliest_start(state, run, i, {})
            for i, step in enumerate(run.steps)
            if step.status == PENDING
        ),
        default=0,
    )


def _is_waiting(state: LabState, who: Step) -> bool:
    """Whether a step has not started, and its run has not ended."""
    run = state.runs.get(who[0])
    return run is not None and is_pending(run, who[1])


def _find_obliged(state: LabState, cell: str) -> Iterator[RunState]:
    """The runs of a workcell with steps that have to start in time and that can be started."""
    for name in state.runs.windowed_in.get(cell, ()):
        run = state.runs.get(name)
        if run is None or find_holds(run) or run.is_ending or run.has(UNKNOWN):
            continue
        plan = state.runs.plan_of(run)
        chain = find_chained(run, plan, ())
        if not chain or any(is_down(state, plan.steps[step].module) for step in chain):
            continue
        if find_begun_booking(state, run, [plan.steps[step] for step in chain]) is None:
            yield run


def _is_shut_out(state: LabState, run: RunState, now: int, safety: Safety) -> bool:
    """Whether a waiting run could not reach its own end after any first step that the rules allow, whichever
    runs move."""
    if run.has_started:
        return False
    starts = [
        i for i in state.runs.plans[run.plan].starts if not isinstance(examine(state, run, i, now), Wait)
    ]
    return bool(starts) and all(
        safety.list_trapped(state, run, i, only_asking=True) == [run.id] for i in starts
    )


def _make_players(trial: Trial, advice: Advice) -> Iterable[Player]:
    plan, state, ends = trial.plan, trial.plan.state, trial.plan.scene.list_ends()
    obliged = {str(run.id): run for run in [*plan.obliged, *([trial.run] if trial.run is not None else [])]}
    leaving = [state.runs.get(name) for name in sorted(advice.leaving - obliged.keys())]
    going = [run for run in leaving if run is not None and not find_holds(run) and not run.is_ending]
    for run in (*obliged.values(), *going):
        name = str(run.id)
        first = [trial.step] if trial.run is not None and run.id == trial.run.id else []
        yield Player(state, run, ends.get(name, {}), free=name in advice.leaving, first=first)


def _note_trap(plan: CellOutlook, outcome: RehearsalResult) -> None:
    """Check whether planning would allow these starts, and note a trap or a step that will be late. After a
    trap, one windowed step counts as never started: of the run of that start, if it has one."""
    if plan.safety is None:
        return
    starts = list(outcome.starts)
    outcome.trap = find_first_trap(plan.state, plan.cell, starts, plan.safety)
    if outcome.trap is not None:
        name = outcome.trap[0][0]
        behind = [who for who in outcome.due if who[0] == name] or list(outcome.due)
        outcome.late.update(dict.fromkeys(behind[:1], FAR))
        return
    outcome.will_be_late = find_late_step(plan.state, plan.cell, starts, plan.safety)
    if (
        outcome.will_be_late is not None
        and find_late_step(plan.state, plan.cell, [], plan.safety) is not None
    ):
        outcome.will_be_late = None


def _is_on_time(state: LabState, suggested: Advice, now: int) -> bool:
    """Whether every step has started that should have by now. If not, an order with exact times counts for
    less, and reservations keep their margin."""
    return all(at >= now - convert_lab_s(state, PUNCTUAL_S) for at in suggested.not_before.values())
