"""Small workcells, plans, and a driver that takes a LabState through commands.

The driver stands for kernel, nodes and people at once, without their machinery: it decides, folds,
and after every single event it asks what must always hold. What it has written can be folded again
from the start or from any picture in between (``check_log``).
"""

from __future__ import annotations

import copy
import random
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any, TypeVar

import msgspec

from labos.core.canonical import digest, encode_canonical
from labos.core.decide import Command, Rejection, carry_out, decide
from labos.core.decide.access import GrantAccess
from labos.core.decide.actions import (
    AcceptAction,
    DoubtAction,
    FinishAction,
    RefuseAction,
    StartStep,
)
from labos.core.decide.experiments import EndExperiment, StartExperiment
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell, CreateLab, DeclareStation, StartKernel
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import SubmitRun
from labos.core.effects import (
    AnyEffect,
    Claims,
    Consumes,
    Move,
    Needs,
    Releases,
    Relid,
    Requires,
    Sets,
    Take,
    Unlid,
)
from labos.core.fold import evolve
from labos.core.ids import ActionId, ExperimentId, InterventionId, LabId, ModuleName, RunId, StationName
from labos.core.interventions import Intervention
from labos.core.invariants import find_broken
from labos.core.model import Hold, ModuleSpec, Plan, PlanStep, StationKind, StationSpec, Workcell
from labos.core.registry import Event, decode, encode
from labos.core.resources import LevelSet
from labos.core.rules import examine
from labos.core.runs import RunState, find_results
from labos.core.state import LabState, encode_picture, from_picture
from labos.core.waits import Wait
from labos.planning.scheduler import Scheduler, StepStart, list_ready_steps
from labos.planning.touch import find_touched_keys

CELL = "cell"
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


# -- building -------------------------------------------------------------------------------------


def full(name: str) -> str:
    """A name in the one workcell of these tests; empty stays empty."""
    return f"{CELL}/{name}" if name and "/" not in name else name


def station(
    name: str, kind: StationKind = "nest", capacity: int = 1, *, claim: bool = False, **more: Any
) -> StationSpec:
    """A station; ``dev.nest`` belongs to the module ``dev``, a name without a dot to nobody."""
    module = name.partition(".")[0] if "." in name else ""
    return StationSpec(
        StationName(full(name)),
        kind,
        ModuleName(full(module)),
        capacity,
        claim=full(module) if claim else "",
        **more,
    )


def module(name: str, **more: Any) -> ModuleSpec:
    return ModuleSpec(ModuleName(full(name)), "driver", **more)


def workcell(modules: Iterable[ModuleSpec], stations: Iterable[StationSpec], name: str = CELL) -> Workcell:
    modules, stations = tuple(modules), tuple(stations)
    return Workcell(name, digest(encode_canonical([modules, stations])), modules, stations)


def move(source: str, target: str, via: str = "") -> Move:
    return Move(StationName(full(source)), StationName(full(target)), via=StationName(full(via)))


def unlid(source: str, nest: str) -> Unlid:
    return Unlid(StationName(full(source)), StationName(full(nest)))


def relid(nest: str, target: str) -> Relid:
    return Relid(StationName(full(nest)), StationName(full(target)))


def take(stack: str, target: str) -> Take:
    return Take(StationName(full(stack)), StationName(full(target)))


def needs(place: str = "") -> Needs:
    return Needs(StationName(full(place)))


def sets(variable: str, value: Any, of: str = "module") -> Sets:
    return Sets(of, variable, value)


def requires(variable: str, value: Any, of: str = "module") -> Requires:
    return Requires(of, variable, value)


def consumes(resource: str, amount: float) -> Consumes:
    return Consumes(resource, amount)


def claims(setpoint: str, value: Any) -> Claims:
    return Claims(setpoint, value)


def releases(setpoint: str) -> Releases:
    return Releases(setpoint)


def hold(on: str, first: int, last: int) -> Hold:
    return Hold(ModuleName(full(on)), first, last)


