"""A simplified model of a workcell, to look ahead often. In it, modules, zones and places are numbers.

Steps take their usual times. While a step lasts, it takes its module, its zones, the modules that a hand
reaches into, and the place where the grip changes. Labware takes room at its place and on its deck. It does
so from the start of the step that brings it to the end of the step that carries it away. A step starts as
soon as it can, if all runs inside can still reach their ends. Runs inside go first. Windows, doors and
setpoints are left out. No rule of safety depends on this model.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence

import msgspec

from labos.core.actions import Action, ActionStatus
from labos.core.effects import list_carried
from labos.core.ids import Owner, RunId, deck_key, run_owner
from labos.core.model import MAIN, Plan
from labos.core.runs import PENDING, SETTLED, SKIPPED, RunState, RunStatus, find_holds
from labos.core.state import LabState
from labos.planning.forecast import find_usual_time
from labos.planning.taken import count_room, find_station, is_deck, list_counted_keys, list_taken

SEARCH_LIMIT = 20
"""The most intermediate states that the search for a witness tries before a start counts as unsafe."""


class Task(msgspec.Struct, frozen=True, gc=False):
    """A step, with modules, zones and places as numbers. It ``takes`` some of them while it lasts. It
    ``gets`` room in some from its start, and ``frees`` room in others from its end. ``followers`` are the
    steps that come after it; ``before`` is the number of steps that come before it."""

    takes: tuple[int, ...]
    gets: tuple[int, ...]
    frees: tuple[int, ...]
    followers: tuple[int, ...]
    before: int
    main: bool = True

    @property
    def carries(self) -> bool:
        return bool(self.gets or self.frees)


def _add_to(counts: list[int], task: Task, sign: int) -> None:
    """Count the room that a task gets and frees, both at once (``sign`` 1), or undo this (-1)."""
    for key in task.gets:
        counts[key] += sign
    for key in task.frees:
        counts[key] -= sign


class Ways:
    """The plans of one bench in this model, and the room at its places. ``names`` are the keys by number."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}
        self.names: list[str] = []
        self.room: list[int] = []
        self._plans: dict[str, tuple[Task, ...]] = {}

    def read(self, state: LabState, name: str) -> tuple[Task, ...]:
        """A plan of the state, as tasks. ``name`` is the plan's id."""
        found = self._plans.get(name)
        if found is None:
            if len(self._plans) > max(256, 2 * len(state.runs.plans)):
                self._plans = {n: tasks for n, tasks in self._plans.items() if n in state.runs.plans}
            found = self._plans[name] = tuple(self._read(state, state.runs.plans[name].plan))
        return found

    def _read(self, state: LabState, plan: Plan) -> Iterator[Task]:
        followers: dict[int, list[int]] = {}
        for index, step in enumerate(plan.steps):
            for before in step.after:
                followers.setdefault(before, []).append(index)
        standing: dict[str, int] = {}
        for index, step in enumerate(plan.steps):
            gets: list[int] = []
            frees: list[int] = []
            for what in list_carried(step.effects):
                for key in list_counted_keys(state, what.emptied):
                    left = standing[key] = max(0, standing.get(key, 0) - 1)
                    if not (is_deck(key) and left):
                        frees.append(self._find_number(state, key))
                for key in list_counted_keys(state, what.filled):
                    if not (is_deck(key) and standing.get(key, 0)):
                        gets.append(self._find_number(state, key))
                    standing[key] = standing.get(key, 0) + 1
            takes = tuple(self._find_number(state, key) for key in list_taken(state, step))
            after = tuple(followers.get(index, ()))
            yield Task(takes, tuple(gets), tuple(frees), after, len(step.after), step.part == MAIN)

    def _find_number(self, state: LabState, key: str) -> int:
        number = self.numbers.get(key)
        if number is None:
            number = self.numbers[key] = len(self.names)
            self.names.append(key)
            station = find_station(state, key)
            self.room.append(1 if station is None else count_room(state, station))
        return number


