"""What follows from an event: in order, on the state that the event has left, and not without end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from labos.core.decide import LABOS, REACTIONS, Command, Decision, Rejection, carry_out
from labos.core.decide._base import DECIDERS, UNFIT
from labos.core.decide.control import CancelRuns
from labos.core.envelope import MAX_PAYLOAD_BYTES
from labos.core.ids import RunId
from labos.core.lab import WHOLE_LAB
from labos.core.registry import Event
from labos.core.runs import RunPaused, RunResumed
from labos.core.state import LabState, encode_picture
from labos.core.steps import WindowBreached
from tests.support.bench import Driver, plan, small, station, step, take, workcell
from tests.support.bench import module as device

R1, R2 = RunId("R1"), RunId("R2")


class Answer(Command, frozen=True):
    """Decides whatever a test wants."""


def with_two_runs() -> Driver:
    lab = small()
    for _ in (R1, R2):
        lab.submit(plan(step("dev")))
    return lab


def answers(monkeypatch: pytest.MonkeyPatch, *events: Event, one_by_one: bool = False) -> None:
    def decide(state: LabState, command: Answer) -> Decision:
        return iter(events) if one_by_one else list(events)

    monkeypatch.setitem(DECIDERS, Answer, decide)


def test_what_follows_comes_in_the_order_of_the_events_and_after_all_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def resume(state: LabState, event: RunPaused) -> Iterator[Event]:
        yield RunResumed(event.run)

    def note(state: LabState, event: RunResumed) -> Iterator[Event]:
        yield WindowBreached(event.run, 0, 0, 1.0)

    monkeypatch.setitem(REACTIONS, RunPaused, (resume,))
    monkeypatch.setitem(REACTIONS, RunResumed, (note,))
    answers(monkeypatch, RunPaused(R1), RunPaused(R2))
    events = with_two_runs().do(Answer())
    assert [(event.TYPE, event.stream()) for event in events] == [
        ("run.paused", "R1"),
        ("run.paused", "R2"),
        ("run.resumed", "R1"),
        ("run.resumed", "R2"),
        ("window.breached", "R1"),
        ("window.breached", "R2"),
    ]


def test_a_reaction_reads_what_its_own_events_have_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    def toggle(state: LabState, event: WindowBreached) -> Iterator[Event]:
        run = state.runs.queued[event.run]
        yield RunPaused(run.id)
        assert run.paused
        yield RunResumed(run.id)
        assert not run.paused

    monkeypatch.setitem(REACTIONS, WindowBreached, (toggle,))
    answers(monkeypatch, WindowBreached(R1, 0, 0, 1.0))
    assert len(with_two_runs().do(Answer())) == 3


def test_what_follows_without_end_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    def again(state: LabState, event: WindowBreached) -> Iterator[Event]:
        yield event

    monkeypatch.setitem(REACTIONS, WindowBreached, (again,))
    answers(monkeypatch, WindowBreached(R1, 0, 0, 1.0))
    written: list[Event] = []

    def write(event: Event) -> Event:
        written.append(event)
        return event

    with pytest.raises(RuntimeError, match="The reactions to Answer do not end"):
        carry_out(LabState(), Answer(), write, LABOS)
    assert len(written) == 10_002


@pytest.mark.parametrize("one_by_one", [False, True])
def test_what_cannot_be_written_is_refused_before_anything_is_folded(
    monkeypatch: pytest.MonkeyPatch, one_by_one: bool
) -> None:
    large = RunPaused(R1, "x" * MAX_PAYLOAD_BYTES)
    answers(monkeypatch, *([large] if one_by_one else [RunPaused(R2), large]), one_by_one=one_by_one)
    lab = with_two_runs()
    before = encode_picture(lab.state)
    answer = lab.reject(Answer())
    assert isinstance(answer, Rejection)
    assert answer.code == UNFIT
    assert encode_picture(lab.state) == before


def test_two_lids_of_one_action_have_two_names() -> None:
    cell = workcell(
        [device("arm")], [station("s1", "stack", 3), station("s2", "stack", 3), *map(station, "ab")]
    )
    lab = Driver(cell)
    for stack in ("s1", "s2"):
        lab.stock(stack, 1, "plate+lid")
    lab.submit(plan(step("arm", take("s1", "a"), take("s2", "b"))))
    lab.finish(lab.start("R1"))
    plates = {name: item.lid for name, item in lab.state.bench.labware.items() if not item.on}
    assert plates == {"P1": "P3", "P2": "P4"}


def test_runs_that_are_cancelled_together_leave_questions_of_their_own() -> None:
    lab = small()
    for run, place in ((R1, "a"), (R2, "b")):
        lab.submit(plan(step("arm", take("stack", place)), step("dev")))
        lab.step(run)
    lab.do(CancelRuns(WHOLE_LAB))
    assert [(q.id, q.labware) for q in lab.questions("failed_run")] == [("I1", ("P1",)), ("I2", ("P2",))]
    lab.check_log()
