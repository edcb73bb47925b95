"""A log that lost its end: nothing starts until a person has said what stands where."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.access import RequestAccess
from labos.core.decide.actions import FinishAction, RefuseAction, ResendAction
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import StartKernel
from labos.core.decide.nodes import HearJournal, JoinNode, LoseNode, ReportState, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.runs import SubmitRun
from labos.core.decide.shorter import (
    ConfirmStations,
    FoundAction,
    ReportShorterLog,
    SayContents,
    list_to_say,
    must_describe,
)
from labos.core.decide.stock import LoadStation
from labos.core.effects import AnyEffect, Move, Needs, Take
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import LEAP
from labos.core.modules import ModuleTakenOut, VariableSet
from labos.core.topics import DiscoveredAction
from labos.core.waits import Wait
from tests.support.bench import Driver, full, move, needs, plan, small, step, take

ARM, DEV = ModuleName("cell/arm"), ModuleName("cell/dev")


def place(name: str) -> StationName:
    return StationName(full(name))


def make_move(labware: str, source: str, target: str) -> Move:
    return Move(place(source), place(target), labware=LabwareId(labware))


def make_found(name: str, *effects: AnyEffect, position: int = 900) -> FoundAction:
    return FoundAction(ActionId(name), "transfer", "finished", position, effects)


def hears(module: ModuleName, entry: FoundAction) -> HearJournal:
    return HearJournal(module, (entry,))


def make_carried() -> Driver:
    """P1 stands at a by the log; it was really taken to dev.n1 behind the log's end."""
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    lab.do(hears(ARM, make_found("X1", make_move("P1", "a", "dev.n1"))))
    return lab


def say(lab: Driver, **stations: str) -> None:
    """``b="P1"``; a dot of a station is written as two underscores."""
    for name, words in stations.items():
        lab.do(SayContents(place(name.replace("__", ".")), "ada", tuple(words.split())))


def confirm_rest(lab: Driver) -> None:
    lab.do(
        ConfirmStations(tuple(n for n in list_to_say(lab.state) if not must_describe(lab.state, n)), "ada")
    )


def answer(lab: Driver) -> None:
    lab.answer(lab.question("log_shorter"), "checked")


def test_nothing_starts_and_checked_is_no_answer_until_all_was_said() -> None:
    lab = make_carried()
    run = next(iter(lab.state.runs.active))
    other = lab.submit(plan(step("cam")))
    assert lab.pump() == []
    assert lab.code(run, 1) == lab.code(other) == "log_shorter"
    wait = lab.check_start(other)
    assert isinstance(wait, Wait)
    assert wait.reason.sentence == (
        f"this log ends at {lab.state.shorter.ended} and arm knows more: "
        "nothing starts until the whole bench has been checked"
    )
    assert wait.reason.remedy.endswith("labos bench round")
    question = lab.question("log_shorter")
    refusal = lab.reject(ResolveIntervention(question.id, "checked", "ada"))
    assert refusal.code == "unsaid"
    assert "labos bench round" in refusal.remedy
    say(lab, a="", dev__n1="P1")
    assert lab.reject(ResolveIntervention(question.id, "checked", "ada")).code == "unsaid"
    confirm_rest(lab)
    if list_to_say(lab.state):
        say(lab, **{name.partition("/")[2].replace(".", "__"): "" for name in list_to_say(lab.state)})
    answer(lab)
    assert lab.where("P1") == "dev.n1"
    assert lab.state.shorter.since == 0
    assert lab.state.runs.active == {}, "the run that was under way has ended"
    assert lab.owner("P1") == "user:ada"
    assert lab.run(other).paused, "it may have been carried out behind the log's end"
    lab.check_log()


def test_labware_that_a_discovered_action_touched_may_be_anywhere_on_its_way() -> None:
    lab = make_carried()
    item = lab.state.bench.labware[LabwareId("P1")]
    assert item.station == ""
    assert item.maybe == (place("a"), place("arm.gripper"), place("dev.n1"), "")
    assert all(must_describe(lab.state, place(name)) for name in ("a", "dev.n1"))
    assert not must_describe(lab.state, place("c"))
    # Another one took it further; both ways count.
    lab.do(hears(ARM, make_found("X2", make_move("P1", "dev.n1", "b"))))
    assert place("b") in lab.state.bench.labware[LabwareId("P1")].maybe
    assert place("a") in lab.state.bench.labware[LabwareId("P1")].maybe
    assert len(lab.questions("log_shorter")) == 1, "it is asked once"
    assert not any(isinstance(entry.event, ModuleTakenOut) for entry in lab.log)