class Outline:
    """The runs inside and some waiting runs, from ``now`` on (UTC ns). Runs have numbers; those of the runs
    inside come first. ``order`` has the starts of steps: (time, run, step). ``used`` is the room in use,
    ``floor`` that after the end of all steps in flight."""

    def __init__(self, state: LabState, cell: str, waiting: Sequence[RunState], now: int, ways: Ways) -> None:
        self.now = now
        self.runs: list[RunState] = []
        self.ways: list[tuple[Task, ...]] = []
        self.times: list[list[int]] = []
        self.before: list[list[int]] = []
        self.turns: list[list[int]] = []
        self.carrying: list[list[int]] = []
        self.left: list[int] = []
        self.inside: list[bool] = []
        self.ends: list[int] = []
        self.flying: list[tuple[int, int, int]] = []
        self.witness: list[int] = []
        self.order: list[tuple[int, int, int]] = []
        here = state.runs.list_inside(cell)
        known = [(run, ways.read(state, run.plan)) for run in [*here, *waiting]]
        self.room = ways.room
        self.used, self.floor, self.busy = ([0] * len(ways.room) for _ in range(3))
        flying = {(action.run, action.step): action for action in state.actions.list_in_cell(cell)}
        for run, way in known:
            self._add(state, run, way, flying)
        self._count_other_labware(state, {run_owner(run.id) for run in here}, ways)
        found = self._search()
        self.is_safe = found is not None
        self.witness = found or []

    def _add(
        self, state: LabState, run: RunState, way: tuple[Task, ...], flying: dict[tuple[RunId, int], Action]
    ) -> None:
        """Add a run in its present state."""
        plan, number, goes_on = state.runs.plan_of(run), len(self.runs), _goes_on(run)
        states = [step.status for step in run.steps] if run.has_started else [PENDING] * len(way)
        over = {index for index, status in enumerate(states) if status in SETTLED}
        turns: list[int] = []
        left = 0
        for index, (task, status) in enumerate(zip(way, states, strict=True)):
            if status == PENDING:
                left += task.main
                if task.main and not any(before not in over for before in plan.steps[index].after):
                    turns.append(index)
            elif status != SKIPPED:
                for key in task.gets:
                    self.used[key] += 1
                    self.floor[key] += 1
                for key in task.frees:
                    self.floor[key] -= 1
                    self.used[key] -= status in SETTLED
            action = flying.get((run.id, index))
            if status not in (PENDING, *SETTLED) and action is not None:
                left += 1
                end = max(self.now, action.requested_at + find_usual_time(state, plan.steps[index]))
                for key in task.takes:
                    self.busy[key] = 1
                if action.status != ActionStatus.UNKNOWN:
                    heapq.heappush(self.flying, (end, number, index))
        if not goes_on:
            turns, left = [], 0
        self.runs.append(run)
        self.ways.append(way)
        self.times.append([find_usual_time(state, step) for step in plan.steps])
        self.before.append([sum(b not in over for b in step.after) for step in plan.steps])
        self.turns.append(turns)
        pending = (i for i, status in enumerate(states) if status == PENDING and way[i].main)
        self.carrying.append([i for i in pending if way[i].carries] if goes_on else [])
        self.left.append(left)
        self.inside.append(run.has_started)
        self.ends.append(0)

    def _count_other_labware(self, state: LabState, owners: set[Owner], ways: Ways) -> None:
        """Count the room of labware that belongs to no run inside."""
        for number, key in enumerate(ways.names):
            station = find_station(state, key)
            strangers = sum(
                state.bench.labware[labware].owner not in owners
                for labware in (station.labware if station is not None else ())
            )
            if station is None or not strangers:
                continue
            self.used[number] += strangers
            self.floor[number] += strangers
            deck = ways.numbers.get(deck_key(station.spec.claim))
            if deck is not None:
                self.used[deck] += 1
                self.floor[deck] += 1

    def copy(self) -> Outline:
        other = Outline.__new__(Outline)
        other.now, other.runs, other.ways, other.times = self.now, self.runs, self.ways, self.times
        other.room, other.is_safe, other.witness = self.room, self.is_safe, self.witness
        other.before = [list(before) for before in self.before]
        other.turns = [list(turns) for turns in self.turns]
        other.carrying = [list(steps) for steps in self.carrying]
        other.left, other.inside, other.ends = list(self.left), list(self.inside), list(self.ends)
        other.flying, other.order = list(self.flying), list(self.order)
        other.used, other.floor, other.busy = list(self.used), list(self.floor), list(self.busy)
        return other

    # -- simulation ----------------------------------------------------------------------------

    def go_on(self, see: Callable[[Outline], None] | None = None) -> Outline:
        """Simulate until no step can start any more. Whenever all steps that can start have started, ``see``
        is called."""
        while True:
            moved = True
            while moved:
                moved = False
                for who in sorted(range(len(self.runs)), key=lambda who: not self.inside[who]):
                    for step in list(self.turns[who]):
                        witness = self.find_witness(who, step) if self.is_free(who, step) else None
                        if witness is not None:
                            self.start(who, step, witness)
                            moved = True
            if see is not None:
                see(self)
            if not self.flying:
                return self
            self.advance()

    def is_free(self, who: int, step: int) -> bool:
        """Whether all that a step takes is free, and there is room for all that it brings."""
        task = self.ways[who][step]
        for key in task.takes:
            if self.busy[key]:
                return False
        for key in task.gets:  # noqa: SIM110  (called too often for a generator)
            if self.used[key] >= self.room[key]:
                return False
        return True

    def find_in_the_way(self, who: int, step: int) -> Iterator[int]:
        """The numbers of a step's needs that are in use or full."""
        task = self.ways[who][step]
        yield from (key for key in task.takes if self.busy[key])
        yield from (key for key in task.gets if self.used[key] >= self.room[key])

    def list_held(self, who: int) -> set[int]:
        """The numbers of what a run has taken and not released since its start in this simulation."""
        held: list[int] = []
        flying = {step for _, other, step in self.flying if other == who}
        for _, other, step in self.order:
            task = self.ways[who][step] if other == who else None
            if task is not None:
                held += [*task.gets, *(task.takes if step in flying else ())]
                for key in task.frees if step not in flying else ():
                    if key in held:
                        held.remove(key)
        return set(held)

    def start(self, who: int, step: int, witness: list[int]) -> None:
        """Start a step. ``witness`` is an order of motions in which all runs inside reach their ends after
        this start."""
        task = self.ways[who][step]
        for key in task.takes:
            self.busy[key] = 1
        for key in task.gets:
            self.used[key] += 1
        _add_to(self.floor, task, 1)
        self.turns[who].remove(step)
        if task.carries:
            self.carrying[who].remove(step)
        self.inside[who], self.witness = True, witness
        self.order.append((self.now, who, step))
        heapq.heappush(self.flying, (self.now + self.times[who][step], who, step))

    def advance(self) -> None:
        """Go to the next end of a step."""
        self.now = self.flying[0][0]
        while self.flying and self.flying[0][0] <= self.now:
            _, who, step = heapq.heappop(self.flying)
            task = self.ways[who][step]
            for key in task.takes:
                self.busy[key] = 0
            for key in task.frees:
                self.used[key] -= 1
            for follower in task.followers:
                self.before[who][follower] -= 1
                if not self.before[who][follower] and self.ways[who][follower].main and self.left[who] > 0:
                    self.turns[who].append(follower)
            self.left[who] -= 1
            if self.left[who] <= 0:
                self.inside[who], self.ends[who] = False, self.now

    @property
    def value(self) -> tuple[int, int]:
        """The number of runs that have not reached their ends, and the time at which the last run ends: less
        is better."""
        return sum(left > 0 for left in self.left), max(self.ends, default=0)

    # -- whether all runs can reach their ends ---------------------------------------------------

    def find_witness(self, who: int, step: int) -> list[int] | None:
        """An order of motions, as numbers of runs, in which all runs inside reach their ends after this
        start. None if the search finds none."""
        task = self.ways[who][step]
        if not task.carries:
            return self.witness
        carrying, was_inside = self.carrying[who], self.inside[who]
        self.carrying[who] = [other for other in carrying if other != step]
        self.inside[who] = True
        _add_to(self.floor, task, 1)
        witness: list[int] | None = None
        if was_inside and who in self.witness:
            witness = list(self.witness)
            witness.remove(who)
            witness = witness if self._is_valid(witness) else None
        if witness is None:
            witness = self._search()
        _add_to(self.floor, task, -1)
        self.carrying[who], self.inside[who] = carrying, was_inside
        return witness

    def _is_valid(self, witness: Iterable[int]) -> bool:
        """Whether there is room for all motions of an order."""
        floor, done = list(self.floor), [0] * len(self.runs)
        for who in witness:
            if done[who] >= len(self.carrying[who]):
                return False
            task = self.ways[who][self.carrying[who][done[who]]]
            done[who] += 1
            for key in task.gets:
                if floor[key] >= self.room[key]:
                    return False
                floor[key] += 1
            for key in task.frees:
                floor[key] -= 1
        return True

    def _search(self) -> list[int] | None:
        """An order of motions in which all runs inside reach their ends. None if the search finds none."""
        who = [number for number, inside in enumerate(self.inside) if inside and self.carrying[number]]
        tasks = [[self.ways[number][step] for step in self.carrying[number]] for number in who]
        search = _Search(tasks, self.floor, self.room)
        return [who[number] for number in search.order] if search.search() else None


