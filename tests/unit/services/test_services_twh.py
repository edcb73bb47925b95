"""Time without human intervention: the documented example, and what the definition leaves open."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from labos.core.actions import ActionSucceeded
from labos.core.decide.actions import DoubtAction
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.runs import PauseRun, ResumeRun, SubmitRun
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.experiments import ExperimentStarted
from labos.core.ids import ActionId, ExperimentId, InterventionId, ModuleName, RunId, StationName
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import KernelStarted
from labos.core.labware import StationDeclared, StationUnloaded, WasteEmptied
from labos.core.model import Plan, PlanStep
from labos.core.modules import ModulePutBack
from labos.core.plans import PlanRecorded
from labos.core.registry import Event
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.runs import RunCompleted, RunStarted, RunSubmitted
from labos.core.topics import Choice
from labos.services.log import decode_events
from labos.services.twh import Meter, Twh, TwhReport, measure
from tests.simulation import mixes
from tests.unit.services.logbook import SECOND, START_NS, Logbook, seal_records

DOCUMENT = Path(__file__).parents[3] / "docs" / "time-without-human-intervention.md"
MINUTE = 60

Told = tuple[float, str, Event]


def make_submitted(run: str, experiment: str = "") -> Event:
    return RunSubmitted(RunId(run), "plan", "pcr", "ada", ExperimentId(experiment), 0, {}, {})


def make_succeeded(run: str) -> Event:
    return ActionSucceeded(ActionId("a"), RunId(run), 0, ModuleName("rpl/pf400"), 1)


def make_asked(name: str, run: str = "", module: str = "", subject: str = "") -> Event:
    choices = (Choice("done", ""),)
    return InterventionRequested(InterventionId(name), "unknown_action", subject, "?", choices, run, module)


def make_answered(name: str, choice: str = "done", by: str = "bo") -> Event:
    return InterventionResolved(InterventionId(name), choice, by)


def tips(level: float = 96) -> Event:
    return LevelSet(ModuleName("rpl/ot2"), "tips", level, 96)


def preface() -> list[Told]:
    """A plan on the workcell ``rpl``, and an experiment."""
    return [
        (0, "labos", PlanRecorded("R1", "plan", "shape", "pcr", "rpl", 1, (), {})),
        (0, "bo", ExperimentStarted(ExperimentId("E1"), "colours", "bo")),
    ]


def parse_line(minute: float, text: str) -> list[Told]:
    """The events that a line of the documented example stands for."""
    at, words = minute * MINUTE, text.split()
    match words:
        case ["ada", "declares", *_]:
            return [(at, "ada", StationDeclared(StationName("rpl/wc.output"), ()))]
        case [run, "starts"]:
            experiment = "E1" if run == "R2" else ""
            return [(at, "ada", make_submitted(run, experiment)), (at, "labos", RunStarted(RunId(run)))]
        case ["an", "action", "of", run, "succeeds"]:
            return [(at, "rpl/pf400", make_succeeded(run))]
        case [name, "asks", "a", "person", "about", run]:
            return [(at, "rpl/pf400", make_asked(name, run))]
        case [by, "answers", name]:
            return [(at, by, make_answered(name, by=by))]
        case [run, "completes"]:
            return [(at, "rpl/pf400", RunCompleted(RunId(run), 1))]
        case [by, "refills", *_]:
            return [(at, by, tips())]
    pytest.fail(f"the example says {text!r}, which this test does not understand")


def rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def figures(twh: Twh) -> list[str]:
    current, longest = twh.current, twh.longest
    return [
        f"{current.worked_ns / SECOND / MINUTE:g}",
        str(current.commands),
        f"{longest.worked_ns / SECOND / MINUTE:g}",
        str(longest.commands),
        str(twh.interventions),
    ]


def scope(report: TwhReport, name: str) -> Twh:
    kind, _, which = name.partition(" ")
    if kind == "lab":
        return report.lab
    return {"workcell": report.workcells, "experiment": report.experiments, "run": report.runs}[kind][which]


def test_the_documented_example() -> None:
    example = DOCUMENT.read_text(encoding="utf-8").partition("## A worked example")[2]
    story, _, outcome = example.partition("At minute")
    told = preface()
    for minute, text in rows(story):
        told += parse_line(float(minute), re.sub(r"\s*\(.*\)", "", text))
    assert len(told) >= 14
    now = START_NS + int(outcome.split(":")[0]) * MINUTE * SECOND
    report = measure(seal_records(told), now)
    expected = {row[0]: row[1:] for row in rows(outcome)}
    assert {name: figures(scope(report, name)) for name in expected} == expected
    assert len(expected) == 5


def minutes(stretch_ns: int) -> float:
    return stretch_ns / SECOND / MINUTE


def measure_with(*more: tuple[float, str, Event], until: float | None = None) -> TwhReport:
    """R1 runs from minute 0; ``more`` happens at its minutes."""
    told = [*preface(), (0.0, "ada", make_submitted("R1")), (0.0, "labos", RunStarted(RunId("R1")))]
    told += [(minute * MINUTE, actor, event) for minute, actor, event in more]
    return measure(seal_records(told), None if until is None else START_NS + int(until * MINUTE) * SECOND)


def test_now_counts_while_something_runs() -> None:
    report = measure_with(until=30)
    assert report.lab.working
    assert minutes(report.lab.current.worked_ns) == 30
    assert minutes(report.lab.longest.worked_ns) == 30
    assert (
        minutes(measure_with((10, "labos", RunCompleted(RunId("R1"), 1)), until=30).lab.current.worked_ns)
        == 10
    )


def test_a_withdrawn_question_is_no_intervention() -> None:
    report = measure_with(
        (10, "m/x", make_asked("I1", "R1")),
        (15, "labos", make_answered("I1", "withdrawn", "labos")),
        until=20,
    )
    assert report.lab.interventions == 0
    assert minutes(report.runs["R1"].current.worked_ns) == 15


def test_to_approve_a_submission_is_no_intervention() -> None:
    """No more than to submit one."""
    question = InterventionRequested(
        InterventionId("I1"), "approval", "R2", "?", (Choice("approve", ""),), run="R2"
    )
    approved = InterventionResolved(InterventionId("I1"), "approve", "olga")
    report = measure_with((5, "labos", question), (6, "olga", approved))
    assert report.lab.interventions == 0


def test_an_answer_about_a_module_concerns_what_is_alive_there() -> None:
    report = measure_with(
        (10, "m/x", make_asked("I1", module="rpl/sealer")), (15, "bo", make_answered("I1")), until=20
    )
    assert report.lab.interventions == report.workcells["rpl"].interventions == 1
    assert report.runs["R1"].interventions == 1
    assert minutes(report.runs["R1"].longest.worked_ns) == 15
    other = measure_with(
        (10, "m/x", make_asked("I1", module="other/sealer")), (15, "bo", make_answered("I1")), until=20
    )
    assert other.workcells["rpl"].interventions == 0
    assert other.lab.interventions == 1


def test_a_module_putting_itself_out_is_no_person() -> None:
    put_back = ModulePutBack(ModuleName("rpl/sealer"))
    assert measure_with((10, "rpl/sealer", put_back)).lab.interventions == 0
    assert measure_with((10, "labos", put_back)).lab.interventions == 0
    assert measure_with((10, "ada", put_back)).lab.interventions == 1


def test_time_without_a_kernel_counts_for_nothing() -> None:
    report = measure_with((10, "rpl/x", make_succeeded("R1")), (70, "labos", KernelStarted(2, "1")), until=80)
    assert minutes(report.lab.current.worked_ns) == 20
    assert report.lab.interventions == 0


def test_set_up_and_what_follows_from_an_answer_are_not_counted() -> None:
    book = Logbook()
    book.furnish()
    book.write([LevelSet(ModuleName("rpl/sealer"), "foil", 10, 1000)])
    book.submit("pcr")
    book.at(10)
    book.carry_through("R1", seconds=10, steps=2)
    assert measure(book.records).lab.interventions == 0
    book.do(DeclareStation(StationName("rpl/hidex.default"), ()))
    book.do(TakeOut(ModuleName("rpl/hidex"), "smoke"))
    book.do(PutBack(ModuleName("rpl/hidex")))
    report = measure(book.records)
    assert report.lab.interventions == report.runs["R1"].interventions == 3
    before = len(book.records)
    cell = mixes.CELL.workcell
    import msgspec

    modules = tuple(
        msgspec.structs.replace(m, levels={**m.levels, "oil": 5.0}) if m.name == "rpl/sealer" else m
        for m in cell.modules
    )
    book.do(ApplyWorkcell(msgspec.structs.replace(cell, digest="new", modules=modules)))
    assert any(record.head.type == "resource.level_set" for record in book.records[before:])
    assert measure(book.records).lab.interventions == 3


def test_a_paused_run_does_not_work() -> None:
    book = Logbook()
    book.furnish()
    book.submit("pcr")
    book.at(100)
    book.carry_through("R1", seconds=10, steps=1)
    book.do(PauseRun(RunId("R1")))
    book.at(500)
    book.do(ResumeRun(RunId("R1")))
    book.at(520)
    report = measure(book.records, book.clock.now)
    assert report.runs["R1"].current.worked_ns == 30 * SECOND
    assert report.lab.interventions == 0
    assert report.lab.current.commands == 1


def test_a_refill_in_time_is_planned_and_one_that_is_awaited_a_rescue() -> None:
    book = Logbook()
    book.furnish()
    refill = Replenish(ModuleName("rpl/sealer"), "foil", 5, "F2")
    book.write([LevelSet(ModuleName("rpl/sealer"), "foil", 10, 1000)])
    book.do(refill)
    book.submit("pcr")
    book.at(10)
    book.carry_through("R1", seconds=10, steps=2)
    book.do(refill)
    book.do(UnloadStation(StationName("rpl/sciclops.tower1"), "ada", count=1))
    book.do(LoadStation(StationName("rpl/sciclops.tower1"), "plate96", 1, "L1"))
    book.do(LoadStation(StationName("rpl/hidex.default"), "plate96", 1, "L2"))
    report = measure(book.records)
    assert (report.lab.interventions, report.lab.planned, report.runs["R1"].planned) == (0, 4, 4)
    book.do(DeclareStation(StationName("rpl/wc.trash"), ("plate96",) * 3))  # that is an intervention
    book.do(UnloadStation(StationName("rpl/wc.trash"), "ada"))
    report = measure(book.records)
    assert (report.lab.interventions, report.lab.planned) == (1, 5)
    awaited = ResourceReplenished(ModuleName("rpl/sealer"), "foil", 5, "F3", "", (RunId("R1"),))
    late = measure_with((10, "ada", awaited))
    assert (late.lab.interventions, late.lab.planned) == (1, 0)


def test_emptying_a_waste_in_time_is_planned_and_making_room_for_who_waits_a_rescue() -> None:
    trash = StationName("rpl/wc.trash")
    in_time = measure_with((10, "ada", StationUnloaded(trash, 4)), (20, "ada", WasteEmptied(trash)))
    assert (in_time.lab.interventions, in_time.lab.planned) == (0, 2)
    late = measure_with((10, "ada", StationUnloaded(trash, 4, (RunId("R1"),))))
    assert (late.lab.interventions, late.lab.planned) == (1, 0)


def test_a_reset_by_a_person_is_an_intervention_and_one_that_a_workflow_plans_none() -> None:
    book = Logbook()
    book.furnish()
    sealer = ModuleName("rpl/sealer")
    recover = PlanStep("reset", sealer, "reset", recovers=True)
    reset = SubmitRun(Plan("do sealer.reset", "rpl", (recover,)), "ada")
    book.do(reset)  # before the first run: set-up
    book.submit("pcr")
    book.at(10)
    book.carry_through("R2", seconds=10, steps=2)
    assert measure(book.records).lab.interventions == 0
    book.do(reset, "rpl/sealer")  # not by a person
    book.do(SubmitRun(Plan("seal", "rpl", (recover, PlanStep("look", sealer, "observe"))), "ada"))
    assert measure(book.records).lab.interventions == 0
    book.do(reset)
    report = measure(book.records)
    assert report.lab.interventions == report.runs["R2"].interventions == 1


def test_what_a_person_sees_and_so_answers_is_an_intervention() -> None:
    for by, interventions in (("ada", 1), ("rpl/camera_module", 0)):
        book = Logbook()
        book.furnish()
        run = book.submit("pcr")
        book.at(10)
        book.carry_through(run, seconds=10, steps=1)
        book.do(DoubtAction(book.start(run, 1), "its node died"), "labos")
        (item,) = book.state.bench.labware
        book.do(ObserveStation(StationName("rpl/sciclops.exchange"), by, labware=item), by)
        assert not book.state.interventions.open
        report = measure(book.records)
        assert report.lab.interventions == report.runs[run].interventions == interventions
        book.do(ObserveStation(StationName("rpl/sciclops.exchange"), by, labware=item), by)
        assert measure(book.records).lab.interventions == interventions, "it answered nothing"


def test_one_shift_is_measured_by_itself() -> None:
    told = [*preface(), (0.0, "ada", make_submitted("R1")), (0.0, "labos", RunStarted(RunId("R1")))]
    told += [(600, "ada", tips()), (3600, "ada", tips()), (3900, "labos", RunCompleted(RunId("R1"), 1))]
    meter = Meter()
    for event, head in decode_events(seal_records(told)):
        if head.recorded_at == START_NS + 3600 * SECOND:
            meter.start_over(START_NS + 3000 * SECOND)
        meter.add(event, head)
    lab = meter.report().lab
    assert (minutes(lab.longest.worked_ns), lab.interventions) == (10, 1)
