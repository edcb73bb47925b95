"""No text, however long or odd, gets past ``decide``: requests are refused, reports are cut."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.core.actions import ActionFailed, ActionSucceeded
from labos.core.decide import LABOS, Command, Rejection, decide
from labos.core.decide._base import DECIDERS, Report
from labos.core.decide.actions import DoubtAction, FinishAction, RefuseAction
from labos.core.decide.limits import BAD_TEXT, find_fault
from labos.core.decide.nodes import JoinNode, LoseNode, RecordStops, ReportState
from labos.core.ids import ActionId, ModuleName
from labos.core.modules import EmergencyStopped, NodeStateChanged
from labos.core.registry import encode
from labos.core.runs import RunFailed
from labos.core.texts import CUT, LONGEST_REPORT
from tests.support.bench import Driver, full, module, plan, step, workcell

LONG = "x" * 70_000
ODD = ["a\x00b", "a\nb", "\ud800", "a\x7fb", "\x1b[2J"]
DEV = ModuleName(full("dev"))


@pytest.fixture
def lab() -> Driver:
    return Driver(workcell([module("dev")], []))


def texts(kind: type[Command]) -> list[str]:
    fields = msgspec.structs.fields(kind)
    return [field.name for field in fields if getattr(field.type, "__supertype__", field.type) is str]


def example(kind: type[Command], /, **given: Any) -> Command | None:
    """A command with something in every field; None where a field is a whole description."""
    values: dict[str, Any] = {}
    for field in msgspec.structs.fields(kind):
        if field.name in texts(kind):
            values[field.name] = "x"
        elif field.required:
            if field.type not in (int, float, bool):
                return None
            values[field.name] = field.type(1)
    return kind(**{**values, **given})


REQUESTS = [
    (kind, field)
    for kind in sorted(DECIDERS, key=lambda kind: kind.__name__)
    if not issubclass(kind, Report) and example(kind) is not None
    for field in texts(kind)
]


@pytest.mark.parametrize(("kind", "field"), REQUESTS, ids=lambda value: getattr(value, "__name__", value))
def test_a_request_is_refused_for_a_text_that_cannot_be_recorded(
    lab: Driver, kind: type[Command], field: str
) -> None:
    for text in [LONG, *ODD]:
        if field == "note" and text == "a\nb":
            continue
        command = example(kind, **{field: text})
        assert command is not None
        decision = decide(lab.state, command, LABOS)
        assert isinstance(decision, Rejection)
        assert decision.code == BAD_TEXT
        assert repr(field) in decision.message


def test_there_are_requests_to_try() -> None:
    assert len(REQUESTS) > 50


REPORTS: list[Report] = [
    ReportState(DEV, "ERROR", LONG),
    RecordStops(LONG, {DEV: 5}),
    LoseNode(DEV, "instance-dev", LONG),
    JoinNode(DEV, LONG, LONG, "driver", LONG, LONG, "IDLE"),
    JoinNode(
        DEV, "j", "i", "driver", "1", "a", "IDLE", False, ((ActionId("a"), "x", "running"),) * 100_000, 9
    ),
]


@pytest.mark.parametrize("report", REPORTS, ids=lambda report: type(report).__name__)
def test_what_a_node_reports_is_recorded_whatever_its_words(lab: Driver, report: Report) -> None:
    decision = decide(lab.state, report, LABOS)
    if isinstance(decision, Rejection):
        assert decision.code != "unfit"
    else:
        for event in decision:
            encode(event)


def test_a_nodes_words_are_cut_and_say_so(lab: Driver) -> None:
    (event,) = lab.do(ReportState(DEV, "ERROR", LONG))
    assert isinstance(event, NodeStateChanged)
    assert len(event.error) == LONGEST_REPORT
    assert event.error.endswith(CUT)


def test_who_stopped_a_module_is_cut(lab: Driver) -> None:
    stop = next(e for e in lab.do(RecordStops("eve\x00" + LONG, {DEV: 5})) if isinstance(e, EmergencyStopped))
    assert stop.by.startswith("eve�x")
    assert len(stop.by) <= LONGEST_REPORT


@pytest.mark.parametrize(
    "result",
    [LONG, {"deep": LONG}, float("nan"), [[[]]] * 40_000],
    ids=["text", "nested text", "nan", "lists"],
)
def test_an_action_ends_whatever_it_results_in(lab: Driver, result: Any) -> None:
    run = lab.submit(plan(step("dev")))
    action = lab.start(run)
    ended = lab.do(FinishAction(action, 1, True, "all", result))
    assert any(isinstance(event, ActionSucceeded) for event in ended)
    assert not lab.state.actions.open


def test_a_nested_result_ends_its_action(lab: Driver) -> None:
    nested: Any = []
    for _ in range(100_000):
        nested = [nested]
    run = lab.submit(plan(step("dev")))
    assert lab.do(FinishAction(lab.start(run), 1, True, "all", nested))
    assert not lab.state.actions.open
    while nested:  # taken apart by hand: Python itself would run out of stack
        nested = nested.pop()


@pytest.mark.parametrize("kind", ["fail", "refuse", "doubt"])
def test_an_action_ends_whatever_is_said_of_it(lab: Driver, kind: str) -> None:
    run = lab.submit(plan(step("dev")))
    action = lab.start(run)
    report = {
        "fail": FinishAction(action, 1, False, "none", error=LONG),
        "refuse": RefuseAction(action, 1, LONG),
        "doubt": DoubtAction(action, LONG),
    }[kind]
    events = lab.do(report)
    assert events
    if kind == "fail":
        assert any(isinstance(event, ActionFailed) and event.error.endswith(CUT) for event in events)


def test_a_note_may_have_several_lines() -> None:
    assert find_fault("one\ntwo\tthree", "note") == ""
    assert "line breaks" in find_fault("one\ntwo", "why")


def test_a_step_whose_arguments_become_too_large_ends_its_run(lab: Driver) -> None:
    """Else it would never start, and nobody would hear why."""
    twice = {"a": {"$result": [0, "v"]}, "b": {"$result": [0, "v"]}}
    run = lab.submit(plan(step("dev"), step("dev", args=twice), feeds=(0,)))
    lab.finish(lab.start(run), {"v": "x" * 40_000})
    events = lab.do(lab.start_command(run, 1))
    assert any(isinstance(event, RunFailed) and "cannot be filled in" in event.why for event in events)
