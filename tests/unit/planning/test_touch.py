"""Which waits an event may end."""

from __future__ import annotations

from labos.core.registry import TYPES
from labos.core.state import LabState
from labos.planning.touch import EVERYTHING, cell_key, find_touched_keys
from tests.support.bench import move, needs, plan, requires, route, sets, small, step
from tests.unit.core.test_registry import EXAMPLES


def test_every_event_has_an_answer_even_where_nothing_is_known() -> None:
    for example in EXAMPLES:
        keys = find_touched_keys(LabState(), example)
        assert isinstance(keys, tuple)
        assert all(isinstance(key, str) for key in keys)
    assert len(EXAMPLES) == len(TYPES)


def test_a_labware_in_motion_touches_both_ends_and_what_it_held() -> None:
    lab = small()
    lab.step(lab.submit(route("stack", "dev.n1")))
    run = lab.submit(plan(*route("dev.n1", "a").steps, step("cam")))
    lab.keys.clear()
    action = lab.start(run)
    assert cell_key("cell") in lab.keys, "what is in flight counts as done"
    lab.keys.clear()
    lab.finish(action)
    assert {"station:cell/dev.n1", "station:cell/a", "module:cell/dev"} <= lab.keys
    assert {"module:cell/arm", "run:R2"} <= lab.keys
    assert EVERYTHING not in lab.keys


def test_a_regrip_station_that_is_free_again_wakes_who_waits_for_it() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.submit(plan(step("arm", move("a", "b", via="c")), step("cam")))
    waiting = lab.submit(route("stack", "c", arm="arm2"))
    assert lab.pump() == ["R1#0"]
    lab.finish("A1")
    assert f"{waiting}#0" in lab.pump()
    assert lab.find_missed() == []


def test_work_on_labware_at_another_modules_station_wakes_who_waits_for_that_module() -> None:
    lab = small()
    lab.stock("cam.nest", 1)
    lab.submit(plan(step("dev", needs("cam.nest")), step("dev")))
    waiting = lab.submit(plan(step("cam")))
    assert lab.pump() == ["R1#0"]
    assert lab.code(waiting) == "reached_into"
    lab.finish("A1")
    assert f"{waiting}#0" in lab.pump()


def test_variables_and_levels_wake() -> None:
    lab = small()
    closed = lab.submit(plan(step("dev", requires("lid", "shut"))))
    lab.pump()
    assert lab.code(closed) == "requires"
    lab.submit(plan(step("dev", sets("lid", "shut"))))
    assert lab.pump() == ["R2#0"]
    lab.finish("A1")
    assert lab.pump() == ["R1#0"]


def test_an_answer_wakes_who_waits_for_a_stack_that_is_looked_at() -> None:
    lab = small()
    lab.fail(lab.start(lab.submit(route("stack", "a"))))
    lab.submit(route("stack", "b", arm="arm2"))
    assert lab.pump() == []
    lab.answer(lab.question("lost_labware"), "source")
    assert lab.pump() == ["R2#0"]
