"""The account of a lab, what runs waited for, and how many copies a bench takes."""

from __future__ import annotations

import msgspec
import pytest

from labos.errors import Refused
from labos.services.capacity import CAP, measure_capacity
from labos.services.summary import measure_union_ns, summarise
from labos.spec import compile_workflow, find_spec, parse_workflow
from tests.simulation import mixes
from tests.unit.services.logbook import Logbook, two_users

CELL = mixes.CELL.workcell
STOCK = [(item.station, item.labware, item.count) for item in mixes.CELL.bench.stock]


def test_the_account_of_two_users() -> None:
    summary = summarise(two_users().records, two_users().clock.now)
    first, second = summary.runs
    assert (first.status, first.done, first.steps) == ("completed", 14, 14)
    assert (first.queued_s, first.wall_s, first.working_s, first.waiting_s) == (10, 140, 140, 0)
    assert first.lab_s == 1400
    assert first.step_s == (10.0,) * 14
    assert (second.queued_s, second.wall_s, second.working_s, second.waiting_s) == (200, 100, 50, 50)
    assert sum(wait.seconds for wait in second.waits) == pytest.approx(250, abs=1)
    assert [(u.name, u.runs, u.completed, u.actions) for u in summary.users] == [
        ("ada", 1, 1, 14),
        ("bo", 1, 0, 5),
    ]
    assert summary.users[0].lab_s == 1400
    modules = {module.name: module for module in summary.modules}
    assert modules["rpl/pf400"].actions == 8
    assert modules["rpl/pf400"].busy_s == 80
    assert modules["rpl/pf400"].utilisation == pytest.approx(80 / summary.wall_s)
    assert summary.twh.lab.interventions == 0


def test_reasons_are_charged_with_the_time_they_held() -> None:
    """R2 is submitted while R1's plate stands at the exchange."""
    book = Logbook()
    book.furnish()
    book.submit("pcr", "ada")
    book.step("R1", 0, until=10)
    book.submit("pcr", "bo")
    book.at(70)
    book.step("R1", 1, until=90)
    run = summarise(book.records).runs[1]
    assert run.waits[0].why == "sciclops.exchange is occupied by P1"
    assert run.waits[0].seconds == 60
    assert sum(wait.seconds for wait in run.waits) == 80


def test_an_action_under_way_counts_up_to_now() -> None:
    book = Logbook()
    book.furnish()
    book.submit("pcr")
    book.start("R1", 0)
    book.at(30)
    summary = summarise(book.records, book.clock.now)
    assert summary.modules[0].busy_s == summary.runs[0].working_s == 30


def test_an_empty_log_has_an_empty_account() -> None:
    summary = summarise([])
    assert (summary.events, summary.runs, summary.modules, summary.wall_s) == (0, (), (), 0)


def test_overlapping_times_count_once() -> None:
    assert measure_union_ns([(0, 10), (5, 20), (30, 40), (32, 35)]) == 30
    assert measure_union_ns([]) == 0


def copies_of(name: str) -> tuple[int, str]:
    path = find_spec("workflows", name)
    compiled = compile_workflow(
        path, mixes.PAYLOADS[name], CELL, mixes.DESCRIPTIONS, simulate=True, bench=mixes.CELL.bench
    )
    found = measure_capacity(CELL, STOCK, compiled.plan, compiled.inputs)
    return found.copies, found.why


def test_how_many_copies_may_be_under_way() -> None:
    copies, why = copies_of("pcr")
    # One each at exchange, OT-2, sealer, thermocycler, peeler and camera; the output takes the rest.
    assert copies == 6
    assert why.startswith("sciclops.exchange is occupied by")
    assert copies_of("cp_trashplate")[0] == 1
    assert 1 <= copies_of("cp_mixcolor")[0] <= CAP


def test_a_workflow_that_moves_nothing_is_limited_by_its_module() -> None:
    text = """
labos: 1
name: look
steps:
  - {name: Look, module: camera_module, action: take_picture, args: {file_name: a.jpg}}
  - {name: Look again, module: camera_module, action: take_picture, args: {file_name: b.jpg}}
"""
    compiled = compile_workflow(parse_workflow(text), {}, CELL, mixes.DESCRIPTIONS, simulate=True)
    found = measure_capacity(CELL, STOCK, compiled.plan, compiled.inputs)
    assert found.copies >= 1


def test_an_empty_stack_admits_nobody() -> None:
    plan = mixes.PLANS["pcr"].plan
    found = measure_capacity(CELL, [], plan)
    assert (found.copies, found.why) == (0, "the stack sciclops.tower2 is empty")


def test_a_plan_of_another_workcell_is_refused() -> None:
    plan = msgspec.structs.replace(mixes.PLANS["pcr"].plan, workcell="elsewhere")
    with pytest.raises(Refused, match="no workcell 'elsewhere'"):
        measure_capacity(CELL, STOCK, plan)