def step(on: str, *effects: AnyEffect, action: str = "act", **more: Any) -> PlanStep:
    """A step of module ``on``; its key is filled in by ``plan``."""
    return PlanStep(more.pop("key", ""), ModuleName(full(on)), action, effects=effects, **more)


def plan(*steps: PlanStep, name: str = "flow", parallel: bool = False, **more: Any) -> Plan:
    """A plan whose steps follow one another, unless they are ``parallel`` or say ``after``."""
    numbered = []
    for index, item in enumerate(steps):
        after = item.after or (() if parallel or not index else (index - 1,))
        numbered.append(msgspec.structs.replace(item, key=item.key or f"s{index}", after=after))
    return Plan(name, CELL, tuple(numbered), **more)


def route(*places: str, arm: str = "arm", name: str = "flow") -> Plan:
    """Labware goes from place to place; the first is a stack if its name says so."""
    steps = []
    for source, target in pairwise(places):
        effect = take(source, target) if source.startswith("stack") else move(source, target)
        steps.append(step(arm, effect, key=f"to {target}"))
    return plan(*steps, name=name)


Named = TypeVar("Named", Workcell, Plan)


def elsewhere(cell: str, what: Named) -> Named:
    """The same workcell, or a plan in it, under another name."""
    text = msgspec.json.encode(what).decode()
    for before, after in ((f'"{CELL}/', f'"{cell}/'), (f'"name":"{CELL}"', f'"name":"{cell}"')):
        text = text.replace(before, after)
    text = text.replace(f'"workcell":"{CELL}"', f'"workcell":"{cell}"')
    return msgspec.json.decode(text, type=type(what))


# -- driving --------------------------------------------------------------------------------------


class Entry(msgspec.Struct, frozen=True):
    """An event as it stands in the log."""

    event: Event
    position: int
    at: int
    stream: str
    version: int


class Refused(AssertionError):
    """A command that should have been accepted was rejected."""

    def __init__(self, rejection: Rejection) -> None:
        super().__init__(f"{rejection.code}: {rejection.message}")
        self.rejection = rejection


