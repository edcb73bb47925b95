"""Late word about runs that have ended goes into the real store: nothing is written to the stream
of a run that is over, whose versions are not known any more."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.core.decide.actions import FinishAction
from labos.core.decide.handover import HandOver
from labos.core.decide.observation import ObserveStation
from labos.core.ids import ActionId, LabId, LabwareId, Owner, StationName
from labos.core.registry import Event
from labos.runtime.ledger import Ledger, load
from labos.store import SqlEventStore, open_store
from tests.support.bench import Driver, plan, route, small_cell, step


class Written(Driver):
    """A lab whose every event is written to a database at once, where each (stream, version) may
    stand only once."""

    def __init__(self, store: SqlEventStore) -> None:
        self.store = store
        self.head = store.claim(LabId("lab-1"), "test", 60.0)
        self.ledger: Ledger | None = None
        super().__init__(small_cell())
        self.stock("stack", 5)

    def write(self, event: Event) -> Event:
        if self.ledger is None:
            self.ledger = Ledger(self.state, self.head, SystemClock(), Uuid7Ids())
        entry = self.ledger.write(event, "test")
        self.head = self.store.append(self.head, [entry.record])
        return entry.event


@pytest.fixture
def lab(tmp_path: Path) -> Written:
    return Written(open_store(f"sqlite:///{tmp_path}/labos.db"))


def same_again(lab: Written) -> None:
    state, _ = load(lab.store, snapshots=False)
    assert state == lab.state
    lab.store.close()


def late(lab: Driver, action: str, effects: str) -> list[Event]:
    return lab.do(FinishAction(ActionId(action), 1, effects == "all", effects, error="late"))  # type: ignore[arg-type]


@pytest.mark.parametrize("choice", ["done", "not_done", "gone"])
@pytest.mark.parametrize("effects", ["all", "none", "partial", "unknown"])
def test_a_late_result_of_an_ended_run_is_evidence(lab: Written, choice: str, effects: str) -> None:
    run = lab.submit(route("stack", "a", "b"))
    lab.step(run)
    action = lab.start(run, 1)
    lab.doubt(action)
    lab.answer(lab.question(), choice)
    if choice == "not_done":
        lab.step(run, 1)
    assert lab.state.runs.get(run) is None
    events = late(lab, action, effects)
    assert events[0].TYPE == "action.evidence"
    for question in lab.questions("contradiction"):
        lab.answer(question, "checked")
    assert late(lab, action, effects) == [], "once is enough"
    same_again(lab)


@pytest.mark.parametrize("choice", ["source", "target", "gone"])
def test_what_an_ended_run_lost_is_found(lab: Written, choice: str) -> None:
    run = lab.submit(route("stack", "a", "b"))
    lab.step(run)
    lab.fail(lab.start(run, 1))
    assert lab.state.runs.get(run) is None
    lab.answer(lab.question("lost_labware"), choice)
    same_again(lab)


def test_what_an_ended_run_left_is_seen_given_and_carried_away(lab: Written) -> None:
    run = lab.submit(plan(*route("stack", "a").steps, step("dev")))
    lab.step(run)
    lab.refuse(lab.start(run, 1))
    assert lab.state.runs.get(run) is None
    lab.do(ObserveStation(StationName("cell/a"), "ada", count=0))
    lab.answer(lab.question("contradiction"), "there")
    lab.do(HandOver(LabwareId("P1"), Owner("user:bo"), "ada"))
    lab.do(HandOver(LabwareId("P1"), Owner("shared"), "bo"))
    lab.answer(lab.question("failed_run"), "removed")
    same_again(lab)


def test_a_closing_run_ends_with_its_experiment(lab: Written) -> None:
    experiment = lab.experiment(closing=route("a", "b"))
    lab.step(lab.submit(route("stack", "a"), experiment=experiment))
    lab.end(experiment)
    lab.step("R2")
    lab.do(HandOver(LabwareId("P1"), Owner("shared"), "ada"))
    lab.do(ObserveStation(StationName("cell/b"), "ada", labware=LabwareId("P1")))
    same_again(lab)


def test_every_word_about_labware_without_a_run_has_a_stream_of_its_own(lab: Written) -> None:
    """What the store would refuse, if somebody wrote it: the name of the run, after its end."""
    from labos.core.labware import LabwareChanged
    from labos.errors import InvariantBroken

    run = lab.submit(route("stack", "a"))
    lab.step(run)
    lab.write(LabwareChanged(LabwareId("P1"), "", "sealed", True))
    with pytest.raises((InvariantBroken, ValueError)):
        lab.write(LabwareChanged(LabwareId("P1"), run, "sealed", False))
    lab.store.close()
