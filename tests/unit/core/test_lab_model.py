"""The lab against a model of a few dictionaries, by random sequences of what people, nodes and planning do.

Nodes and people are honest here, though they may know little: whatever they say of a plate is true, or leaves
open what is true. Then what the log holds possible must never exclude where a plate really is, must never
be more than what was told leaves open, and nothing may start that would put a plate onto another one. What
must always hold is checked after every event, by the test kit itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from labos.core.actions import ActionReconciled
from labos.core.decide import Command, Rejection
from labos.core.decide.actions import AcceptAction, FinishAction, RefuseAction
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import PauseStarts, ResumeStarts
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.nodes import PutBack, ReportState, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.effects import Move, Needs, Take
from labos.core.ids import ActionId, InterventionId, LabwareId, ModuleName, RunId, StationName, local
from labos.core.interventions import Intervention
from labos.core.model import Plan
from labos.core.registry import Event
from labos.core.runs import StepStatus
from tests.support.bench import Driver, full, module, move, needs, plan, station, step, take, workcell
from tests.unit.core.bench_of_dicts import (
    ARMS,
    CAPACITY,
    CELL,
    MODULES,
    STACK,
    STORAGE,
    TRASH,
    DictBench,
    Flight,
    Outcome,
    Run,
    Step,
)

STOCK = 4
NESTS = ("a", "b", "c", "cam.nest", "hotel")
WHERE = st.sampled_from(["target", "source", "hand", "via"])
WORDS = st.sampled_from(["plain", "vague", "odd"])
HOPS = st.lists(
    st.tuples(st.sampled_from(ARMS), st.sampled_from([*NESTS, TRASH]), st.booleans()), min_size=1, max_size=3
)


def steps_of(start: str, hops: Sequence[tuple[str, str, bool]], *, look: bool) -> tuple[Step, ...]:
    """One plate's way, worked on wherever it comes to the camera; perhaps a look beside it."""
    steps: list[Step] = []
    here = start
    for arm, target, by_c in hops:
        if target == here or here == TRASH or (here, target) == (STACK, TRASH):
            continue
        via = "c" if by_c and here != STACK and "c" not in (here, target) else ""
        steps.append(Step("take" if here == STACK else "move", arm, here, target, via))
        if target == "cam.nest":
            steps.append(Step("work", "cam", target))
        here = target
    steps = [what._replace(after=(index - 1,) if index else ()) for index, what in enumerate(steps)]
    return (*steps, Step("look", "cam")) if look or not steps else tuple(steps)


PLANS = st.builds(steps_of, st.sampled_from([STACK, *NESTS]), HOPS, look=st.booleans())


def compile_plan(steps: Sequence[Step]) -> Plan:
    effects: dict[str, Any] = {
        "take": lambda s: (take(s.source, s.target),),
        "move": lambda s: (move(s.source, s.target, s.via),),
        "work": lambda s: (needs(s.source),),
        "look": lambda s: (),
    }
    return plan(*(step(s.module, *effects[s.do](s), after=s.after) for s in steps), parallel=True)


def new_lab() -> Driver:
    kinds: dict[str, Any] = {"hotel": "hotel", "arm.gripper": "gripper"}
    places = [station(name, kinds.get(name, "nest"), size) for name, size in CAPACITY.items()]
    places += [station(STACK, "stack", 9), station(TRASH, "waste", 100)]
    lab = Driver(workcell([module(name) for name in MODULES], places))
    lab.stock(STACK, STOCK)
    return lab


Rule = Callable[..., None]
T = TypeVar("T")


def pick_from(choices: Sequence[T], number: int) -> T:
    return choices[number % len(choices)]


def happens(**drawn: Any) -> Callable[[Rule], Any]:
    """A rule, after which some things go well: whichever rules an example does without, it gets somewhere.
    ``pick`` says which of the runs, plates or questions that there are by then is meant."""

    def decorate(method: Rule) -> Any:
        def happen(self: Lab, pick: int, then: int, **values: Any) -> None:
            method(self, pick, **values)
            self.the_lab_is_as_the_model()
            self.go_on(pick, then)

        happen.__name__ = method.__name__
        return rule(pick=st.integers(0, 5), then=st.integers(0, 4), **drawn)(happen)

    return decorate