class Driver:
    """A lab state, its log, its clock; commands in, events out."""

    careful = True
    """Whether it is checked that deciding changes nothing (slow where much is queued)."""

    def __init__(self, cell: Workcell | None = None, *, pace: float = 1.0, empty: bool = True) -> None:
        self.state = LabState()
        self.log: list[Entry] = []
        self.pictures: dict[int, bytes] = {}
        self.now = START
        self.scheduler = Scheduler()
        self.keys: set[str] = set()
        self.rejected: list[tuple[Command, Rejection]] = []
        self._actions = 0
        if cell is not None:
            self.do(CreateLab(LabId("lab-1"), "test lab", pace))
            self.do(StartKernel(1, "0"))
            self.furnish(cell, empty=empty)

    def furnish(self, cell: Workcell, *, empty: bool = True) -> None:
        """Apply a workcell, let its nodes join and say that its stations are empty."""
        self.do(ApplyWorkcell(cell))
        for spec in cell.modules:
            self.join(spec.name)
        for place in cell.places if empty else ():
            self.do(DeclareStation(place.name))

    # -- commands ----------------------------------------------------------------------------

    def ask(self, command: Command, actor: str = "labos") -> list[Event] | Rejection:
        """Decide; fold what was decided and what follows from it, checking after every event."""
        before = encode_picture(self.state) if self.careful else b""
        if self.careful:
            decide(self.state, command, actor)
            assert encode_picture(self.state) == before, f"{command} changed the state by being decided"
        answer = carry_out(self.state, command, self.write, actor)
        if isinstance(answer, Rejection):
            assert not self.careful or encode_picture(self.state) == before, f"{command} was refused too late"
            assert answer.message.endswith("."), answer
            return answer
        for event in answer:
            self.keys.update(find_touched_keys(self.state, event))
        return answer

    def do(self, command: Command, actor: str = "labos") -> list[Event]:
        """A command that has to be accepted."""
        answer = self.ask(command, actor)
        if isinstance(answer, Rejection):
            raise Refused(answer)
        return answer

    def reject(self, command: Command, actor: str = "labos") -> Rejection:
        """A command that has to be rejected."""
        answer = self.ask(command, actor)
        assert isinstance(answer, Rejection), f"accepted: {answer}"
        return answer

    def write(self, event: Event) -> Event:
        """One event to the end of the log, with everything that must hold after it."""
        payload = encode(event)
        assert decode(event.TYPE, event.SCHEMA, payload) == event
        stream, position = event.stream(), self.state.position + 1
        version = self.state.versions.get(stream, 0) + 1
        evolve(self.state, event, position, self.now)
        self.log.append(Entry(event, position, self.now, stream, version))
        fault = find_broken(self.state) if self.careful else ""
        assert not fault, f"after {event}: {fault}"
        return event

    def join(self, name: str) -> None:
        self.do(JoinNode(ModuleName(full(name)), f"journal-{name}", "i1", "driver", "1", "about", "IDLE"))

    def stock(self, name: str, count: int, labware: str = "plate") -> None:
        """Fill a stack, or put labware of nobody in particular at a station."""
        self.do(DeclareStation(StationName(full(name)), (labware,) * count))

    def level(self, name: str, resource: str, amount: float, capacity: float = 100.0) -> None:
        self.set_level(LevelSet(ModuleName(full(name)), resource, amount, capacity))

    def set_level(self, event: LevelSet) -> None:
        """Somebody counted what is left."""
        self.write(event)
        self.keys.update(find_touched_keys(self.state, event))

    def submit(self, what: Plan, user: str = "ada", **more: Any) -> RunId:
        self.do(SubmitRun(what, user, **more))
        return RunId(f"R{self.state.runs.named}")

    def experiment(self, name: str = "app", user: str = "ada", **more: Any) -> ExperimentId:
        self.do(StartExperiment(name, user, **more))
        return ExperimentId(f"E{self.state.experiments.named}")

    def end(self, experiment: str) -> list[Event]:
        return self.do(EndExperiment(ExperimentId(experiment)))

    def start_command(self, run: str, index: int, plan: str = "") -> StartStep:
        return StartStep(RunId(run), index, ActionId(f"A{self._actions + 1}"), self.now, plan)

    def start(self, run: str, index: int = 0) -> ActionId:
        """Start a step, whatever planning thinks of it."""
        command = self.start_command(run, index)
        self.do(command)
        self._actions += 1
        return command.action

    def accept(self, action: str) -> list[Event]:
        return self.do(AcceptAction(ActionId(action), self._attempt(action), self.now))

    def finish(self, action: str, result: Any = None) -> list[Event]:
        return self.do(FinishAction(ActionId(action), self._attempt(action), True, "all", result))

    def fail(
        self, action: str, effects: str = "unknown", error: str = "jam", *, collided: bool = False
    ) -> list[Event]:
        attempt = self._attempt(action)
        end = FinishAction(ActionId(action), attempt, False, effects, error=error, collided=collided)  # type: ignore[arg-type]
        return self.do(end)

    def refuse(self, action: str, *, final: bool = True) -> list[Event]:
        return self.do(RefuseAction(ActionId(action), self._attempt(action), "no", final))

    def doubt(self, action: str, why: str = "silence") -> list[Event]:
        return self.do(DoubtAction(ActionId(action), why))

    def answer(self, question: Intervention, choice: str) -> list[Event]:
        return self.do(ResolveIntervention(InterventionId(question.id), choice, "person-1"))

    def step(self, run: str, index: int = 0, result: Any = None) -> list[Event]:
        """Start a step and let it succeed."""
        return self.finish(self.start(run, index), result)

    def wait(self, seconds: float) -> None:
        self.now += int(seconds * SECOND)

    def _attempt(self, action: str) -> int:
        found = self.state.actions.open.get(ActionId(action))
        return found.attempt if found is not None else 1

    # -- questions ---------------------------------------------------------------------------

    def run(self, name: str) -> RunState:
        found = self.state.runs.get(name)
        assert found is not None, f"{name} has ended"
        return found

    def results(self, name: str) -> dict[int, Any]:
        """What later steps of a run read, by step."""
        run = self.run(name)
        return find_results(self.state.runs.plan_of(run), run)

    def check_start(self, run: str, index: int = 0) -> Wait | tuple[AnyEffect, ...]:
        """What the rules say about a step."""
        return examine(self.state, self.run(run), index, self.now)

    def code(self, run: str, index: int = 0) -> str:
        """The code of what a step waits for; empty if the rules allow it."""
        found = self.check_start(run, index)
        return found.code if isinstance(found, Wait) else ""

    def questions(self, kind: str = "") -> list[Intervention]:
        return [i for i in self.state.interventions.open.values() if not kind or i.kind == kind]

    def question(self, kind: str = "") -> Intervention:
        found = self.questions(kind)
        assert len(found) == 1, found
        return found[0]

    def question_of(self, name: str) -> Intervention:
        return self.state.interventions.open[InterventionId(name)]

    def where(self, labware: str) -> str:
        return self.state.bench.labware[labware].station.removeprefix(f"{CELL}/")  # type: ignore[index]

    def at(self, name: str) -> list[str]:
        return list(self.state.bench.stations[StationName(full(name))].labware)

    def owner(self, labware: str) -> str:
        return self.state.bench.labware[labware].owner  # type: ignore[index]

    def types(self) -> list[str]:
        return [entry.event.TYPE for entry in self.log]

    # -- planning, as the kernel does it -------------------------------------------------------

    def pump(self, limit: int = 10_000) -> list[str]:
        """Start what planning proposes until it proposes nothing more; returns ``run#step``."""
        started: list[str] = []
        while True:
            keys, self.keys = self.keys, set()
            before = len(self.log)
            self.scheduler.note_changes(self.state, keys)
            for command in self.scheduler.iterate_due(self.state, self.now):
                self.do(command)
            for start in self.scheduler.iterate_proposals(self.state, self.now):
                self._begin(start)
                started += [f"{run}#{step}" for run, step in ((start.run, start.step), *start.others)]
                assert len(started) < limit, "planning proposes without end"
            for cell in list(self.state.lab.access) if len(self.log) == before else ():
                self.do(GrantAccess(cell))
            if len(self.log) == before:
                return started

    def pump_by_rule(self) -> None:
        """The paper's rule: start whatever the bench allows, in order of age, with no thought of
        what comes after."""
        again = True
        while again:
            again = False
            for run in [*self.state.runs.active.values(), *self.state.runs.queued.values()]:
                steps = (
                    list_ready_steps(self.state, run)
                    if run.has_started
                    else self.state.runs.plans[run.plan].starts
                )
                for index in steps:
                    if not isinstance(examine(self.state, run, index, self.now), Wait):
                        self._carry_out(run.id, index)
                        again = True
                        break

    def _begin(self, start: StepStart) -> None:
        command = start.make_command(self._name_action, self.now)
        answer = self.ask(command)
        if isinstance(answer, Rejection):
            self.rejected.append((command, answer))
            raise Refused(answer)

    def _name_action(self) -> ActionId:
        self._actions += 1
        return ActionId(f"A{self._actions}")

    def _carry_out(self, run: RunId, index: int, plan: str = "") -> None:
        command = self.start_command(run, index, plan)
        answer = self.ask(command)
        if isinstance(answer, Rejection):
            self.rejected.append((command, answer))
            raise Refused(answer)
        self._actions += 1

    def list_flying(self) -> list[ActionId]:
        return [a.id for a in self.state.actions.open.values() if a.status != "unknown"]

    def work(
        self,
        rng: random.Random,
        pump: Callable[[], Any] | None = None,
        *,
        limit: int = 5_000,
        end: Callable[[random.Random, ActionId], Any] | None = None,
    ) -> bool:
        """Plan and let actions end in random order until nothing moves; True if no run is left."""
        pump, end = pump or self.pump, end or (lambda _, action: self.finish(action))
        pump()
        for _ in range(limit):
            flying = self.list_flying()
            if not flying:
                break
            self.wait(rng.uniform(0.1, 5))
            end(rng, rng.choice(flying))
            pump()
        else:
            raise AssertionError("the lab does not come to rest")
        return not self.state.runs.active and not self.state.runs.queued

    def find_missed(self) -> list[str]:
        """What a scheduler that looks at everything would start now, though nothing was proposed:
        a start that nobody was woken for. Whom it has overtaken, how it means to keep windows, and its own
        order are all that it is told."""
        fresh = Scheduler()
        fresh.room._overtakings = copy.deepcopy(self.scheduler.room._overtakings)
        fresh.patience = copy.deepcopy(self.scheduler.patience)
        fresh.reservations.windows.remember(self.scheduler.reservations.windows)
        fresh.adviser.own = copy.deepcopy(self.scheduler.adviser.own)
        fresh.window_orders.remember(self.scheduler.window_orders)
        start = next(iter(fresh.iterate_proposals(self.state, self.now)), None)
        return [] if start is None else [f"{start.run}#{start.step}"]

    def describe_stuck(self) -> str:
        """Why the runs that are left do not go on."""
        lines = []
        for run in [*self.state.runs.active.values(), *self.state.runs.queued.values()]:
            lines += [
                f"{run.id}#{i} {w.code} {w.names}"
                for i, w in Scheduler().list_waits(self.state, run, self.now)
            ]
        return "; ".join(lines) or "nothing waits"

    # -- the log ---------------------------------------------------------------------------------

    def keep_picture(self) -> None:
        self.pictures[self.state.position] = encode_picture(self.state)

    def check_log(self) -> None:
        """The log folds to the same state from its start and from every picture kept, in the same
        order of everything; its streams are sound."""
        assert order(self.state) == order(refold(self.log)), "the fold does not repeat itself"
        for position, data in self.pictures.items():
            state = refold(self.log[position:], from_picture(data))
            assert order(state) == order(self.state), f"the picture at {position} leads elsewhere"
        assert not stream_faults(self.log)


