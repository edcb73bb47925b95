"""A module that keeps failing is taken out of service, by itself, and says why."""

from __future__ import annotations

from labos.core.decide.actions import DoubtAction
from labos.core.decide.lab import StartKernel
from labos.core.decide.nodes import JoinNode, LoseNode, PutBack, Quarantine
from labos.core.failures import FAILURES_KEPT
from labos.core.ids import ModuleName
from labos.core.model import Retry
from labos.core.modules import Module
from labos.core.registry import Event
from labos.settings import FAILURES_KNOWN
from tests.support.bench import Driver, plan, small, step

DEV = ModuleName("cell/dev")


def dev(lab: Driver) -> Module:
    return lab.state.modules.by_name[DEV]


def judge(lab: Driver, after: int = 3, within_s: float = 600.0) -> list[Event]:
    return lab.do(Quarantine(DEV, after, within_s, lab.now))


def fail(lab: Driver, what: str = "jam") -> None:
    lab.fail(lab.start(lab.submit(plan(step("dev")))), "none", what)


def lose(lab: Driver, instance: str) -> None:
    lab.do(LoseNode(DEV, dev(lab).instance, "its process is gone"))
    lab.do(JoinNode(DEV, "journal-dev", instance, "driver", "1", "about", "IDLE"))


def test_three_failures_are_too_many() -> None:
    lab = small()
    for _ in range(2):
        fail(lab)
    assert judge(lab) == []
    fail(lab, "no foil")
    (taken,) = judge(lab)
    assert taken.TYPE == "module.taken_out"
    assert dev(lab).out_of_service == "quarantined: it has failed 3 times in 600 s, at last: no foil"
    assert judge(lab) == [], "it is out already"
    waiting = lab.submit(plan(step("dev")))
    wait = lab.check_start(waiting)
    assert lab.code(waiting) == "out_of_service"
    assert "at last: no foil" in wait.reason.sentence  # type: ignore[union-attr]
    assert "labos in-service dev" in wait.reason.remedy  # type: ignore[union-attr]
    lab.do(PutBack(DEV))
    assert lab.code(waiting) == ""
    assert (judge(lab), dev(lab).failures) == ([], []), "it starts afresh"
    lab.check_log()


def test_a_node_that_was_told_to_end_has_not_failed() -> None:
    lab = small()
    for _ in range(3):
        lab.do(LoseNode(DEV, dev(lab).instance, "the lab was closed", stopped=True))
        lab.do(JoinNode(DEV, "journal-dev", "next", "driver", "1", "about", "IDLE"))
    assert judge(lab) == []
    assert dev(lab).failures == []


def test_failures_of_long_ago_do_not_count() -> None:
    lab = small()
    for _ in range(4):
        fail(lab)
        lab.wait(400)
    assert judge(lab) == []
    assert judge(lab, within_s=2000.0) != []


def test_others_are_not_to_blame() -> None:
    lab = small()
    for _ in range(3):
        lab.fail(lab.start(lab.submit(plan(step("cam")))), "none")
    assert judge(lab) == []


def test_what_is_tried_again_counts_when_its_tries_are_used_up() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", retry=Retry(2))))
    for counted in (0, 0, 1):
        lab.fail(lab.start(run), "none")
        assert len(dev(lab).failures) == counted


def test_a_node_that_is_lost_with_its_action_counts_once() -> None:
    lab = small()
    action = lab.start(lab.submit(plan(step("dev"))))
    lose(lab, "i2")
    lab.do(DoubtAction(action, "its node was restarted in mid-motion"))
    assert [f.what for f in dev(lab).failures] == ["its node was lost: its process is gone"]
    lab.answer(lab.question("unknown_action"), "done")
    lose(lab, "i3")
    lose(lab, "i4")
    assert judge(lab) != []
    lab.check_log()


def test_a_node_that_went_with_its_kernel_has_not_failed() -> None:
    lab = small()
    for number in range(4):
        lab.do(StartKernel(number + 2, "0"))
        lose(lab, f"i{number + 2}")
    assert dev(lab).failures == []


def test_an_outcome_that_nobody_knows_counts() -> None:
    lab = small()
    lab.do(DoubtAction(lab.start(lab.submit(plan(step("dev")))), "it did not end within 5 s"))
    assert [f.what for f in dev(lab).failures] == ["it did not end within 5 s"]


def test_a_person_who_cannot_is_not_quarantined() -> None:
    lab = small()
    for _ in range(3):
        lab.start(lab.submit(plan(step("dev", by_person=True))))
        lab.answer(lab.question("planned_work"), "not_done")
    assert judge(lab) == []


def test_never_is_never_and_only_so_many_are_remembered() -> None:
    lab = small()
    for _ in range(FAILURES_KEPT + 5):
        fail(lab)
    assert judge(lab, after=0) == []
    assert len(dev(lab).failures) == FAILURES_KEPT == FAILURES_KNOWN