def test_what_is_touched_cannot_be_confirmed_in_passing() -> None:
    lab = make_carried()
    refusal = lab.reject(ConfirmStations((place("c"), place("a")), "ada"))
    assert (refusal.code, "a" in refusal.message) == ("touched", True)
    assert place("c") in list_to_say(lab.state), "all of it or nothing"


def test_a_journal_that_does_not_say_what_was_moved_puts_its_workcell_in_doubt() -> None:
    lab = small(stock=3)
    lab.do(hears(DEV, FoundAction(ActionId("X1"), "spin", "finished")))
    assert all(must_describe(lab.state, name) for name in list_to_say(lab.state))
    strange = FoundAction(ActionId("X2"), "spin", "finished", 1, (make_move("P1", "a", "nowhere"),))
    other = small(stock=3)
    other.do(hears(DEV, strange))
    assert all(must_describe(other.state, name) for name in list_to_say(other.state)), (
        "an unknown station too"
    )


def test_a_module_that_was_told_of_more_has_forgotten_what_it_did() -> None:
    lab = small(stock=3)
    run = lab.submit(plan(step("dev")))
    lab.do(LoseNode(DEV, "i1", "restarted"))
    events = lab.do(JoinNode(DEV, "j", "i2", "driver", "1", "d", "IDLE", beyond=10**6))
    assert lab.pump() == []
    assert lab.code(run) == "log_shorter"
    assert all(must_describe(lab.state, name) for name in list_to_say(lab.state))
    (asked,) = [event for event in events if isinstance(event, InterventionRequested)]
    assert "position 1000000" in asked.text
    assert lab.state.shorter.known == 10**6
    lab.check_log()


def test_lids_and_doors_of_a_module_that_knows_more_are_not_known() -> None:
    lab = small(stock=3)
    lab.write(VariableSet(DEV, "lid", "open"))
    lab.do(hears(DEV, make_found("X1", needs("dev.n1"))))
    assert lab.state.modules.by_name[DEV].find_value("lid") is None


def test_a_position_that_no_log_can_have_come_to_is_not_believed() -> None:
    lab = small()
    lab.do(LoseNode(DEV, "i1", "restarted"))
    strange = FoundAction(ActionId("X1"), "spin", "finished", 2**70, (make_move("P" + "9" * 40, "a", "b"),))
    lab.do(JoinNode(DEV, "j", "i2", "driver", "1", "d", "IDLE", discovered=(strange,), beyond=2**62))
    assert lab.state.shorter.known == 0
    assert lab.state.bench.named < 10**6
    lab.check_log()


def test_labware_that_got_its_name_behind_the_end_keeps_it_for_itself() -> None:
    lab = small(stock=3)
    lab.do(hears(ARM, make_found("X1", Take(place("stack"), place("a"), labware=LabwareId("P7")))))
    say(lab, a="plate")
    assert lab.at("a") == ["P8"]


def test_other_evidence_needs_no_node() -> None:
    lab = small(stock=3)
    assert lab.do(ReportShorterLog(lab.state.position, "a checkpoint", lab.state.position)) == []
    lab.do(ReportShorterLog(5000, "a checkpoint", 400))
    assert lab.state.shorter.evidence == {"a checkpoint": "knows of a log up to position 5000"}
    assert (lab.state.shorter.known, lab.state.shorter.ended) == (5000, 400)
    assert lab.do(ReportShorterLog(5000, "a checkpoint", 400)) == [], "told again, it is written once"
    lab.do(ReportShorterLog(5100, "a side file", 400))
    assert lab.state.shorter.known == 5100
    confirm_rest(lab)
    answer(lab)
    run = lab.submit(plan(step("dev")))
    assert lab.pump() == [f"{run}#0"]


def test_a_log_that_was_put_back_asks_for_a_round() -> None:
    lab = small()
    lab.do(StartKernel(2, "0"))
    assert lab.questions() == []
    lab.do(StartKernel(2 + LEAP, "0"))
    assert "may be an older copy" in lab.question("log_shorter").text


