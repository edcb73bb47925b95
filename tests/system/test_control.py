"""Somebody pauses, resumes, cancels or stops what is in flight, on real processes, at each step of the PCR.

The devices stand still in the midst of each motion, with the plate in the arm's hand, until the test lets
them go on: that a step is in flight is no matter of luck. What devices did is compared with the log.
"""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from labos.core.actions import ActionRequested
from labos.core.envelope import Record
from labos.core.ids import local
from labos.core.registry import decode
from labos.core.runs import RunSubmitted
from labos.node.world import World
from labos.services.truth import list_differences
from labos.spec import find_spec
from tests.support.carried import find_carried_wrong
from tests.support.cells import rpl_with
from tests.support.lab_process import until
from tests.system import test_kills as kills

SITE = Path(__file__).parents[1] / "support" / "held_motion"
PCR = (
    *("sciclops", "pf400", "ot2_pcr_alpha", "pf400", "sealer", "pf400", "biometra"),
    *("biometra", "biometra", "pf400", "peeler", "pf400", "camera_module", "pf400"),
)
"""The module of each step of the PCR."""

ARMS = ("sciclops", "pf400")
CLEAR = {"sciclops.tower1", "sciclops.tower2", "wc.output", *(f"wc.output.{n}" for n in range(1, 15))}
LAST = len(PCR) - 1
CELL = "rpl"


class Lab(kills.Lab):
    """A lab whose devices stand still when they are told to."""

    def __init__(self, home: Path, speed: int) -> None:
        super().__init__(home, f"sqlite:///{home / 'labos.db'}", "")
        self.hold = home.parent / "hold"
        self.hold.mkdir()
        self.environment |= {"PYTHONPATH": str(SITE), "LABOS_HOLD": str(self.hold)}
        self.workcell = str(rpl_with(PCR, home.parent / "rpl.yaml"))
        self.options = ["--speed", str(speed)]
        self.runs: list[str] = []
        self.places: set[str] = set()
        """Where labware was when everything had ended."""
        self._words = map(str, itertools.count(1))

    def bar(self, step: int) -> str:
        """The device of a step is to stand still in it: an arm with the plate in its hand."""
        word = next(self._words)
        fresh = self.hold / "fresh"
        fresh.write_text(f"{2 if PCR[step] in ARMS else 1} {word}")
        fresh.replace(self.hold / PCR[step])
        return word

    def is_held(self, step: int, word: str) -> bool:
        """Whether it stands still, and the log knows that it is at work."""
        note = self.hold / f"{PCR[step]}.held"
        if not note.exists() or note.read_text() != word:
            return False
        state, _ = self.fold_log()
        flying = {local(a.module) for a in state.actions.open.values() if a.status == "accepted"}
        return PCR[step] in flying

    def let_go(self, step: int) -> None:
        (self.hold / PCR[step]).unlink(missing_ok=True)

    def submit(self, **more: Any) -> str:
        pcr = find_spec("workflows", "pcr")
        run = self.ask(lambda client: client.submit(pcr, {"seal": {"time": 3.0}}, user="ada", **more))
        self.runs.append(run)
        return str(run)

    def control(self, verb: str, target: str) -> None:
        self.ask(lambda client: client.control(verb, target, "ada"))

    def at_rest(self) -> bool:
        """Whether runs have ended, questions are answered and modules are well; a person sees to it."""
        state, _ = self.see_out(self.runs)
        in_error = any(module.status == "ERROR" for module in state.modules.by_name.values())
        if not in_error and not state.interventions.open:
            return True
        world = World(str(self.home / "world" / "rpl.db"))
        try:
            self.be_a_person(world)
        finally:
            world.close()
        return False

    def check(self) -> Counter[str]:
        """What happened, when everything has ended and the bench is as the log says."""
        until(self.at_rest, "everything has ended")
        state, records = self.fold_log()
        world = World(str(self.home / "world" / "rpl.db"))
        try:
            assert list_differences(world, state, records) == []
            assert find_carried_wrong(world, records) == []
        finally:
            world.close()
        self.places = {local(item.station) for item in state.bench.labware.values()}
        return Counter(record.head.type for record in records)


class Flight:
    """A PCR that goes on from one step in flight to the next when it is told to."""

    def __init__(self, lab: Lab, **more: Any) -> None:
        self.lab, self.step = lab, 0
        self.experiment = str(more.get("experiment", ""))
        self.word = lab.bar(0)
        self.run = lab.submit(**more)
        self.arrive()

    def arrive(self) -> None:
        """Wait until the step is in flight."""
        until(lambda: self.lab.is_held(self.step, self.word), f"step {self.step} is in flight")

    def land(self) -> None:
        """Let the step end; the next one will stand still."""
        step = self.step
        if step < LAST:
            self.word = self.lab.bar(step + 1)
        if step == LAST or PCR[step + 1] != PCR[step]:
            self.lab.let_go(step)
        until(lambda: self.has_landed(step), f"step {step} ends")
        self.step += 1

    def has_landed(self, step: int) -> bool:
        _, records = self.lab.fold_log()
        ends = [json.loads(r.payload) for r in records if r.head.type == "action.succeeded"]
        return any((end["run"], end["step"]) == (self.run, step) for end in ends)

    def reach(self, step: int) -> Flight:
        while self.step < step:
            self.land()
            self.arrive()
        return self

    def drop(self) -> None:
        """Let everything go its way."""
        self.lab.let_go(self.step)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    made = Lab(tmp_path / "lab", 3000)
    made.start()
    try:
        yield made
        assert made.stop() == 0
    finally:
        if made.process is not None and made.process.poll() is None:
            made.process.kill()
            made.process.wait()


