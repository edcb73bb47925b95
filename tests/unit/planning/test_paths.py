"""Plans as motions only."""

from __future__ import annotations

import pytest

from labos.core.ids import StationName
from labos.planning.paths import CellRules, make_path
from tests.support.bench import move, needs, plan, relid, step, take


def test_what_carries_labware_or_needs_a_module_for_itself_is_a_motion() -> None:
    what = plan(
        step("arm", take("stack", "a")),
        step("dev", needs()),
        step("arm", move("a", "b", via="c")),
    )
    path = make_path(what)
    assert [(m.step, m.source, m.target, m.via, m.new, m.uses) for m in path.motions] == [
        (0, "cell/stack", "cell/a", "", True, "cell/arm"),
        (1, "", "", "", False, "cell/dev"),
        (2, "cell/a", "cell/b", "cell/c", False, "cell/arm"),
    ]
    assert [(m.stands, m.room, m.emptied, m.filled) for m in path.motions] == [
        ((), ("cell/a",), "cell/stack", "cell/a"),
        ((), (), "", ""),
        (("cell/a",), ("cell/b", "cell/c"), "cell/a", "cell/b"),
    ]


def test_a_step_on_a_module_with_a_deck_needs_it_free_of_others_unless_the_run_holds_it() -> None:
    what = plan(
        step("dev"),
        step("arm", take("stack", "dev.n")),
        step("dev", needs()),
        step("arm", move("dev.n", "a")),
        step("dev"),
        step("dev", exclusive=False),
        step("cam"),
    )
    rules = CellRules({StationName("cell/dev.n"): "cell/dev"})
    motions = make_path(what, rules).motions
    assert [(motion.step, motion.uses) for motion in motions] == [
        (0, "cell/dev"),
        (1, "cell/arm"),
        (3, "cell/arm"),
        (4, "cell/dev"),
        (6, "cell/cam"),
    ]


def test_motions_stand_in_an_order_that_is_allowed() -> None:
    what = plan(
        step("arm", move("b", "c"), after=(2,)),
        step("arm", move("c", "d"), after=(0,)),
        step("arm", take("stack", "b")),
        parallel=True,
    )
    assert [motion.step for motion in make_path(what).motions] == [2, 0, 1]


def test_steps_that_wait_for_each_other_have_no_order() -> None:
    with pytest.raises(ValueError, match="wait for each other"):
        make_path(plan(step("dev", after=(1,)), step("dev", after=(0,))))


def test_all_that_a_step_needs_is_asked_before_any_of_it_is_done() -> None:
    """Two pieces off one hotel are needed at once, and where one comes to the other must have gone before."""
    first, second = make_path(plan(step("arm", move("hotel", "a"), move("hotel", "hotel2")))).motions
    assert first.stands == ("cell/hotel", "cell/hotel")
    assert first.room == ("cell/a", "cell/hotel2")
    assert (second.stands, second.room) == ((), ())
    (put_on, _) = make_path(plan(step("arm", relid("lids", "a"), move("a", "b")))).motions
    assert put_on.stands == ("cell/a", "cell/lids")