def test_questions_of_earlier_versions_become_one_round() -> None:
    lab = small()
    for number, name in enumerate((DEV, ARM)):
        lab.write(ModuleTakenOut(name, "its journal knows an action"))
        old = InterventionRequested(f"I{number + 1}", "discovered_action", f"X{number}", "?", (), module=name)  # type: ignore[arg-type]
        old = msgspec.structs.replace(old, topic=DiscoveredAction(action=ActionId(f"X{number}"), module=name))
        lab.write(old)
    lab.do(StartKernel(2, "0"))
    assert [question.kind for question in lab.questions()] == ["log_shorter"]
    assert not any(module.out_of_service for module in lab.state.modules.by_name.values())
    assert all(must_describe(lab.state, name) for name in list_to_say(lab.state))
    lab.check_log()


# -- what still works, and what has to wait --------------------------------------------------------------


def test_a_reset_still_works_and_so_do_a_persons_words() -> None:
    lab = make_carried()
    reset = lab.submit(plan(step("dev", action="reset", recovers=True)))
    assert lab.pump() == [f"{reset}#0"]
    lab.do(LoadStation(place("c"), "plate", 1))
    lab.do(ObserveStation(place("hotel"), "ada", 0))
    lab.do(TakeOut(DEV, "service"))
    lab.do(CancelRun(next(iter(lab.state.runs.active))))


def test_an_action_that_the_log_knows_is_asked_about_first() -> None:
    """What it moved is said on the round afterwards, and counts."""
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(hears(ARM, make_found("X1", make_move("P1", "b", "dev.n1"))))
    lab.accept(action)
    assert lab.reject(SayContents(place("b"), "ada")).code == "in_motion"
    assert lab.reject(SayContents(place("dev.n1"), "ada", ("P1",))).code == "in_motion"
    lab.doubt(action)
    refusal = lab.reject(SayContents(place("dev.n1"), "ada", ("P1",)))
    assert (refusal.code, lab.question("unknown_action").id in refusal.remedy) == ("asked_first", True)
    lab.answer(lab.question("unknown_action"), "done")
    say(lab, b="", dev__n1="P1")
    assert lab.where("P1") == "dev.n1"
    lab.check_log()


def test_what_a_node_never_began_is_not_sent_again_on_a_bench_that_nobody_has_seen() -> None:
    """Behind the log's end another attempt may have been made."""
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(HearJournal(DEV, (), 10**6))
    lab.do(ResendAction(action, 1, "journal-arm"))
    assert lab.state.actions.open[action].status == "unknown"
    assert lab.do(RefuseAction(action, 1, "it was never started there", False)) == []
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.where("P1") == "b"
    assert lab.pump() == []
    lab.check_log()


def test_another_attempt_at_an_action_that_the_log_holds_is_evidence_too() -> None:
    lab = small(stock=3)
    action = lab.start(lab.submit(plan(step("dev"))))
    events = lab.do(hears(DEV, FoundAction(action, "act", "running", 900)))
    assert lab.state.shorter.known == 900
    assert "once more" in lab.question("log_shorter").text
    assert not any(event.TYPE == "action.discovered" for event in events)
    lab.finish(action)


def test_labware_that_is_worked_on_is_not_given_up() -> None:
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "dev.n1")), step("dev", needs("dev.n1"))))
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(hears(ARM, make_found("X1", make_move("P1", "dev.n1", "a"))))
    for name in list_to_say(lab.state):
        lab.ask(SayContents(name, "ada", ("plate",) * 2 if name == place("stack") else ()))
    refusal = lab.reject(ResolveIntervention(lab.question("log_shorter").id, "checked", "ada"))
    assert (refusal.code, "P1" in refusal.message) == ("in_motion", True)
    lab.finish(action)
    answer(lab)
    assert lab.state.bench.labware == {}
    lab.check_log()


def test_a_person_is_let_in_meanwhile() -> None:
    lab = make_carried()
    home = SubmitRun(plan(step("arm", action="home")), "ada")
    lab.do(RequestAccess("cell", "ada", parking=(home,)))
    assert lab.pump() == [], "no arm moves, not even out of the way"
    assert lab.state.lab.access["cell"].granted


def test_a_result_that_comes_late_does_not_say_where_labware_is_that_was_taken_further() -> None:
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(hears(ARM, make_found("X1", make_move("P1", "b", "dev.n1"))))
    lab.do(FinishAction(action, 1, True, "all"))
    item = lab.state.bench.labware[LabwareId("P1")]
    assert (item.station, place("dev.n1") in item.maybe) == ("", True)
    say(lab, a="", b="", dev__n1="P1")
    assert lab.where("P1") == "dev.n1"


