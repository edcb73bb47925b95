"""How many copies of a workflow may be in progress at once, found by trying it on an otherwise empty bench.

The decisions and the safety check are those of the lab, but there are no nodes and no waiting: every action
succeeds at once. A new copy starts whenever one may. If none may, the copy that is furthest continues by one
step; no copy may end. Where a copy needs labware at its start, the station is filled with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from labos.core import reasons
from labos.core.decide import LABOS, Command, Rejection, carry_out
from labos.core.decide.actions import FinishAction, StartStep
from labos.core.decide.lab import ApplyWorkcell, CreateLab, DeclareStation, StartKernel
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import SubmitRun
from labos.core.fold import evolve
from labos.core.ids import ActionId, LabId, LabwareId, RunId, StationName, user_owner
from labos.core.labware import LabwareHandedOver
from labos.core.model import Plan, Workcell
from labos.core.registry import Event
from labos.core.runs import SETTLED, RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.errors import Refused
from labos.planning.choosing import sort_options
from labos.planning.scheduler import Scheduler, list_ready_steps

CAP = 32
USER = "somebody"
DAY_NS = 24 * 3600 * 1_000_000_000
"""The clock jumps by a day at each step, so that no waiting time delays a step."""

Stock = Iterable[tuple[StationName, str, int]]


class Capacity(msgspec.Struct, frozen=True):
    """``copies`` may be in progress at once (``capped``: perhaps more). ``why`` says in a sentence why there
    cannot be one more: what the next copy and those in progress wait for."""

    copies: int
    capped: bool = False
    why: str = ""


def measure_capacity(
    workcell: Workcell,
    stock: Stock,
    plan: Plan,
    inputs: tuple[StationName, ...] = (),
    *,
    others: Sequence[Plan] = (),
) -> Capacity:
    """Start copies of a plan one by one until one is refused. ``stock`` is (station, labware type, count);
    ``inputs`` are the stations where a run's labware must stand at its start; ``others`` are plans that a
    copy may follow in place of ``plan``. Raises Refused if the workcell cannot be set up in this way."""
    plan, *others = map(_approve, (plan, *others))
    bench = _PaperBench()
    bench.furnish(workcell, stock, inputs)
    for _ in range(CAP):
        bench.do(SubmitRun(plan, USER, others=tuple(others)))
    # Every turn starts a step, so the loop ends with the steps of all copies.
    why = ""
    while len(bench.state.runs.active) < CAP:
        wait = bench.start_oldest()
        if wait is None:
            continue
        why = wait.reason.sentence
        if wait.blocked or not bench.go_on():
            break
    copies = len(bench.state.runs.active)
    return Capacity(copies, copies >= CAP, "" if copies >= CAP else why)


def _approve(plan: Plan) -> Plan:
    return msgspec.structs.replace(
        plan, steps=tuple(msgspec.structs.replace(step, dangerous="") for step in plan.steps)
    )


class _PaperBench:
    """A simulated lab: a state, a scheduler and a clock that jumps."""

    def __init__(self) -> None:
        self.state, self.scheduler = LabState(), Scheduler()
        self.now = DAY_NS
        self._actions = 0

    def do(self, command: Command) -> None:
        """Carry out a command. Raises Refused."""
        answer = carry_out(self.state, command, self._fold, LABOS)
        if isinstance(answer, Rejection):
            raise Refused(answer.message, remedy=answer.remedy)

    def _fold(self, event: Event) -> Event:
        evolve(self.state, event, self.state.position + 1, self.now)
        return event

    def furnish(self, workcell: Workcell, stock: Stock, inputs: tuple[StationName, ...]) -> None:
        """Set up the lab: nodes idle, stock in place, inputs at their stations, all other stations empty."""
        self.do(CreateLab(LabId("paper"), "paper"))
        self.do(StartKernel(1, "paper"))
        self.do(ApplyWorkcell(workcell))
        for module in workcell.modules:
            self.do(JoinNode(module.name, "j", "i", module.driver, "1", "", "IDLE", simulated=True))
        contents: dict[StationName, list[str]] = {station.name: [] for station in workcell.places}
        for station, kind, count in stock:
            contents[station] += [kind] * count
        accepts = {station.name: station.accepts for station in workcell.stations}
        room = {s.name: s.capacity if s.is_storage else 1 for s in workcell.stations}
        shelves = self.state.bench.shelves
        for station in {place for name in inputs for place in shelves.get(name, [name])}:
            kind = (contents[station] or accepts[station] or ("plate",))[0]
            contents[station] += [kind] * (room[station] - len(contents[station]))
        for station, kinds in contents.items():
            self.do(DeclareStation(station, tuple(kinds)))
        for name in list(self.state.bench.labware):
            self._fold(LabwareHandedOver(LabwareId(name), "", user_owner(USER)))

    def start_oldest(self) -> Wait | None:
        """Start the oldest waiting copy; returns the reason to wait if it cannot start."""
        run = next(iter(self.state.runs.queued.values()))
        found = Wait(reasons.Gone())
        for option in sort_options(self.state, run, self.now):
            for step in self.state.runs.plans[option.plan].starts:
                wait = self.scheduler.check_start(self.state, option, step, self.now)
                if wait is None:
                    self._carry_out(option, step)
                    return None
                found = wait
        return found

    def go_on(self) -> bool:
        """Carry out one step of the copy that is furthest and may continue; False if none may."""
        runs = sorted(self.state.runs.active.values(), key=lambda run: -_count_over(run))
        for run in runs:
            if _count_over(run) + 1 == len(run.steps):
                continue
            for step in list_ready_steps(self.state, run):
                if self.scheduler.check_start(self.state, run, step, self.now) is None:
                    self._carry_out(run, step)
                    return True
        return False

    def _carry_out(self, run: RunState, step: int) -> None:
        self.now += DAY_NS
        self._actions += 1
        action = ActionId(f"a{self._actions}")
        plan = self.state.runs.plan_of(run)
        self.do(StartStep(RunId(run.id), step, action, self.now, run.plan))
        run = self.state.runs.active[run.id]
        if _count_over(run) + 1 < len(run.steps):
            self.do(FinishAction(action, 1, True, "all", _imagine_result(plan, step)))


def _count_over(run: RunState) -> int:
    """The number of its steps for which nothing waits any more."""
    return sum(step.status in SETTLED for step in run.steps)


def _imagine_result(plan: Plan, step: int) -> Any:
    """A result with a value in each place from which later steps read one."""
    result: dict[str, Any] = {}
    for later in plan.steps:
        for value in later.args.values():
            if isinstance(value, dict) and "$result" in value and value["$result"][0] == step:
                here = result
                path = value["$result"][1:]
                for part in path[:-1]:
                    here = here.setdefault(part, {})
                if path:
                    here.setdefault(path[-1], 1)
    return result
