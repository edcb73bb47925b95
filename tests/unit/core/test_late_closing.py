"""A closing workflow that does not begin is somebody's business: its experiment does not stay open unseen."""

from __future__ import annotations

import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.ids import LabwareId, RunId
from labos.core.interventions import InterventionRequested
from labos.core.rules import CLOSING_S
from labos.planning.deadlines import Deadlines
from tests.support.bench import Driver, route, small

KIND = "closing_waits"
R2 = RunId("R2")


def make_closing() -> Driver:
    """An experiment that has ended; its closing workflow goes by way of b, where bob's plate stands."""
    lab = small()
    name = lab.experiment(closing=route("a", "b", "trash", name="clear"))
    lab.step(lab.submit(route("stack", "a"), experiment=name))
    lab.end(name)
    lab.step(lab.submit(route("stack", "b"), user="bob"))
    assert lab.state.runs.queued[R2].closing
    return lab


def look_in(lab: Driver, seconds: float, deadlines: Deadlines) -> list[object]:
    """What the kernel does about it after a while."""
    lab.wait(seconds)
    return [event for command in deadlines.iterate_due(lab.state, lab.now) for event in lab.do(command)]


def test_somebody_is_told_once() -> None:
    lab, deadlines = make_closing(), Deadlines()
    assert look_in(lab, CLOSING_S - 1, deadlines) == []
    (asked,) = look_in(lab, 2, deadlines)
    assert isinstance(asked, InterventionRequested)
    assert (asked.kind, asked.run) == (KIND, "R2")
    assert "labos explain R2" in asked.text
    assert look_in(lab, 100_000, deadlines) == []
    lab.answer(lab.question(KIND), "wait")
    assert look_in(lab, 100_000, deadlines) == []
    assert look_in(lab, 1, Deadlines()) == []
    lab.check_log()


def test_it_ends_by_an_answer_and_its_labware_stays_where_it_is() -> None:
    lab = make_closing()
    look_in(lab, CLOSING_S + 1, Deadlines())
    lab.answer(lab.question(KIND), "end")
    assert lab.state.experiments.open == {}
    assert (lab.owner("P1"), lab.state.bench.labware[LabwareId("P1")].station) == ("user:ada", "cell/a")
    assert lab.questions(KIND) == []
    lab.check_log()


@pytest.mark.parametrize("how", ["begins", "is cancelled"])
def test_the_question_ends_with_what_it_is_about(how: str) -> None:
    lab = make_closing()
    look_in(lab, CLOSING_S + 1, Deadlines())
    if how == "begins":
        lab.step(lab.submit(route("b", "c"), user="bob"))
        lab.step("R2")
    else:
        lab.do(CancelRun(R2))
    assert lab.questions(KIND) == []
    lab.check_log()


def test_other_runs_wait_as_long_as_they_like() -> None:
    lab = small()
    lab.submit(route("b", "trash"))
    assert look_in(lab, 1_000_000, Deadlines()) == []