def test_nobody_speaks_of_a_bench_on_which_something_moves_that_the_log_does_not_know() -> None:
    lab = make_carried()
    lab.do(ReportState(ARM, "BUSY"))
    refusal = lab.reject(SayContents(place("a"), "ada"))
    assert (refusal.code, "arm" in refusal.message) == ("in_motion", True)
    lab.do(ReportState(ARM, "IDLE"))
    say(lab, a="")


def test_evidence_that_comes_later_takes_back_what_was_said_there() -> None:
    lab = make_carried()
    say(lab, a="", dev__n1="P1")
    lab.do(hears(ARM, make_found("X2", make_move("P1", "dev.n1", "b"))))
    assert place("dev.n1") in list_to_say(lab.state)
    assert place("a") not in list_to_say(lab.state)
    lab.do(LoseNode(DEV, "i1", "restarted"))
    lab.do(JoinNode(DEV, "j", "i2", "driver", "1", "d", "IDLE", beyond=10**6))
    assert place("a") in list_to_say(lab.state)


def test_the_round_when_nobody_asked_for_it() -> None:
    lab = small()
    assert lab.reject(SayContents(place("a"), "ada")).code == "no_round"
    assert lab.reject(ConfirmStations((place("a"),), "ada")).code == "no_round"


# -- what is said -------------------------------------------------------------------------------------------


def test_labware_that_is_found_elsewhere_keeps_its_name_and_what_is_found_nowhere_is_gone() -> None:
    lab = make_carried()
    say(lab, c="P1")
    assert lab.where("P1") == "c"
    refusal = lab.reject(SayContents(place("hotel"), "ada", ("P1",)))
    assert refusal.code == "said_elsewhere"
    say(lab, c="")
    say(lab, hotel="P1")
    assert lab.where("P1") == "hotel"
    say(lab, hotel="plate")
    assert lab.at("hotel") == ["P2"]
    for name in list_to_say(lab.state):
        lab.do(SayContents(name, "ada", ("plate",) * 3 if name == place("stack") else ()))
    answer(lab)
    assert list(lab.state.bench.labware) == ["P2"]
    lab.check_log()


def test_a_stack_is_counted_and_a_waste_too() -> None:
    lab = make_carried()
    say(lab, stack="plate", trash="x x")
    assert lab.state.bench.stations[place("stack")].stock == ["plate"]
    assert lab.state.bench.stations[place("trash")].level == 2
    assert lab.reject(SayContents(place("stack"), "ada", ("P1", "plate"))).code == "buried"


@pytest.mark.parametrize(
    ("station", "words", "code"),
    [
        ("a", ("plate", "plate"), "too_many"),
        ("hotel", ("P1", "P1"), "twice"),
        ("nowhere", (), "no_station"),
    ],
)
def test_what_cannot_be_said(station: str, words: tuple[str, ...], code: str) -> None:
    lab = make_carried()
    assert lab.reject(SayContents(place(station), "ada", words)).code == code


def test_a_question_about_labware_is_answered_by_the_round() -> None:
    lab = small(stock=3)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    lab.fail(lab.start(run, 1))
    lab.do(hears(ARM, make_found("X1", make_move("P1", "a", "c"))))
    lost = lab.question("lost_labware")
    events = lab.do(SayContents(place("c"), "ada", ("P1",)))
    assert any(isinstance(e, InterventionResolved) and e.intervention == lost.id for e in events)
    assert lab.where("P1") == "c"
    lab.check_log()


def test_an_action_that_nobody_knows_the_effects_of_is_told_once() -> None:
    lab = make_carried()
    again = make_found("X1", make_move("P1", "a", "dev.n1"))
    assert lab.do(hears(ARM, again)) == []
    assert lab.do(hears(ARM, msgspec.structs.replace(again, status="running"))) == []
    run = lab.submit(plan(step("dev", Needs(place("dev.n1")))))
    assert lab.pump() == []
    assert lab.code(run) == "log_shorter"


def test_evidence_that_a_round_has_answered_is_not_asked_about_again() -> None:
    """A node that stays away is heard of at each start, by its journal."""
    lab = small(stock=3)
    lab.do(HearJournal(ARM, (), 10**6))
    for name in list_to_say(lab.state):
        stock = ("plate",) * 3 if name.endswith("stack") else ()
        lab.do(SayContents(name, "ada", stock))
    answer(lab)
    assert lab.do(HearJournal(ARM, (), 10**6)) == []
    assert lab.do(HearJournal(ARM, (), 2 * 10**6)) != []
    lab.check_log()