class Lab(RuleBasedStateMachine):
    """Everybody around the kernel, and beside it what is really so."""

    def __init__(self) -> None:
        super().__init__()
        self.lab = new_lab()
        self.model = DictBench(STOCK)
        self.seen = len(self.lab.log)
        self.looked = False
        self.settled: list[str] = []

    def teardown(self) -> None:
        self.lab.check_log()

    def do(self, command: Command) -> list[Event]:
        """A command that has to be accepted. What the lab settles by it has to be true."""
        events = self.lab.do(command)
        for event in events:
            if isinstance(event, ActionReconciled):
                self.reconcile(event)
        return events

    # -- runs ----------------------------------------------------------------------------------

    @initialize(plans=st.lists(PLANS, min_size=2, max_size=3))
    def begin(self, plans: list[tuple[Step, ...]]) -> None:
        for steps in plans:
            self.submit("ada", steps)

    @precondition(lambda self: sum(not run.over for run in self.model.runs.values()) < 4)
    @happens(user=st.sampled_from(["ada", "bo"]), steps=PLANS)
    def submit_another(self, pick: int, user: str, steps: tuple[Step, ...]) -> None:
        self.submit(user, steps)

    def submit(self, user: str, steps: tuple[Step, ...]) -> None:
        run = self.lab.submit(compile_plan(steps), user)
        self.model.runs[run] = Run(user, steps)

    def startable(self) -> list[tuple[str, int]]:
        alive = {name: run for name, run in self.model.runs.items() if not run.over}
        return [(name, i) for name, run in alive.items() for i, s in enumerate(run.steps) if s == "pending"]

    @precondition(lambda self: self.startable())
    @happens()
    def start_anything(self, pick: int) -> None:
        """Planning would not ask for it; the rules of the bench have to hold by themselves."""
        self.start(*pick_from(self.startable(), pick))

    def free_to_start(self) -> list[tuple[str, int]]:
        return [(run, index) for run, index in self.startable() if self.model.may_start(run, index)]

    def to_go_on_with(self) -> list[tuple[str, int] | str]:
        return [*(a for a, f in self.model.flying.items() if not f.unknown), *self.free_to_start()]

    def go_on(self, pick: int, times: int) -> None:
        """So many things go well. If nothing can, somebody lets go on what is paused."""
        for number in range(times):
            choices = self.to_go_on_with()
            if not choices:
                self.let_all_go_on()
                return
            chosen = pick_from(choices, pick + number)
            if isinstance(chosen, str):
                self.finish(chosen, self.model.flying[chosen], "target", "plain")
            else:
                assert self.start(*chosen)
            self.the_lab_is_as_the_model()

    def start(self, run: str, index: int) -> bool:
        command = self.lab.start_command(run, index)
        answer = self.lab.ask(command)
        if isinstance(answer, Rejection):
            assert not self.model.may_start(run, index), answer
            return False
        self.lab._actions += 1
        effects = self.lab.state.actions.open[command.action].effects
        plate = next((e.labware for e in effects if isinstance(e, Move | Take | Needs)), "")
        assert not self.model.find_reason(run, index)
        assert not self.model.crash(run, self.model.runs[run].plan[index], plate)
        self.model.start(command.action, run, index, plate)
        return True

    @happens(what=st.sampled_from(["cancel", "pause_or_resume"]))
    def control(self, pick: int, what: str) -> None:
        """Of those that have ended, the first stands for all: of these nothing may be wanted any more."""
        over = [name for name, run in self.model.runs.items() if run.over]
        alive = [name for name in self.model.runs if name not in over]
        busy = [name for name in alive if self.model.runs[name].busy]
        getattr(self, what)(pick_from([*busy, *alive, *over[:1]], pick))

    def cancel(self, run: str) -> None:
        if self.model.runs[run].over:
            self.lab.reject(CancelRun(RunId(run)))
            return
        self.do(CancelRun(RunId(run)))
        self.model.cancel(run)

    def pause_or_resume(self, run: str) -> None:
        paused = self.model.runs[run].paused
        command = (ResumeRun if paused else PauseRun)(RunId(run))
        if self.model.runs[run].over:
            self.lab.reject(command)
            return
        self.do(command)
        self.model.runs[run].paused = not paused

    @happens(what=st.sampled_from([*MODULES, CELL, "*"]), out=st.booleans())
    def hinder_or_let_go_on(self, pick: int, what: str, out: bool) -> None:
        """One thing at a time, so that something is left that goes on."""
        if self.model.is_hindered:
            self.let_all_go_on()
            return
        name = full(what) if what in MODULES else what
        out = out and what in MODULES
        self.do(TakeOut(ModuleName(name), "belt") if out else PauseStarts(name, "ada"))
        (self.model.away.add if out else self.model.halted.add)(what if out else name)

    def let_all_go_on(self) -> None:
        model = self.model
        for name in model.halted:
            self.do(ResumeStarts(name, "ada"))
        for name in model.away:
            self.do(PutBack(ModuleName(full(name))))
        for name in model.unready:
            self.do(ReportState(ModuleName(full(name)), "IDLE"))
        for names in (model.halted, model.away, model.unready):
            names.clear()
        for name, run in model.runs.items():
            if run.paused and not run.over:
                self.pause_or_resume(name)
        self.lab.keep_picture()

    # -- nodes ---------------------------------------------------------------------------------

    def a_flight(self, pick: int, *, silent: bool | None = None) -> tuple[str, Flight] | None:
        """Something in flight; if there is nothing, something begins that may."""

        def list_flying() -> list[tuple[str, Flight]]:
            return [(a, f) for a, f in self.model.flying.items() if silent in (None, f.unknown)]

        if not list_flying() and self.free_to_start():
            self.start(*pick_from(self.free_to_start(), pick))
            self.the_lab_is_as_the_model()
        return pick_from(list_flying(), pick) if list_flying() else None

    def come_to(self, flight: Flight, where: str) -> str:
        """The arm carries its plate so far and no further, if it was not silent before."""
        if flight.step.carries and not flight.left:
            ends = {"target": flight.step.target, "source": flight.step.source, "hand": flight.step.hand}
            self.model.carry(
                flight.step, flight.plate, ends.get(where) or flight.step.via or flight.step.hand
            )
        return self.model.find_left(flight)

    @happens(where=WHERE, words=WORDS)
    def end_somehow(self, pick: int, where: str, words: str) -> None:
        flight = self.a_flight(pick)
        if flight is not None:
            self.finish(*flight, where, words)

    def finish(self, action: str, flight: Flight, where: str, words: str) -> None:
        """The node says how its action ended: what is true, or that it does not know."""
        at, what = self.come_to(flight, where), flight.step
        effects: Any = "partial"
        if not what.carries:
            effects = {"plain": "all", "odd": "none"}.get(words, "unknown")
        elif words != "vague" and at in (what.source, what.target):
            effects = "all" if at == what.target else "none"
        succeeded = effects == "all" and words == "plain"
        self.do(FinishAction(ActionId(action), 1, succeeded, effects, error="" if succeeded else "jam"))
        self.carry_out(flight, effects)
        self.model.end(action, "done" if succeeded else "failed")
        self.settled.append(action)

    def carry_out(self, flight: Flight, effects: str) -> None:
        """What is told of a plate by what is told of an action."""
        what, plate = flight.step, flight.plate
        if not what.carries:
            return
        if effects == "all":
            self.model.tell(plate, what.target, owner=f"run:{flight.run}")
        elif what.do == "take":
            if effects != "none":
                self.model.lost[plate] = what
        elif effects == "none":
            self.model.tell(plate, what.source)
        elif self.model.find_place(plate) in ("", *what.places):  # else it was seen elsewhere meanwhile
            self.model.tell(plate, *what.places)

    @happens(where=WHERE)
    def fall_silent(self, pick: int, where: str) -> None:
        found = self.a_flight(pick, silent=False)
        if found is None:
            return
        action, flight = found
        self.come_to(flight, where)
        self.lab.doubt(action)
        flight.unknown, flight.left = True, True
        self.model.runs[flight.run].steps[flight.index] = "unknown"
        if flight.step.do == "move":
            self.model.tell(flight.plate, *flight.step.places)

    @happens(final=st.none() | st.booleans())
    def accept_or_refuse(self, pick: int, final: bool | None) -> None:
        found = self.a_flight(pick, silent=None if final is None else False)
        if found is None:
            return
        action, flight = found
        if final is None:
            self.do(AcceptAction(ActionId(action), 1, self.lab.now))
            flight.unknown = False
            self.model.runs[flight.run].steps[flight.index] = "flying"
            return
        if flight.left:
            return  # it has said that it began
        self.do(RefuseAction(ActionId(action), 1, "no", final))
        self.model.end(action, "failed" if final else "pending")
        if not final:
            self.model.unready.add(flight.step.module)

    @precondition(lambda self: self.settled)
    @happens(effects=st.sampled_from(["all", "none", "partial"]))
    def speak_late(self, pick: int, effects: Any) -> None:
        """What a node says of an action that has ended changes nothing; it may be asked about."""
        action = ActionId(pick_from(self.settled, pick))
        self.do(FinishAction(action, 1, effects == "all", effects, error="late"))

    # -- people --------------------------------------------------------------------------------

    def put(self, what: Step, plate: str, place: str) -> bool:
        """A person carries a plate where the answer says that it stands, if there is room."""
        if place and place != STACK and not self.model.room(place, beside=plate):
            return False
        self.model.carry(what, plate, place)
        return True

    def reconcile(self, event: ActionReconciled) -> None:
        flight = self.model.flying[event.action]
        at, what = self.model.find_left(flight), flight.step
        outcome: Outcome = (
            "done" if event.effects == "all" else "pending" if event.effects == "none" else "failed"
        )
        if what.carries and outcome == "failed":
            self.model.tell(flight.plate)
        elif what.carries:
            assert at == (what.target if outcome == "done" else what.source), f"{flight.plate} is at {at}"
            self.carry_out(flight, event.effects)
        self.model.end(event.action, outcome)
        self.settled.append(event.action)

    @precondition(lambda self: self.lab.questions())
    @happens(which=st.integers(0, 2))
    def answer(self, pick: int, which: int) -> None:
        """A person sees to it that an answer is true, and gives it."""
        question = pick_from(self.lab.questions(), pick)
        choice = pick_from(question.choices, which).name
        make_true = getattr(self, f"make_true_{question.kind}")
        then = make_true(question, choice)
        if then is None:
            return
        self.do(ResolveIntervention(InterventionId(question.id), choice, "olga"))
        then()

    def make_true_unknown_action(self, question: Intervention, choice: str) -> Any:
        flight = self.model.flying[question.subject]
        what = flight.step
        place = {"done": what.target, "not_done": what.source}.get(choice, "")
        if what.carries and not self.put(what, flight.plate, place):
            return None

        def then() -> None:
            assert question.subject not in self.model.flying

        return then

    def make_true_lost_labware(self, question: Intervention, choice: str) -> Any:
        (effect,) = question.motions
        assert isinstance(effect, Move | Take)
        plate, target = str(effect.labware), local(effect.target)
        source = local(effect.source if isinstance(effect, Move) else effect.stack)
        what = self.model.lost.get(plate) or Step("move", "arm", source, target)
        place = {"source": source, "target": target}.get(choice, "")
        if what.do == "move" and plate not in self.model.maybe:
            return lambda: None
        if not self.put(what, plate, place):
            return None

        def then() -> None:
            self.model.lost.pop(plate, None)
            if place != STACK:
                self.model.tell(plate, *filter(None, [place]), owner="shared")

        return then

    def make_true_failed_run(self, question: Intervention, choice: str) -> Any:
        def then() -> None:
            for plate in question.labware if choice == "removed" else ():
                if plate in self.model.maybe and not self.model.is_handled(plate):
                    self.model.tell(plate)

        return then

    def make_true_contradiction(self, question: Intervention, choice: str) -> Any:
        if choice == "checked":
            return lambda: None
        (effect,) = question.motions
        assert isinstance(effect, Move), "honest people see nothing that cannot be"
        plate = str(effect.labware)
        place = {"seen": local(effect.target), "recorded": local(effect.source)}.get(choice, "")
        if plate not in self.model.maybe or self.model.find_place(plate):
            return lambda: None
        if not self.put(Step("move", "arm"), plate, place):
            return None
        return lambda: self.model.tell(plate, *filter(None, [place]))

    def quiet(self, place: str) -> bool:
        """Whether nobody is carrying anything there, so that it can be looked at."""
        return not any(place in f.step.places for f in self.model.flights() if not f.unknown)

    @precondition(lambda self: self.model.maybe or self.model.loose)
    @happens(place=st.sampled_from(list(CAPACITY)))
    def look_at(self, pick: int, place: str) -> None:
        """Somebody counts what stands at a place."""
        if not self.quiet(place):
            self.lab.reject(ObserveStation(StationName(full(place)), "olga", count=0))
            return
        here = self.model.at(place)
        self.do(ObserveStation(StationName(full(place)), "olga", count=len(here)))
        self.looked = True
        unsure = [plate for plate in self.model.maybe if not self.model.find_place(plate)]
        if not any(plate in unsure or plate in self.model.loose for plate in here):
            for plate in unsure:
                self.model.maybe[plate].discard(place)

    @precondition(lambda self: self.model.maybe)
    @happens(place=st.none() | st.sampled_from(NESTS))
    def recognise(self, pick: int, place: str | None) -> None:
        """Somebody recognises a plate where it is, or takes it elsewhere and says so."""
        plate = pick_from(list(self.model.maybe), pick)
        held = next((f for f in self.model.flying.values() if f.plate == plate), None)
        place = self.model.really.get(plate, "") if place is None else place
        if place not in CAPACITY or (held is not None and not held.unknown) or not self.quiet(place):
            return
        if not self.put(Step("move", "arm"), plate, place):
            return
        before = self.model.find_place(plate)
        if not before or before == place:
            self.model.tell(plate, place)
        else:
            self.model.tell(plate, place, before)
        self.do(ObserveStation(StationName(full(place)), "olga", labware=LabwareId(plate)))
        self.looked = True

    # -- what must be so after each of these -----------------------------------------------------

    @invariant()
    def the_lab_is_as_the_model(self) -> None:
        self.plates_are_where_they_may_be()
        self.runs_are_as_far_as_they_are()
        self.nobody_is_forgotten()

    def plates_are_where_they_may_be(self) -> None:
        known, model = self.lab.state.bench.labware, self.model
        for plate in [plate for plate in model.maybe if plate not in known]:
            assert model.really.get(plate) == TRASH, f"{plate} is forgotten"
            model.tell(plate, TRASH)
        assert {str(name) for name in known} == model.maybe.keys()
        for plate, item in known.items():
            places = {local(place) for place in (item.maybe or (item.station,))}
            assert model.really.get(plate, "") in places, f"{plate} is at {model.really.get(plate)}"
            assert places <= model.maybe[plate], f"{plate} was at {model.maybe[plate]}"
            assert item.owner == model.owner[plate]
            model.maybe[plate] = places
        for place in CAPACITY:
            here = [plate for plate in model.maybe if model.find_place(plate) == place]
            assert sorted(self.lab.at(place)) == sorted(here), place
        stack = self.lab.state.bench.stations[StationName(full(STACK))]
        assert len(stack.stock) == model.stock + len(model.loose)

    def runs_are_as_far_as_they_are(self) -> None:
        state = self.lab.state
        for name, run in self.model.runs.items():
            found = state.runs.get(name)
            if found is None:
                assert run.over, f"{name} is {run.status}"
                continue
            assert (found.status, found.paused) == (run.status, run.paused), name
            steps = [WORDS_OF_STEPS[status] for status in found.statuses]
            assert (steps or ["pending"] * len(run.steps)) == run.steps, name
        unknown = {name: flight.unknown for name, flight in self.model.flying.items()}
        assert {str(a.id): a.status == "unknown" for a in state.actions.open.values()} == unknown
        ends = {e.event.run: e.event.TYPE for e in self.lab.log if e.event.TYPE in ENDS}  # type: ignore[attr-defined]
        assert ends == {n: f"run.{run.status}" for n, run in self.model.runs.items() if run.over}

    def nobody_is_forgotten(self) -> None:
        """Whatever is not known is being asked, and what a run leaves in the way is shown."""
        questions = self.lab.questions()
        about = {question.subject for question in questions if question.kind == "unknown_action"}
        assert about == {name for name, flight in self.model.flying.items() if flight.unknown}
        asked = {str(e.labware) for q in questions for e in q.motions if isinstance(e, Move | Take)}
        asked |= {flight.plate for flight in self.model.flying.values()}
        unsure = {plate for plate in self.model.maybe if not self.model.find_place(plate)}
        assert unsure | self.model.lost.keys() <= asked
        fresh = [entry.event for entry in self.lab.log[self.seen :]]
        shown = {str(e.subject): set(e.labware) for e in fresh if getattr(e, "kind", "") == "failed_run"}  # type: ignore[attr-defined]
        for run, had in self.model.left.items() if not self.looked else ():
            places = {plate: self.model.find_place(plate) for plate in had if plate in self.model.maybe}
            left = {plate for plate, place in places.items() if place and place not in STORAGE}
            over = self.model.runs[run].status
            assert shown.get(run, set()) == (set() if over == "completed" else left), run
        self.model.left.clear()
        self.seen, self.looked = len(self.lab.log), False


ENDS = ("run.completed", "run.failed", "run.cancelled")
WORDS_OF_STEPS = {status: str(status) for status in StepStatus} | {StepStatus.IN_FLIGHT: "flying"}


@pytest.mark.parametrize(
    ("examples", "steps"),
    [(40, 40), pytest.param(2000, 60, marks=[pytest.mark.full, pytest.mark.timeout(1800)])],
)
def test_the_lab_does_what_the_model_does(examples: int, steps: int) -> None:
    run_state_machine_as_test(
        Lab,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            derandomize=os.environ.get("LABOS_RANDOM") != "1",
            database=None,
            phases=[Phase.generate, Phase.shrink],
            suppress_health_check=list(HealthCheck),
        ),
    )
