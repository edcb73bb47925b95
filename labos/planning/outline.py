"""A simplified model of a workcell, for looking ahead often: modules, zones and places are numbers.

Steps take their usual times. A step takes its module, zones and the
modules that a hand reaches into while it lasts; labware takes room, and its deck, from the start of the step
that brings it to the end of the one that carries it away. A step starts as soon as it can, runs inside first,
if all of them can still reach their ends. Windows, doors and setpoints are left out. No rule of safety
depends on this model.
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
"""Orders of steps that are tried before a start counts as unsafe."""


class Task(msgspec.Struct, frozen=True, gc=False):
    """A step: what it takes while it lasts, what it takes room in from its start, and what is free again from
    its end, by their numbers; which steps come after it, and how many before."""

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
    """What takes room with a task and what is free after it, both at once (1); or take that back (-1)."""
    for key in task.gets:
        counts[key] += sign
    for key in task.frees:
        counts[key] -= sign


class Ways:
    """Plans in outline, and how much room there is: for one bench."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}
        self.names: list[str] = []
        self.room: list[int] = []
        self._plans: dict[str, tuple[Task, ...]] = {}

    def read(self, state: LabState, name: str) -> tuple[Task, ...]:
        """A plan that the state knows, in outline."""
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
    """Runs inside and some that wait, from now on. They are known by their numbers, the runs inside first;
    ``order`` are the starts: (time, run, step)."""

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
        self._see_strangers(state, {run_owner(run.id) for run in here}, ways)
        found = self._search()
        self.is_safe = found is not None
        self.witness = found or []

    def _add(
        self, state: LabState, run: RunState, way: tuple[Task, ...], flying: dict[tuple[RunId, int], Action]
    ) -> None:
        """Let a run take part, as far as it has come."""
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

    def _see_strangers(self, state: LabState, owners: set[Owner], ways: Ways) -> None:
        """Labware of nobody inside takes up room as well."""
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

    # -- going on ------------------------------------------------------------------------------

    def go_on(self, see: Callable[[Outline], None] | None = None) -> Outline:
        """Carry on until nothing can start any more; ``see`` is called whenever all has started that can."""
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
        """Whether nobody else has what a step takes."""
        task = self.ways[who][step]
        for key in task.takes:
            if self.busy[key]:
                return False
        for key in task.gets:  # noqa: SIM110  (asked too often for a generator)
            if self.used[key] >= self.room[key]:
                return False
        return True

    def find_in_the_way(self, who: int, step: int) -> Iterator[int]:
        """What a step takes that others have."""
        task = self.ways[who][step]
        yield from (key for key in task.takes if self.busy[key])
        yield from (key for key in task.gets if self.used[key] >= self.room[key])

    def list_held(self, who: int) -> set[int]:
        """What a run that was let in has since."""
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
        """Let a step begin; ``witness`` is an order in which all come to the end after it."""
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
        """Go on to the next end."""
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
        """How many runs have not come to their ends, and when all are over: less is better."""
        return sum(left > 0 for left in self.left), max(self.ends, default=0)

    # -- whether everybody comes to the end ------------------------------------------------------

    def find_witness(self, who: int, step: int) -> list[int] | None:
        """An order of motions, as numbers of runs, in which everybody inside comes to the end after this
        start; None if none is found."""
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
        """Whether an order of motions is possible."""
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
        """An order of motions that brings everybody inside to the end."""
        who = [number for number, inside in enumerate(self.inside) if inside and self.carrying[number]]
        tasks = [[self.ways[number][step] for step in self.carrying[number]] for number in who]
        search = _Search(tasks, self.floor, self.room)
        return [who[number] for number in search.order] if search.search() else None


class _Search:
    """Looks for an order of motions on a floor."""

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
        """Let one after the other go to its end, as long as one can; takes all back if somebody is left."""
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


__all__ = ["Outline", "Task", "Ways"]
