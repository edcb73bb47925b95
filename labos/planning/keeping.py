"""Which starts leave a way to keep every window whose clock runs, if all steps take their nominal time.

For each workcell there is a plan that keeps the windows that can be kept: the way in which it goes on from
now in a rehearsal (``rehearsal``), with the advice that was found to be needed. What the plan has start
now may start. Any other start is tried out: it may go ahead if the rehearsal that begins with it makes
nobody late who is not late anyway, with other advice if need be; the search for advice is bounded. A
step that starts a clock is tried out together with all that has to follow in time. It waits if it would
be in time later, and goes ahead if no plan is found that keeps its windows: nobody waits for ever.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

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
from labos.planning.forecast import find_earliest_start, is_pending
from labos.planning.layout import is_down
from labos.planning.passage import find_first_trap, find_late_step
from labos.planning.player import FAR, Player, Step, find_chained
from labos.planning.punctual import PunctualOrders
from labos.planning.rehearsal import NO_ADVICE, Advice, RehearsalResult, play
from labos.planning.safety import Safety
from labos.planning.scene import Scene
from labos.planning.suggested import bring_forward, find_order, find_suggested_order, find_suggested_times
from labos.planning.touch import cell_key, window_key

SEARCH_LIMIT = 24
"""Rehearsals before the search for a plan is given up."""

CALM_S = 1.0
"""How long (lab seconds) nothing has to have happened before a step is started that cannot be followed in
time because of what stands in its way."""

PUNCTUAL_S = 5.0
"""So much later (lab seconds) than was suggested a step may start, and all goes as planned."""

ALONE_LIMIT = 8
"""The same, for a run that has the workcell to itself."""


class CellOutlook:
    """How a workcell goes on from one position of the log and one time: who has to start something in time
    (``obliged``), what each of them has to wait for, and what comes of it; ``as_suggested`` if that is what a
    planner suggested. Its scene is set when somebody needs it."""

    def __init__(self, state: LabState, cell: str, now: int, obliged: list[RunState], advice: Advice) -> None:
        self.cell, self.now = cell, now
        self.obliged, self.advice, self.outcome = obliged, advice, RehearsalResult()
        self.as_suggested = False
        self._state = state
        self._scene: Scene | None = None

    @property
    def scene(self) -> Scene:
        if self._scene is None:
            self._scene = Scene(self._state, self.cell, self.now)
        return self._scene

    def with_run_alone(self, run: RunState) -> CellOutlook:
        """The same, if nobody but a run were there."""
        other = CellOutlook(self._state, self.cell, self.now, [], NO_ADVICE)
        other._scene = self.scene.with_run_alone(run)
        return other


class Trial(msgspec.Struct, frozen=True):
    """A step of a run that is tried out (no run: nothing is, the plan goes on by itself), and the windowed
    steps that are late anyway."""

    plan: CellOutlook
    run: RunState | None
    step: int
    known: set[Step]

    def list_newly_late(self, outcome: RehearsalResult) -> list[Step]:
        """Who is late beside those, the first one first."""
        return [who for who in outcome.late if who not in self.known]


class Windows:
    """Judges starts in one state after the other. ``plays`` counts rehearsals."""

    def __init__(self, limit: int = SEARCH_LIMIT, own: dict[str, OrderSuggested] | None = None) -> None:
        self.plays = 0
        self._own = own if own is not None else {}
        self._limit = limit
        self._at: tuple[int, int] | None = None
        self._plans: dict[str, CellOutlook] = {}
        self._advice: dict[str, Advice] = {}
        self._tried: dict[Step, tuple[Advice, list[Step]]] = {}
        self._hopeless: dict[Step, bool] = {}
        self._anxious: dict[Step, frozenset[ModuleName]] = {}
        self._met: dict[Step, set[str]] = {}
        self._at_rest: dict[Step, tuple[dict[str, tuple[StepStatus, ...]], int]] = {}
        self._put_off: dict[Step, tuple[dict[str, tuple[StepStatus, ...]], int]] = {}
        self._punctual = PunctualOrders()

    def find_planned_start(self, state: LabState, run: RunState, step: int, now: int, safety: Safety) -> int:
        """When the plan that keeps the windows has the step start (UTC ns); FAR if it does not."""
        cell = state.runs.plan_of(run).workcell
        if not state.runs.windowed_in.get(cell) and not self._punctual.find_starts(state, cell, now):
            return FAR
        plan, who = self._plan(state, cell, now, safety), (str(run.id), step)
        found = plan.outcome.starts.get(who, FAR)
        if found == FAR and plan.as_suggested:
            suggested = plan.advice.not_before.get(who, FAR)  # it is let in later
            return suggested if suggested > now else FAR
        if found <= now or run.has_started:
            return found
        return now if self._is_as_suggested(state, plan, run, step, safety) else found

    def check_start(self, state: LabState, run: RunState, step: int, now: int, safety: Safety) -> Wait | None:
        """What a start has to wait for so that windows can be kept; None if it may go ahead."""
        what = state.runs.plans[run.plan]
        follow = find_chained(run, what.plan, [step]) if what.windowed else ()
        if not what.windowed and not state.runs.windowed_in.get(what.plan.workcell):
            return None
        if what.plan.steps[step].recovers:
            return None  # no run that needs the module can go on before
        plan = self._plan(state, what.plan.workcell, now, safety)
        waits = self._hold_off(state, plan, run, step, now)
        if waits is not None:
            return waits
        if not plan.obliged and not follow:
            return self._find_tangle(state, plan, run, step, safety)
        who = (str(run.id), step)
        self._anxious.pop(who, None)
        trial = Trial(plan, run, step, set(plan.outcome.late) | set(self._hopeless))
        advice, found = self._search(state, trial, safety, forced=True, limit=1)
        if any(late[0] == who[0] for late in trial.list_newly_late(found)):
            trial.known.update(self._list_late_alone(state, trial))
        at_first = trial.list_newly_late(found)
        behind = at_first[:1] or ([found.tangle] if found.tangle is not None else [])
        if behind and plan.as_suggested and plan.scene.flying:
            # Somebody has planned all of it, and it goes as planned: nothing better is looked for.
            return self._wait(state, plan, run, step, behind[0])
        if behind:
            advice, found = self._search(state, trial, safety, forced=True)
        late = trial.list_newly_late(found)
        others = [other for other in late if other[0] != who[0]]
        if others:
            running = {str(other.id) for other in plan.obliged}
            at_stake = any(other[0] in running for other in others)
            # Whose clock does not run yet is only foreseen to be late: it is not waited for without end.
            again = FAR if at_stake else self._find_rest_time(state, plan, who)
            if again > now:
                return self._wait(state, plan, run, step, others[0], again)
        elif late:
            again = self._find_better_time(state, trial, safety)
            if again > now:
                named = next(other for other in (*at_first, *late) if other[0] == who[0])
                return self._wait(state, plan, run, step, named, again)
        elif found.tangle is not None:
            again = self._find_rest_time(state, plan, who)
            if again > now:
                return self._wait(state, plan, run, step, found.tangle, again)
        self._anxious.pop(who, None)
        self._tried[who] = advice, [other for other in trial.known if other[0] == who[0]]
        return None

    def _is_as_suggested(
        self, state: LabState, plan: CellOutlook, run: RunState, step: int, safety: Safety
    ) -> bool:
        """Whether a run is to be let in now by the suggested order, and all windows are kept with it."""
        suggested = self._find_suggested_advice(state, plan.cell, plan.now)
        if suggested is None or not _is_on_time(state, suggested, plan.now):
            return False
        who = (str(run.id), step)
        if suggested.not_before.get(who, FAR) > plan.now:
            return False
        advice = suggested.let_leave(who[0])
        known = set(plan.outcome.late) | set(self._hopeless)
        trial = Trial(_follow(plan, advice), run, step, known)
        _, found = self._search(state, trial, safety, forced=True, limit=1)
        if trial.list_newly_late(found) or found.tangle is not None:
            return False
        self._anxious.pop(who, None)
        self._tried[who] = advice, []
        return True

    def _find_suggested_advice(self, state: LabState, cell: str, now: int) -> Advice | None:
        """To do as somebody has suggested: everybody inside goes on, each step at its time; with a planner's
        order those come in, too, whose time it is. Like any other advice it counts only if a rehearsal shows
        that it keeps the windows."""
        times = find_suggested_times(state, find_order(state, self._own, cell, now), now)
        if not times:
            return None
        times = bring_forward(state, times, now)
        goes_on = {run.id for run in _list_inside(state, cell) if not run.paused and not run.is_ending}
        if find_suggested_order(state, cell, now) is not None:
            goes_on |= {run for (run, _), at in times.items() if at <= now}
        return Advice(
            not_before={(str(run), step): at for (run, step), at in times.items()},
            leaving=frozenset(str(run) for run, _ in times if run in goes_on),
        )

    def _find_better_time(self, state: LabState, trial: Trial, safety: Safety) -> int:
        """When a step had better start that would be followed too late if it started now; ``now`` if there is
        no use in waiting."""
        run, now = trial.run, trial.plan.now
        assert run is not None
        who = (str(run.id), trial.step)
        _, later = self._search(state, trial, safety)
        at = later.starts.get(who, now)
        found = not trial.list_newly_late(later) and later.tangle is None and at > now
        others = _list_inside(state, trial.plan.cell)
        here = {str(other.id): tuple(other.statuses) for other in others}
        if found:
            # What was to go first may not be let go by safety: it is put off once, not again and again.
            put_off = self._put_off.get(who)
            if put_off is None or put_off[0] != here:
                self._put_off[who] = here, at
            elif now >= put_off[1]:
                found = False
        inside = {str(other.id) for other in others} - {who[0]}
        if not found or (inside and not inside & self._met.setdefault(who, inside)):
            # Nobody is left of those whom it met: it has waited long enough for who came later.
            chain = find_chained(run, state.runs.plan_of(run), [trial.step])
            self._anxious[who] = frozenset(state.runs.plan_of(run).steps[i].module for i in chain)
        return at if found else self._find_rest_time(state, trial.plan, who)

    def _find_rest_time(self, state: LabState, plan: CellOutlook, who: Step) -> int:
        """When nothing will have happened for long enough; FAR as long as something goes on whose end is an
        event. What nobody knows the end of does not go on."""
        inside = _list_inside(state, plan.cell)
        if any(end < FAR for end, *_ in plan.scene.flying):
            self._at_rest.pop(who, None)
            return FAR
        later = max((_find_next_start(state, run) for run in inside), default=0)
        if later > plan.now:
            self._at_rest.pop(who, None)
            return later
        here = {str(run.id): tuple(run.statuses) for run in inside}
        known, since = self._at_rest.get(who, (None, plan.now))
        if known != here:
            self._at_rest[who] = here, plan.now
            since = plan.now
        return max(plan.now, since + convert_lab_s(state, CALM_S))

    def _find_tangle(
        self, state: LabState, plan: CellOutlook, run: RunState, step: int, safety: Safety
    ) -> Wait | None:
        """A start waits after which some step could not follow in time any more, whoever goes first: it
        is started all the same when nothing else goes on."""
        if run.has_started and not safety.changes_anything(state, run, step):
            return None
        who = (str(run.id), step)
        late = find_late_step(state, plan.cell, [who], safety)
        if late is None or find_late_step(state, plan.cell, [], safety) is not None:
            return None
        again = self._find_rest_time(state, plan, who)
        return self._wait(state, plan, run, step, late, again) if again > plan.now else None

    def _hold_off(
        self, state: LabState, plan: CellOutlook, run: RunState, step: int, now: int
    ) -> Wait | None:
        """Nobody is let in who needs the modules of a run inside, or of an older one, that waits for calm."""
        if run.has_started or not self._anxious:
            return None
        mine = {item.module for item in state.runs.plan_of(run).steps}
        for (name, index), modules in self._anxious.items():
            other = state.runs.get(RunId(name))
            if other is None or other.id == run.id or not (mine & modules):
                continue
            if not other.has_started and other.position > run.position:
                continue
            if not isinstance(examine(state, other, index, now), Wait):
                # The other one may find a better time, which is no event: looked at again soon.
                again = plan.now + convert_lab_s(state, CALM_S)
                return self._wait(state, plan, run, step, (name, index), again)
        return None

    def _list_late_alone(self, state: LabState, trial: Trial) -> list[Step]:
        """Which windows of a run could not be kept if it had the workcell to itself from now on."""
        assert trial.run is not None
        alone = Trial(trial.plan.with_run_alone(trial.run), trial.run, trial.step, set())
        return list(self._search(state, alone, None, limit=ALONE_LIMIT)[1].late)

    def remember(self, other: Windows) -> None:
        """Take over what another one has in mind beside the state."""
        self._advice = dict(other._advice)
        self._hopeless = dict(other._hopeless)
        self._at_rest, self._put_off = dict(other._at_rest), dict(other._put_off)
        self._anxious, self._met = dict(other._anxious), dict(other._met)
        self._punctual = other._punctual

    # -- the plan ------------------------------------------------------------------------------

    def _plan(self, state: LabState, cell: str, now: int, safety: Safety) -> CellOutlook:
        if self._at != (state.position, now):
            self._at = (state.position, now)
            self._plans.clear()
            for (name, step), (advice, hopeless) in self._tried.items():
                run = state.runs.active.get(RunId(name))
                if run is not None and run.steps[step].status != PENDING:
                    self._advice[state.runs.plan_of(run).workcell] = advice
                    self._hopeless.update(dict.fromkeys(hopeless, True))
            self._tried.clear()
            known = {*self._at_rest, *self._put_off, *self._anxious, *self._met}
            for who in [who for who in known if not _is_waiting(state, who)]:
                self._at_rest.pop(who, None)
                self._put_off.pop(who, None)
                self._anxious.pop(who, None)
                self._met.pop(who, None)
            for who in [who for who in self._hopeless if RunId(who[0]) not in state.runs.windowed]:
                del self._hopeless[who]
        found = self._plans.get(cell)
        if found is None:
            found = self._plans[cell] = self._make_plan(state, cell, now, safety)
            self._advice[cell] = found.advice
        return found

    def _make_plan(self, state: LabState, cell: str, now: int, safety: Safety) -> CellOutlook:
        obliged = [run for run in _find_obliged(state, cell) if not _is_shut_out(state, run, now, safety)]
        before = self._advice.get(cell, NO_ADVICE) if obliged else NO_ADVICE
        plan = CellOutlook(state, cell, now, obliged, before)
        starts = self._punctual.find_starts(state, cell, now)
        suggested = self._find_suggested_advice(state, cell, now) if starts or obliged else None
        if starts and suggested is not None:
            plan.advice, plan.outcome, plan.as_suggested = suggested, RehearsalResult(starts), True
            return plan
        if obliged:
            trial = Trial(plan, None, 0, set(self._hopeless))
            if suggested is not None and _is_on_time(state, suggested, now):
                # What somebody has planned for all of them comes first, if it keeps all windows.
                plan.advice = suggested
                _, plan.outcome = self._search(state, trial, safety, limit=1)
                if not trial.list_newly_late(plan.outcome) and plan.outcome.tangle is None:
                    plan.as_suggested = find_suggested_order(state, cell, now) is not None
                    return plan
                plan.advice = before
            plan.advice, plan.outcome = self._search(state, trial, safety)
        return plan

    # -- searching -----------------------------------------------------------------------------

    def _search(
        self, state: LabState, trial: Trial, safety: Safety | None, *, forced: bool = False, limit: int = 0
    ) -> tuple[Advice, RehearsalResult]:
        """The best advice found and what comes of it; ``forced``: the step that is tried starts now."""
        plan, run = trial.plan, trial.run
        start = (str(run.id), trial.step) if run is not None and forced else None
        limit = limit or self._limit

        def rank(outcome: RehearsalResult) -> tuple[int, int]:
            late = trial.list_newly_late(outcome)
            return len(late) + (outcome.tangle is not None), sum(outcome.late[who] for who in late)

        def rehearse(advice: Advice) -> RehearsalResult:
            self.plays += 1
            players = _make_players(state, plan, advice, run, trial.step)
            outcome = play(plan.scene.copy(), players, advice, start)
            if safety is not None and not trial.list_newly_late(outcome):
                _find_trap(state, plan, outcome, safety)
            return outcome

        first = rehearse(plan.advice)
        best = (rank(first), plan.advice, first)
        open_ = [(*best[0], 0, plan.advice, first)]
        seen = {_make_key(plan.advice)}
        tried = 1
        suggested = (
            self._find_suggested_advice(state, plan.cell, plan.now) if best[0][0] and tried < limit else None
        )
        if suggested is not None:
            tried += 1
            found = rehearse(suggested)
            seen.add(_make_key(suggested))
            heapq.heappush(open_, (*rank(found), tried, suggested, found))
            if rank(found) < best[0]:
                best = (rank(found), suggested, found)
        while open_ and best[0][0] and tried < limit:
            *_, advice, outcome = heapq.heappop(open_)
            late = next(iter(trial.list_newly_late(outcome)), None)
            for option in list_options(state, run, advice, outcome, late, start) if late is not None else ():
                if _make_key(option) in seen or tried >= limit:
                    continue
                seen.add(_make_key(option))
                tried += 1
                found = rehearse(option)
                heapq.heappush(open_, (*rank(found), tried, option, found))
                if rank(found) < best[0]:
                    best = (rank(found), option, found)
                if not best[0][0]:
                    break
        return best[1], best[2]

    # -- explaining ----------------------------------------------------------------------------

    def _wait(
        self, state: LabState, plan: CellOutlook, run: RunState, step: int, late: Step, again: int = FAR
    ) -> Wait:
        """A start waits since somebody would be late, at least until something may be otherwise."""
        whose, now = state.runs.get(RunId(late[0])), plan.now
        assert whose is not None
        key, late_key = state.runs.plan_of(run).steps[step].key, state.runs.plan_of(whose).steps[late[1]].key
        itself = whose.id == run.id
        why = reasons.FollowsLate if itself else reasons.WouldDelay
        mine = plan.advice.not_before.get((str(run.id), step), FAR)
        times = [again, mine, *plan.outcome.starts.values(), *(end for end, *_ in plan.scene.flying)]
        modules = [module_key(item[3].module) for item in plan.scene.flying]
        windows = [window_key(other.id) for other in plan.obliged]
        return Wait(
            why(key, late[0], late_key),
            tuple(dict.fromkeys([cell_key(plan.cell), *windows, *modules])),
            until=min((at for at in times if now < at < FAR), default=None),
        )


def _list_inside(state: LabState, cell: str) -> list[RunState]:
    return state.runs.list_inside(cell)


def _find_next_start(state: LabState, run: RunState) -> int:
    """When the windows of a run let its next step start, at the latest of them (UTC ns)."""
    return max(
        (
            find_earliest_start(state, run, i, {})
            for i, step in enumerate(run.steps)
            if step.status == PENDING
        ),
        default=0,
    )


def _is_waiting(state: LabState, who: Step) -> bool:
    """Whether a step has not been started."""
    run = state.runs.get(RunId(who[0]))
    return run is not None and is_pending(run, who[1])


def _find_obliged(state: LabState, cell: str) -> Iterator[RunState]:
    """The runs of a workcell with steps that have to be started in time, and can be."""
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
    """Whether a run that waits to be let in could not come to its end, whichever runs move."""
    if run.has_started:
        return False
    starts = [
        i for i in state.runs.plans[run.plan].starts if not isinstance(examine(state, run, i, now), Wait)
    ]
    return bool(starts) and all(
        safety.list_trapped(state, run, i, only_asking=True) == [run.id] for i in starts
    )


def _make_players(
    state: LabState, plan: CellOutlook, advice: Advice, run: RunState | None, step: int
) -> Iterable[Player]:
    mine = [run] if run is not None else []
    ends: dict[str, dict[int, int]] = {}
    for end, _, (name, index), *_ in plan.scene.flying:
        ends.setdefault(name, {})[index] = end

    def player(who: RunState, *, free: bool, first: Iterable[int] = ()) -> Player:
        return Player(state, who, dict(ends.get(who.id, {})), free=free, first=first)

    for other in {r.id: r for r in [*plan.obliged, *mine]}.values():
        first = [step] if run is not None and other.id == run.id else []
        yield player(other, free=other.id in advice.leaving, first=first)
    names = {str(other.id) for other in [*plan.obliged, *mine]}
    for name in sorted(advice.leaving - names):
        leaving = state.runs.get(RunId(name))
        if leaving is not None and not find_holds(leaving) and not leaving.is_ending:
            yield player(leaving, free=True)


def _find_trap(state: LabState, plan: CellOutlook, outcome: RehearsalResult, safety: Safety) -> None:
    """See whether planning would let these starts happen; who cannot start never does."""
    starts = list(outcome.starts)
    outcome.trap = find_first_trap(state, plan.cell, starts, safety)
    if outcome.trap is None:
        outcome.tangle = find_late_step(state, plan.cell, starts, safety)
        if outcome.tangle is not None and find_late_step(state, plan.cell, [], safety) is not None:
            outcome.tangle = None
    if outcome.trap is not None:
        name = outcome.trap[0][0]
        behind = [who for who in outcome.due if who[0] == name] or list(outcome.due)
        outcome.late.update(dict.fromkeys(behind[:1], FAR))


def _follow(plan: CellOutlook, advice: Advice) -> CellOutlook:
    """The same outlook, with other advice."""
    other = CellOutlook(plan._state, plan.cell, plan.now, plan.obliged, advice)
    other._scene = plan.scene
    return other


def _is_on_time(state: LabState, suggested: Advice, now: int) -> bool:
    """Whether everything has started that should have by now. What was planned to the second counts for less
    where it does not go as planned: then reservations keep their margin."""
    return all(at >= now - convert_lab_s(state, PUNCTUAL_S) for at in suggested.not_before.values())


def _make_key(advice: Advice) -> tuple[object, ...]:
    return (
        tuple(sorted((who, others) for who, others in advice.behind.items())),
        tuple(sorted(advice.not_before.items())),
        tuple(sorted(advice.leaving)),
    )