PAUSED = ("run.paused", "starts.paused")
RESUMED = ("run.resumed", "starts.resumed")


def find_started_in_pause(records: Sequence[Record]) -> list[str]:
    """Actions that were asked for while their run, experiment, module, workcell or the lab was paused."""
    paused: set[str] = set()
    homes: dict[str, str] = {}
    found = []
    for record in records:
        event = decode(record.head.type, record.head.schema, record.payload)
        if record.head.type in PAUSED + RESUMED:
            target = str(getattr(event, "run", "") or getattr(event, "target", ""))
            (paused.add if record.head.type in PAUSED else paused.discard)(target)
        if isinstance(event, RunSubmitted):
            homes[event.run] = event.experiment or event.run
        if isinstance(event, ActionRequested) and paused & {
            *(event.run, homes[event.run]),
            *(event.module, CELL, "*"),
        }:
            found.append(f"{event.name} of {event.run} at {record.head.position}")
    return found


TARGETS: dict[str, Callable[[Flight], str]] = {
    "run": lambda flight: flight.run,
    "experiment": lambda flight: flight.experiment,
    "module": lambda flight: f"{CELL}/{PCR[flight.step]}",
    "workcell": lambda flight: CELL,
    "lab": lambda flight: "lab",
}


def pause(flight: Flight, kind: str) -> None:
    """What is in flight ends, nothing else begins until it is resumed."""
    target = TARGETS[kind](flight)
    flight.lab.control("pause", target)
    flight.land()
    if kind != "run" or flight.step <= LAST:  # a run that has ended cannot be resumed
        flight.lab.control("resume", target)
    if flight.step <= LAST:
        flight.arrive()


def begin_flight(lab: Lab, kind: str) -> Flight:
    """A PCR; of an experiment, if that is what somebody will lay hands on."""
    experiment = ""
    if kind == "experiment":
        experiment = lab.ask(lambda client: client.start_experiment("app", "ada"))
    return Flight(lab, experiment=experiment)


def cancel(lab: Lab, step: int, kind: str, flight: Flight | None = None) -> None:
    """What is in flight ends, then the plate goes the way out."""
    flight = (flight or begin_flight(lab, kind)).reach(step)
    lab.control("cancel", TARGETS[kind](flight))
    flight.drop()
    count = lab.check()
    assert count["run.cancelled"] + count["run.completed"] == len(lab.runs)
    assert lab.questions == []
    assert lab.places <= CLEAR


def stop(lab: Lab, step: int, target: str) -> None:
    """The device stands still at once; a person looks, answers and resets."""
    flight = Flight(lab).reach(step)
    told = lab.ask(lambda client: client.emergency_stop(target or PCR[step], "ada"))
    assert f"{CELL}/{PCR[step]}" in told["stopped"]
    assert told["silent"] == {}
    flight.drop()
    count = lab.check()
    assert count["module.emergency_stopped"] == len(told["stopped"])
    assert count["run.completed"] + count["run.failed"] + count["run.cancelled"] == len(lab.runs) + lab.resets
    state, _ = lab.fold_log()
    assert {module.status for module in state.modules.by_name.values()} == {"IDLE"}


def test_control_of_what_is_in_flight(lab: Lab) -> None:
    """One of each kind, at steps of several modules."""
    flight = Flight(lab)
    pause(flight.reach(1), "run")
    pause(flight.reach(3), "workcell")
    pause(flight.reach(4), "module")
    lab.control("cancel", flight.run)
    flight.drop()
    assert find_started_in_pause(lab.fold_log()[1]) == []
    assert lab.check()["run.cancelled"] == 1
    flight = begin_flight(lab, "experiment")
    pause(flight.reach(1), "experiment")
    cancel(lab, 2, "experiment", flight)
    assert find_started_in_pause(lab.fold_log()[1]) == []
    stop(lab, 1, "")


@pytest.mark.full
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", TARGETS)
def test_a_pause_at_every_step(lab: Lab, kind: str) -> None:
    flight = begin_flight(lab, kind)
    while flight.step <= LAST:
        pause(flight, kind)
    if kind == "experiment":
        lab.ask(lambda client: client.end_experiment(flight.experiment))
    assert lab.check()["run.completed"] == 1
    records = lab.fold_log()[1]
    assert find_started_in_pause(records) == []
    assert sum(record.head.type in PAUSED for record in records) == len(PCR)


@pytest.mark.full
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["run", "experiment", "module", "workcell"])
def test_a_cancellation_at_every_step(lab: Lab, kind: str) -> None:
    for step in range(len(PCR)):
        cancel(lab, step, kind)


@pytest.mark.full
@pytest.mark.parametrize("target", ["", CELL], ids=["the module", "the workcell"])
@pytest.mark.parametrize("step", range(len(PCR)))
def test_an_emergency_stop_at_every_step(lab: Lab, step: int, target: str) -> None:
    stop(lab, step, target)
