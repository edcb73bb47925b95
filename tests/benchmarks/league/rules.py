"""What a step takes from others, read from plans and workcell alone: for the checker, and for whoever looks
for the best schedule. Nothing of planning is used here.

A step takes its module (if it is exclusive), the modules into whose places a hand reaches, and the place
where it changes its grip. Labware takes room at a place from the start of the step that brings it to the end
of the step that carries it away, and so it takes the deck (``claim``) to which the place belongs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from labos.core.effects import list_carried
from labos.core.model import MAIN, PlanStep, StationSpec, Workcell
from tests.benchmarks.league.play import Work


class Clock(msgspec.Struct, frozen=True):
    """A task starts at least and at most so long after another has ended."""

    anchor: int
    wait_s: float
    within_s: float | None


class Task(msgspec.Struct, frozen=True):
    """A step of one run of one work. ``takes`` are names of what one task at a time may have; ``after`` are
    numbers of tasks that have to end before."""

    work: int
    run: int
    step: int
    duration_s: float
    takes: frozenset[str]
    after: tuple[int, ...]
    clocks: tuple[Clock, ...]


class Stay(msgspec.Struct, frozen=True):
    """Labware takes room at ``place`` from the start of task ``first`` to the end of task ``last``; for good
    if there is none."""

    work: int
    place: str
    first: int
    last: int | None


class Alone(msgspec.Struct, frozen=True):
    """Of the works whose runs leave labware at ``place`` for their next run, one at a time has such runs,
    from the start of task ``first`` to the end of ``last``. Whoever is let in must be able to come to the end
    whatever is submitted later: two that end at this place could not, as no run that is known carries
    anything away."""

    place: str
    first: int
    last: int


class Problem(msgspec.Struct, frozen=True):
    """All tasks, numbered in the order of the works, their runs and steps; how many have room where; and
    which works do not go together."""

    tasks: tuple[Task, ...]
    stays: tuple[Stay, ...]
    room: dict[str, int]
    alone: tuple[Alone, ...] = ()


def problem_of(cell: Workcell, works: Sequence[Work]) -> Problem:
    reader = _Reader(cell)
    for number, work in enumerate(works):
        reader.read(number, work)
    tasks, stays = tuple(reader.tasks), tuple(reader.stays)
    return Problem(tasks, stays, reader.room, tuple(_alone(tasks, stays, reader.room)))


def _alone(tasks: tuple[Task, ...], stays: tuple[Stay, ...], room: dict[str, int]) -> Iterator[Alone]:
    found: dict[tuple[str, int], Alone] = {}
    for stay in stays:
        left = stay.last is not None and tasks[stay.last].run != tasks[stay.first].run
        if left and room[stay.place] == 1:
            before = found.get((stay.place, stay.work))
            first = before.first if before is not None else _first_of_run(tasks, stay.first)
            last = max(n for n, task in enumerate(tasks) if _of(task) == _of(tasks[stay.first]))
            found[stay.place, stay.work] = Alone(stay.place, first, last)
    yield from found.values()


def _first_of_run(tasks: tuple[Task, ...], number: int) -> int:
    return min(n for n, task in enumerate(tasks) if _of(task) == _of(tasks[number]))


def _of(task: Task) -> tuple[int, int]:
    return task.work, task.run


class _Reader:
    def __init__(self, cell: Workcell) -> None:
        self.stations: dict[str, StationSpec] = {station.name: station for station in cell.stations}
        self.tasks: list[Task] = []
        self.stays: list[Stay] = []
        self.room: dict[str, int] = {
            s.name: s.capacity for s in cell.places if s.kind not in ("stack", "waste")
        }
        for spec in cell.stations:
            shelves = [s for s in cell.stations if s.hotel == spec.name]
            if shelves:
                self.room[spec.name] = sum(s.capacity for s in shelves)
            if spec.claim:
                self.room[f"deck of {spec.claim}"] = 1
        self._open: dict[str, int] = {}

    def read(self, number: int, work: Work) -> None:
        last_of_run: tuple[int, ...] = ()
        self._open = {}
        for run, submitted in enumerate(work.runs):
            base = len(self.tasks)
            steps = [s for s in submitted.plan.steps if s.part == MAIN]
            for index, step in enumerate(steps):
                after = tuple(base + before for before in step.after) or last_of_run
                clocks = tuple(
                    Clock(base + w.anchor, w.wait_s, w.within_s) for w in step.windows if w.anchor is not None
                )
                takes = frozenset(self._takes(step))
                self.tasks.append(Task(number, run, index, step.duration_s, takes, after, clocks))
                self._carry(number, base + index, step)
            last_of_run = tuple(range(base, len(self.tasks)))
        for place, first in self._open.items():
            self.stays.append(Stay(number, place, first, None))

    def _takes(self, step: PlanStep) -> Iterator[str]:
        if step.exclusive:
            yield step.module
        for what in list_carried(step.effects):
            if what.via:
                yield what.via
            for place in what.entered:
                spec = self.stations[place]
                if spec.module and not spec.stands_apart:
                    yield spec.module

    def _carry(self, number: int, task: int, step: PlanStep) -> None:
        for what in list_carried(step.effects):
            for place in self._list_counted(what.emptied):
                if place in self._open:
                    self.stays.append(Stay(number, place, self._open.pop(place), task))
            for place in self._list_counted(what.filled):
                self._open[place] = task

    def _list_counted(self, place: str) -> list[str]:
        spec = self.stations.get(place)
        if spec is None or spec.kind in ("stack", "waste"):
            return []
        return [place, f"deck of {spec.claim}"] if spec.claim else [place]
