"""The life of an action: every end it may come to, known or not, early or late."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.core.actions import ENDED_KEPT, SETTLED_KEPT, ActionReconciled
from labos.core.actions import fold_action_reconciled as fold_reconciled
from labos.core.decide.actions import AcceptAction, DoubtAction, FinishAction, RefuseAction, ResendAction
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.interventions import ResolveIntervention
from labos.core.ids import ActionId
from labos.core.modules import Variable
from labos.core.runs import DONE, FAILED, IN_FLIGHT, PENDING, UNKNOWN
from tests.support.bench import (
    Driver,
    consumes,
    move,
    needs,
    plan,
    requires,
    route,
    sets,
    small,
    step,
    take,
)


def start_carrying(more: int = 1) -> tuple[Driver, ActionId]:
    """A run whose plate is on its way from a to b; ``more`` steps follow."""
    lab = small()
    steps = [step("arm", take("stack", "a")), step("arm", move("a", "b")), *[step("cam")] * more]
    run = lab.submit(plan(*steps))
    lab.step(run)
    return lab, lab.start(run, 1)


def find_last_type(lab: Driver) -> str:
    return lab.log[-1].event.TYPE


# -- asking -----------------------------------------------------------------------------------------


def test_a_request_names_everything_and_reserves() -> None:
    lab, action = start_carrying()
    event = lab.log[-1].event
    assert event.TYPE == "action.requested"
    assert (event.attempt, event.epoch, event.journal) == (1, 1, "journal-cell/arm")  # type: ignore[attr-defined]
    assert event.effects[0].labware == "P1"  # type: ignore[attr-defined]
    bench = lab.state.bench
    assert bench.stations["cell/b"].expected == 1  # type: ignore[index]
    assert bench.labware["P1"].moving == action  # type: ignore[index]
    assert lab.state.modules.by_name["cell/arm"].busy  # type: ignore[index]
    assert lab.run("R1").steps[1].status == IN_FLIGHT


def test_accepting_is_recorded_once() -> None:
    lab, action = start_carrying()
    assert lab.do(AcceptAction(action, 2, lab.now)) == []
    assert [e.TYPE for e in lab.accept(action)] == ["action.accepted"]
    assert lab.accept(action) == []
    assert lab.do(AcceptAction(ActionId("A9"), 1, lab.now)) == []


def test_a_query_does_not_occupy_its_module() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", exclusive=False), step("dev", exclusive=False), parallel=True))
    other = lab.submit(plan(step("dev")))
    lab.start(run, 0)
    lab.start(run, 1)
    assert not lab.state.modules.by_name["cell/dev"].busy  # type: ignore[index]
    lab.start(other)


# -- the node refuses -------------------------------------------------------------------------------


def test_a_final_refusal_fails_the_run() -> None:
    lab, action = start_carrying()
    lab.refuse(action)
    assert find_last_type(lab) == "run.failed"
    assert lab.where("P1") == "a"
    assert lab.state.bench.stations["cell/b"].expected == 0  # type: ignore[index]
    assert lab.refuse(action) == []


def test_a_transient_refusal_waits_until_the_module_says_idle_again() -> None:
    lab, action = start_carrying()
    lab.refuse(action, final=False)
    assert lab.run("R1").steps[1].status == PENDING
    assert lab.code("R1", 1) == "module_busy"
    assert lab.do(RefuseAction(action, 1, "no", False)) == []
    assert lab.owner("P1") == "run:R1"


def test_a_refused_action_of_a_cancelled_run_ends_it() -> None:
    lab, action = start_carrying()
    lab.do(CancelRun(lab.run("R1").id))
    lab.refuse(action, final=False)
    assert find_last_type(lab) == "run.cancelled"


def test_a_refusal_of_another_attempt_says_nothing() -> None:
    lab, action = start_carrying()
    assert lab.do(RefuseAction(action, 2, "no")) == []


def test_a_refusal_after_doubt_takes_question_and_uncertainty_back() -> None:
    """Else nobody could ever find the plate again: the answer would meet no open action."""
    lab, action = start_carrying()
    lab.doubt(action)
    lab.refuse(action, final=False)
    assert lab.questions() == []
    assert lab.state.bench.uncertain_at == {}
    assert lab.where("P1") == "a"
    lab.check_log()


# -- it succeeds ------------------------------------------------------------------------------------


def test_success_moves_and_goes_on() -> None:
    lab, action = start_carrying()
    lab.accept(action)
    lab.finish(action)
    assert lab.where("P1") == "b"
    assert lab.state.bench.labware["P1"].moving == ""  # type: ignore[index]
    assert lab.finish(action) == []
    lab.step("R1", 2)
    assert find_last_type(lab) == "run.completed"
    assert lab.state.bench.reserved == {}
    lab.check_log()


def test_all_effects_take_place() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(
        plan(
            step("arm", move("a", "dev.n1")),
            step(
                "dev",
                needs(),
                requires("sealed", False, "labware"),
                sets("sealed", True, "labware"),
                sets("lid", "closed"),
                consumes("tips", 4.0),
            ),
            step("arm", move("dev.n1", "trash")),
        )
    )
    lab.step(run)
    lab.step(run, 1)
    assert lab.state.bench.labware["P1"].variables == {"sealed": True}  # type: ignore[index]
    dev = lab.state.modules.by_name["cell/dev"]  # type: ignore[index]
    assert (dev.variables, [*dev.list_away_from_rest()]) == ({"lid": Variable("closed", "R1")}, ["lid"])
    assert lab.state.resources.find_left("cell/dev", "tips") == 6.0  # type: ignore[arg-type]
    assert lab.code(run, 2) == "no_access"


def test_an_action_may_change_labware_and_throw_it_away() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(step("arm", move("a", "trash"), sets("sealed", False, "labware"))))
    lab.step(run)
    assert lab.state.bench.labware == {}
    assert lab.state.bench.by_owner == {}
    assert find_last_type(lab) == "run.completed"


def test_variables_of_labware_that_the_action_does_not_name_are_nobodys() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", requires("x", 1, "labware"), sets("sealed", True, "labware"))))
    lab.step(run)
    assert "labware.changed" not in lab.types()


# -- it fails ---------------------------------------------------------------------------------------


def test_failed_with_nothing_done() -> None:
    lab, action = start_carrying()
    lab.fail(action, "none")
    assert lab.where("P1") == "a"
    assert find_last_type(lab) == "run.failed"
    assert [q.kind for q in lab.questions()] == ["failed_run"]
    assert "arm could not 'act': jam" in lab.log[-1].event.why  # type: ignore[attr-defined]


def test_failed_with_everything_done() -> None:
    lab, action = start_carrying()
    lab.fail(action, "all")
    assert lab.where("P1") == "b"
    assert "P1 at b" in lab.question("failed_run").text


@pytest.mark.parametrize(("effects", "kind"), [("all", "failed_run"), ("unknown", "lost_labware")])
def test_a_reason_that_is_a_sentence_ends_in_one_full_stop(effects: str, kind: str) -> None:
    lab, action = start_carrying()
    lab.fail(action, effects, "It stands askew. Teach the place again.")
    text = lab.question(kind).text
    assert "Teach the place again. " in text
    assert ".." not in text


@pytest.mark.parametrize("effects", ["partial", "unknown"])
def test_failed_half_way_loses_the_labware_and_asks(effects: str) -> None:
    lab, action = start_carrying()
    lab.fail(action, effects)
    labware = lab.state.bench.labware["P1"]  # type: ignore[index]
    assert labware.station == ""
    assert labware.maybe == ("cell/a", "cell/arm.gripper", "cell/b")
    assert labware.owner == "user:ada"
    question = lab.question("lost_labware")
    assert sorted(c.name for c in question.choices) == ["gone", "source", "target"]
    assert lab.questions("failed_run") == []


def test_a_regrip_station_is_one_of_the_places() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(step("arm", move("a", "b", via="c"))))
    lab.fail(lab.start(run))
    assert lab.state.bench.labware["P1"].maybe == ("cell/a", "cell/arm.gripper", "cell/c", "cell/b")  # type: ignore[index]


@pytest.mark.parametrize(("choice", "place"), [("source", "a"), ("target", "b"), ("gone", None)])
def test_a_person_finds_lost_labware(choice: str, place: str | None) -> None:
    lab, action = start_carrying()
    lab.fail(action)
    lab.answer(lab.question("lost_labware"), choice)
    if place is None:
        assert lab.state.bench.labware == {}
    else:
        assert lab.where("P1") == place
    assert lab.state.bench.uncertain_at == {}
    lab.check_log()


def test_where_lost_labware_may_be_nobody_puts_anything_and_its_arm_takes_nothing() -> None:
    lab, action = start_carrying()
    lab.fail(action)
    lab.stock("c", 1)
    for source, target in [("c", "a"), ("c", "b")]:
        assert lab.code(lab.submit(route(source, target, arm="arm2"))) == "uncertain"
    assert lab.code(lab.submit(route("c", "hotel"))) == "uncertain"
    assert lab.code(lab.submit(route("c", "hotel", arm="arm2"))) == ""
    assert lab.code(lab.submit(route("stack", "hotel"))) == "uncertain"
    assert lab.code(lab.submit(plan(step("arm")))) == ""


@pytest.mark.parametrize("effects", ["partial", "unknown"])
@pytest.mark.parametrize("choice", ["source", "target", "gone"])
def test_what_came_half_off_a_stack_is_looked_for_too(effects: str, choice: str) -> None:
    """Until somebody has looked, nobody takes from the stack or puts anything in its place."""
    lab = small(stock=1)
    run = lab.submit(route("stack", "a"))
    lab.fail(lab.start(run), effects)
    assert lab.code(lab.submit(route("stack", "hotel", arm="arm2"))) == "uncertain"
    lab.stock("c", 1)
    assert lab.code(lab.submit(route("c", "a", arm="arm2"))) == "uncertain"
    lab.keep_picture()
    lab.answer(lab.question("lost_labware"), choice)
    assert lab.state.bench.uncertain_at == {}
    assert lab.state.bench.searched == {}
    stack = lab.state.bench.stations["cell/stack"]  # type: ignore[index]
    assert len(stack.stock) == (1 if choice == "source" else 0)
    assert len(lab.at("a")) == (1 if choice == "target" else 0)
    lab.check_log()


def test_of_a_failed_action_variables_are_unknown_and_consumption_is_counted() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(
        plan(
            step(
                "dev",
                needs("a"),
                sets("lid", "closed"),
                sets("sealed", True, "labware"),
                consumes("tips", 4.0),
            )
        )
    )
    lab.fail(lab.start(run), "partial")
    assert lab.state.modules.by_name["cell/dev"].values == {"lid": None}  # type: ignore[index]
    assert lab.state.bench.labware["P1"].variables == {"sealed": None}  # type: ignore[index]
    assert lab.state.resources.find_left("cell/dev", "tips") == 6.0  # type: ignore[arg-type]


def test_a_failed_action_that_did_nothing_uses_nothing() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", sets("lid", "closed"), consumes("tips", 4.0))))
    lab.fail(lab.start(run), "none")
    assert lab.state.resources.find_left("cell/dev", "tips") == 10.0  # type: ignore[arg-type]
    assert lab.state.modules.by_name["cell/dev"].values == {"lid": "open"}  # type: ignore[index]


def parallel() -> tuple[Driver, ActionId, ActionId]:
    lab = small()
    run = lab.submit(
        plan(step("dev"), step("arm", take("stack", "a")), step("cam", after=(0, 1)), parallel=True)
    )
    return lab, lab.start(run, 0), lab.start(run, 1)


def test_a_run_that_has_failed_waits_for_its_other_step() -> None:
    lab, first, second = parallel()
    lab.fail(first, "none")
    assert find_last_type(lab) == "run.cancelling"
    assert lab.run("R1").statuses == [FAILED, IN_FLIGHT, PENDING]
    lab.finish(second)
    assert find_last_type(lab) == "run.failed"
    assert lab.log[-1].event.why == "dev could not 'act': jam"  # type: ignore[attr-defined]
    assert lab.owner("P1") == "user:ada"
    lab.check_log()


def test_both_steps_fail_and_the_first_reason_counts() -> None:
    lab, first, second = parallel()
    lab.fail(first, "none", "first")
    lab.fail(second, "none", "second")
    assert find_last_type(lab) == "run.failed"
    assert "first" in lab.log[-1].event.why  # type: ignore[attr-defined]
    lab.check_log()


def test_a_cancelled_run_that_then_fails_has_failed() -> None:
    lab, first, second = parallel()
    lab.do(CancelRun(lab.run("R1").id))
    lab.fail(first, "none", "first")
    lab.finish(second)
    assert find_last_type(lab) == "run.failed"


# -- nobody knows -----------------------------------------------------------------------------------


def test_doubt_asks_with_concrete_choices() -> None:
    lab, action = start_carrying()
    lab.doubt(action)
    assert lab.doubt(action) == []
    assert lab.do(DoubtAction(ActionId("A9"), "x")) == []
    question = lab.question("unknown_action")
    assert [c.name for c in question.choices] == ["done", "not_done", "gone"]
    assert "P1 may be at: a, arm.gripper, b" in question.text
    assert lab.run("R1").steps[1].status == UNKNOWN
    assert lab.state.bench.uncertain_at == {"cell/a": 1, "cell/arm.gripper": 1, "cell/b": 1}


@pytest.mark.parametrize(
    ("choice", "place", "step_after", "end"),
    [("done", "b", DONE, ""), ("not_done", "a", PENDING, ""), ("gone", None, None, "run.failed")],
)
def test_each_answer_about_a_move(choice: str, place: str | None, step_after: int | None, end: str) -> None:
    lab, action = start_carrying()
    lab.doubt(action)
    lab.keep_picture()
    lab.answer(lab.question("unknown_action"), choice)
    assert lab.state.bench.uncertain_at == {}
    assert lab.state.bench.stations["cell/b"].expected == 0  # type: ignore[index]
    if place is not None:
        assert lab.where("P1") == place
        assert lab.run("R1").steps[1].status == step_after
        assert lab.code("R1", 2 if choice == "done" else 1) == ""
    else:
        assert lab.state.bench.labware == {}
        assert find_last_type(lab) == end
        assert "was spoilt (person-1)" in lab.log[-1].event.why  # type: ignore[attr-defined]
    lab.check_log()


@pytest.mark.parametrize("choice", ["done", "not_done", "gone"])
def test_each_answer_about_a_take(choice: str) -> None:
    lab = small(stock=1)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("cam")))
    action = lab.start(run)
    lab.doubt(action)
    assert lab.code(lab.submit(route("stack", "b", arm="arm2"))) == "stack_empty"
    lab.answer(lab.question(), choice)
    assert len(lab.state.bench.stations["cell/stack"].stock) == (1 if choice == "not_done" else 0)  # type: ignore[index]
    assert lab.at("a") == (["P1"] if choice == "done" else [])
    if choice == "gone":
        assert lab.state.bench.labware == {}
        assert find_last_type(lab) == "run.failed"
    lab.check_log()


@pytest.mark.parametrize("choice", ["done", "not_done", "gone"])
def test_each_answer_about_an_action_that_carries_nothing(choice: str) -> None:
    lab = small()
    run = lab.submit(plan(step("dev", sets("lid", "closed")), step("cam")))
    lab.doubt(lab.start(run))
    assert "may be at" not in lab.question().text
    lab.answer(lab.question(), choice)
    lid = lab.state.modules.by_name["cell/dev"].find_value("lid")  # type: ignore[index]
    assert lid == ("closed" if choice == "done" else "open")
    assert (find_last_type(lab) == "run.failed") == (choice == "gone")


def test_a_done_answer_to_the_last_step_completes_the_run() -> None:
    lab, action = start_carrying(more=0)
    lab.doubt(action)
    lab.answer(lab.question(), "done")
    assert find_last_type(lab) == "run.completed"
    assert lab.owner("P1") == "user:ada"
    lab.check_log()


@pytest.mark.parametrize(
    ("succeeded", "effects", "place"),
    [(True, "all", "b"), (False, "all", "b"), (False, "none", "a"), (False, "unknown", "")],
)
def test_the_node_answers_before_the_person(succeeded: bool, effects: Any, place: str) -> None:
    lab, action = start_carrying()
    lab.doubt(action)
    lab.do(FinishAction(action, 1, succeeded, effects, error="jam"))
    assert lab.questions("unknown_action") == []
    assert lab.where("P1") == place
    assert bool(lab.state.bench.uncertain_at) == (place == "")
    lab.check_log()


@pytest.mark.parametrize(
    ("choice", "succeeded", "effects", "contradicts"),
    [
        ("done", True, "all", False),
        ("not_done", False, "none", False),
        ("not_done", True, "all", True),
        ("done", False, "unknown", True),
    ],
)
def test_a_result_after_the_answer_is_evidence(
    choice: str, succeeded: bool, effects: Any, contradicts: bool
) -> None:
    lab, action = start_carrying()
    lab.doubt(action)
    lab.answer(lab.question(), choice)
    late = FinishAction(action, 1, succeeded, effects, error="late")
    events = lab.do(late)
    assert [e.TYPE for e in events] == ["action.evidence", *["intervention.requested"] * contradicts]
    assert lab.do(late) == []
    if contradicts:
        question = lab.question("contradiction")
        assert question.module == "cell/arm"
        lab.answer(question, "checked")
        assert lab.questions() == []
    lab.check_log()


def test_a_result_that_comes_twice_says_nothing() -> None:
    lab, action = start_carrying()
    lab.finish(action)
    assert lab.do(FinishAction(action, 1, False, "unknown")) == []


def test_a_result_out_of_another_journal_ends_nothing() -> None:
    """The request was meant for one journal: whoever else answers was not asked."""
    lab, action = start_carrying()
    for journal, attempt in (("journal-cell/cam", 1), ("forged", 1), ("journal-cell/arm", 2), ("forged", 0)):
        said = FinishAction(action, attempt, True, "all", journal=journal)
        assert lab.reject(said).code == ("no_attempt" if attempt != 1 else "other_journal")
    assert lab.state.bench.labware["P1"].moving == action  # type: ignore[index]
    lab.do(FinishAction(action, 1, True, "all", journal="journal-cell/arm"))
    assert lab.where("P1") == "b"
    lab.check_log()


# -- again -------------------------------------------------------------------------------------------


def test_an_attempt_that_can_never_run_is_followed_by_the_next() -> None:
    lab, action = start_carrying()
    assert lab.do(ResendAction(action, 2, "j")) == []
    lab.do(ResendAction(action, 1, "other journal"))
    known = lab.state.actions.open[action]
    assert (known.attempt, known.journal) == (2, "other journal")
    assert lab.state.bench.stations["cell/b"].expected == 1  # type: ignore[index]
    assert lab.do(AcceptAction(action, 1, lab.now)) == []
    lab.accept(action)
    assert lab.do(ResendAction(action, 2, "j")) == []
    lab.finish(action)
    assert lab.where("P1") == "b"
    assert lab.state.bench.stations["cell/b"].expected == 0  # type: ignore[index]
    lab.check_log()


def test_an_attempt_that_never_ran_ends_a_cancelled_run() -> None:
    lab, action = start_carrying()
    lab.do(CancelRun(lab.run("R1").id))
    lab.do(ResendAction(action, 1, "j"))
    assert find_last_type(lab) == "run.cancelled"
    assert lab.where("P1") == "a"
    assert lab.state.bench.stations["cell/b"].expected == 0  # type: ignore[index]
    lab.check_log()


def test_the_last_ended_and_settled_actions_are_remembered_within_bounds() -> None:
    lab, action = start_carrying()
    actions = lab.state.actions
    pattern = actions.open[action]
    for number in range(SETTLED_KEPT + 5):
        name = ActionId(f"X{number}")
        actions.open[name] = msgspec.structs.replace(pattern, id=name)
        fold_reconciled(actions, ActionReconciled(name, pattern.run, 1, pattern.module, 1, "all", "x"), 0)
    assert len(actions.settled) == SETTLED_KEPT
    assert len(actions.ended[pattern.module]) == ENDED_KEPT
    assert "X0" not in actions.settled


def test_a_result_that_is_too_large_to_record_is_replaced_by_its_size() -> None:
    """Else its node would tell it for ever, and the kernel refuse it for ever."""
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev"), feeds=(0,)))
    lab.finish(lab.start(run), {"image": "x" * 70_000})
    assert lab.state.actions.open == {}
    assert lab.results(run) == {0: {"$too_large": 70_012}}


def test_a_person_who_says_that_it_was_done_says_what_later_steps_read_of_it() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev", args={"v": {"$result": [0, "od"]}}), feeds=(0,)))
    lab.doubt(lab.start(run))
    question = lab.question()
    done = ResolveIntervention(question.id, "done", "person-1")
    assert lab.reject(done).code == "result_needed"
    assert lab.reject(msgspec.structs.replace(done, result="x" * 60_000)).code == "too_large"
    lab.do(msgspec.structs.replace(done, result={"od": 0.4}))
    lab.start(run, 1)
    assert lab.state.actions.open["A2"].args == {"v": 0.4}


def test_files_of_earlier_steps_go_to_a_later_one_by_name_and_digest() -> None:
    def make_reference(index: int) -> dict[str, object]:
        return {"$result": [index, "picture"], "$file": True}

    lab = small()
    both = step(
        "dev",
        args={"one": make_reference(0), "two": make_reference(1), "n": {"$result": [0, "picture", "bytes"]}},
    )
    run = lab.submit(plan(step("dev"), step("dev"), both, feeds=(0, 1)))
    for index in (0, 1):
        seen = {"file": "p.png", "sha256": str(index) * 64, "bytes": 9}
        lab.finish(lab.start(run, index), {"picture": {"the only one": seen} if index else seen})
    lab.start(run, 2)
    action = lab.state.actions.open["A3"]
    assert action.args == {"one": "p.png", "two": "two-p.png", "n": 9}
    assert action.files == {"p.png": "0" * 64, "two-p.png": "1" * 64}
    lab.check_log()


def test_a_returned_file_named_as_one_of_the_plan_gets_another_name() -> None:
    lab = small()
    args = {"protocol": "p.py", "seen": {"$result": [0], "$file": True}}
    submitted = plan(
        step("dev"), step("dev", args=args), feeds=(0,), files={"p.py": "a" * 64, "q.py": "c" * 64}
    )
    run = lab.submit(submitted)
    lab.finish(lab.start(run), {"picture": {"file": "p.py", "sha256": "b" * 64, "bytes": 9}})
    action = lab.state.actions.open[lab.start(run, 1)]
    assert action.args == {"protocol": "p.py", "seen": "seen-p.py"}
    assert action.files == {"p.py": "a" * 64, "seen-p.py": "b" * 64}
    lab.check_log()


def test_what_is_no_file_is_not_given_for_one() -> None:
    lab = small()
    last = step("dev", args={"file": {"$result": [0], "$file": True}})
    run = lab.submit(plan(step("dev", key="first"), last, feeds=(0,)))
    lab.finish(lab.start(run), {"file": "p.png"})
    lab.do(lab.start_command(run, 1))
    assert lab.types()[-1] == "run.failed"
    assert "file: the result of step 'first' is not a file" in str(lab.log[-1])


def test_a_slot_that_the_device_reports_is_the_labwares_and_fills_in_arguments() -> None:
    lab = small()
    run = lab.submit(
        plan(
            step("arm", take("stack", "a")),
            step("arm", move("a", "hotel"), sets("slot", "{result.slot}", "labware")),
            step("arm", move("hotel", "b"), args={"slot": "{labware.slot}", "n": 1}),
        )
    )
    lab.step(run)
    lab.step(run, 1, {"slot": "s7"})
    assert lab.state.bench.labware["P1"].variables == {"slot": "s7"}  # type: ignore[index]
    action = lab.start(run, 2)
    assert lab.state.actions.open[action].args == {"slot": "s7", "n": 1}


@pytest.mark.parametrize(("collided", "kind"), [(False, "software"), (True, "operational")])
def test_a_collision_is_an_operational_error(collided: bool, kind: str) -> None:
    lab = small()
    run = lab.submit(route("stack", "a"))
    action = lab.start(run, 0)
    lab.fail(action, "none", "it has hit something", collided=collided)
    ends = {entry.event.TYPE: entry.event for entry in lab.log}
    assert ends["action.failed"].kind == kind  # type: ignore[attr-defined]
    assert ends["run.failed"].kind == kind  # type: ignore[attr-defined]