class _Search:
    """Searches for an order of motions. ``floor`` is the room that is used now; ``room`` is the capacity."""

    def __init__(self, tasks: list[list[Task]], floor: list[int], room: list[int]) -> None:
        self.tasks, self.floor, self.room = tasks, list(floor), room
        self.at = [0] * len(tasks)
        self.order: list[int] = []
        self._seen: set[tuple[int, ...]] = set()

    def search(self) -> bool:
        return self._finish() or self._deepen()

    def _move(self, number: int) -> bool:
        task = self.tasks[number][self.at[number]]
        for key in task.gets:
            if self.floor[key] >= self.room[key]:
                return False
        _add_to(self.floor, task, 1)
        self.at[number] += 1
        self.order.append(number)
        return True

    def _take_back(self, length: int) -> None:
        while len(self.order) > length:
            number = self.order.pop()
            self.at[number] -= 1
            _add_to(self.floor, self.tasks[number][self.at[number]], -1)

    def _is_over(self, number: int) -> bool:
        return self.at[number] >= len(self.tasks[number])

    def _finish(self) -> bool:
        """Let one run after the other go to its end, as long as one can. If a run is left, all motions are
        undone."""
        before, moved = len(self.order), True
        while moved:
            moved = False
            for number in range(len(self.tasks)):
                if self._is_over(number):
                    continue
                here = len(self.order)
                while not self._is_over(number) and self._move(number):
                    pass
                if self._is_over(number):
                    moved = True
                else:
                    self._take_back(here)
        if all(map(self._is_over, range(len(self.tasks)))):
            return True
        self._take_back(before)
        return False

    def _deepen(self) -> bool:
        for number in range(len(self.tasks)):
            if len(self._seen) >= SEARCH_LIMIT:
                return False
            here = len(self.order)
            if self._is_over(number) or not self._move(number):
                continue
            where = tuple(self.at)
            if where not in self._seen:
                self._seen.add(where)
                if self._finish() or self._deepen():
                    return True
            self._take_back(here)
        return False


def _goes_on(run: RunState) -> bool:
    if not run.has_started:
        return True
    return run.status == RunStatus.ACTIVE and not find_holds(run)