def refold(log: Iterable[Entry], state: LabState | None = None) -> LabState:
    """The state that a log leads to."""
    state = state or LabState()
    for entry in log:
        evolve(state, entry.event, entry.position, entry.at)
    return state


def order(state: LabState) -> bytes:
    """A state as bytes that also show the order in which its tables are walked through."""
    return msgspec.json.encode(state)


def stream_faults(log: Iterable[Entry]) -> list[str]:
    """Where (stream, version) is not unique, or versions of a stream have gaps."""
    seen: Counter[str] = Counter()
    faults = []
    for entry in log:
        seen[entry.stream] += 1
        if entry.version != seen[entry.stream]:
            faults.append(
                f"{entry.position} {entry.event.TYPE}: {entry.stream} has {seen[entry.stream]} events, "
                f"this one calls itself version {entry.version}"
            )
    return faults


# -- a small lab ------------------------------------------------------------------------------------


def small_cell(**more: Any) -> Workcell:
    """Two arms; ``dev`` with a lid and a deck of two claimed slots; nests, a hotel, stack, waste."""
    modules = [
        module("arm"),
        module("arm2"),
        module("dev", variables={"lid": "open"}, rest={"lid": "open"}, levels={"tips": 10.0}),
        module("cam"),
    ]
    stations = [
        station("stack", "stack", 9),
        station("a"),
        station("b"),
        station("c"),
        station("hotel", "hotel", 3),
        station("trash", "waste", 4),
        station("dev.n1", "deck", claim=True, access={"lid": "open"}),
        station("dev.n2", "deck", claim=True, access={"lid": "open"}),
        station("cam.nest", accepts=("plate",)),
    ]
    return workcell(more.get("modules", modules), more.get("stations", stations))


def small(stock: int = 5) -> Driver:
    """A driver of the small cell with plates in the stack."""
    driver = Driver(small_cell())
    if stock:
        driver.stock("stack", stock)
    return driver
