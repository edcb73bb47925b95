"""What steps take from their module's entry in the workcell: retries and limits of time."""

from __future__ import annotations

from typing import Any

import pytest

from labos.bootstrap import descriptions
from labos.core.model import Plan, Retry, RetryDefault
from labos.spec import Compiled, Finding, compile_workflow, parse_workcell, parse_workflow
from labos.spec.findings import SpecErrors

CELL = """\
labos: 1
name: corner
modules:
- name: cycler
  model: biometra (96well)
  retry: {times: 2, delay: 30 s, reset: true}
  timeout: 5 min
- {name: camera, model: camera, timeout: 1 s}
"""

FLOW = "labos: 1\nname: flow\nsteps:\n"
OPEN = "- {name: Open, module: cycler, action: open_lid"


def compile_flow(steps: str, cell: str = CELL, **payload: Any) -> Compiled:
    known = descriptions()
    workcell = parse_workcell(cell, known, "corner.yaml").workcell
    return compile_workflow(
        parse_workflow(FLOW + steps, "flow.yaml"), payload, workcell, known, simulate=True
    )


def plan(steps: str, **payload: Any) -> Plan:
    return compile_flow(steps, **payload).plan


def faults(cell: str) -> tuple[Finding, ...]:
    with pytest.raises(SpecErrors) as caught:
        parse_workcell(cell, descriptions(), "corner.yaml")
    return caught.value.findings


def test_the_workcell_keeps_what_its_file_says() -> None:
    cycler, camera = parse_workcell(CELL, descriptions()).workcell.modules
    assert (cycler.retry, cycler.timeout_s) == (RetryDefault(2, 30.0, reset=True), 300.0)
    assert (camera.retry, camera.timeout_s) == (None, 1.0)


def test_a_step_that_says_nothing_takes_what_its_module_says() -> None:
    opened, reset = plan(OPEN + "}\n").steps
    assert (opened.retry, opened.timeout_s) == (Retry(2, 30.0, reset=1), 300.0)
    assert (reset.key, reset.action, reset.part) == ("Open/reset", "reset", 0)
    assert (reset.retry, reset.timeout_s) == (None, None)


def test_a_steps_own_word_wins() -> None:
    opened, again, never = plan(
        OPEN + ", retry: {times: 1}}\n" + OPEN.replace("Open", "Again") + ", timeout: 10 min, retry: none}\n"
        "- {name: Never, module: cycler, action: open_lid, timeout: none, retry: none}\n"
    ).steps
    assert (opened.retry, opened.timeout_s) == (Retry(1), 300.0)
    assert (again.retry, again.timeout_s) == (None, 600.0)
    assert (never.retry, never.timeout_s) == (None, None)


def test_a_module_may_come_from_the_payload() -> None:
    steps = OPEN.replace("module: cycler", "module: payload.which") + "}\n"
    for name in ("cycler", "corner/cycler"):
        assert plan(steps, which=name).steps[0].retry == Retry(2, 30.0, reset=1)
    with pytest.raises(SpecErrors, match="no module 'welder'"):
        plan(steps, which="welder")


def test_a_step_that_resets_is_not_reset_before_it_is_done_again() -> None:
    (reset,) = plan("- {name: Well, module: cycler, action: reset}\n").steps
    assert reset.retry == Retry(2, 30.0)


def test_they_hold_for_the_way_out_and_for_recovery_too() -> None:
    away = OPEN.replace("Open", "Again").removeprefix("- ") + "}"
    found = plan(OPEN + f", on_error: {{run: [{away}]}}}}\non_cancel:\n- {away}\n")
    steps = {step.key: step for step in found.steps}
    for key in ("Open", "Open/on_error/Again", "on_cancel/Again"):
        retry = steps[key].retry
        assert retry is not None
        assert found.steps[retry.reset].key == f"{key}/reset"
        assert steps[key].timeout_s == 300.0


def test_a_workcell_without_them_changes_nothing() -> None:
    bare = "labos: 1\nname: corner\nmodules:\n- {name: cycler, model: biometra (96well)}\n"
    (opened,) = compile_flow(OPEN + "}\n", bare).plan.steps
    assert (opened.retry, opened.timeout_s) == (None, None)
    (none,) = compile_flow(OPEN + ", retry: none, timeout: none}\n", bare).plan.steps
    assert none == opened


def test_a_limit_that_comes_before_the_nominal_end_is_a_warning() -> None:
    picture = "- {name: Look, module: camera, action: take_picture, args: {file_name: a.jpg}"
    (told,) = compile_flow(picture + "}\n").findings
    assert (told.severity, told.file, told.line) == ("warning", "flow.yaml", 4)
    assert "'Look' counts as unknown after 1 s, and take_picture takes" in told.message
    assert compile_flow(picture + ", timeout: 1 min}\n").findings == ()


@pytest.mark.parametrize(
    ("was", "written", "line", "message"),
    [
        ("times: 2", "times: 0", 6, "at least 1"),
        ("delay: 30 s", "delay: 30 parsec", 6, "unit 'parsec' is not known"),
        ("reset: true", "rest: true", 6, "'rest' is not known"),
        ("timeout: 5 min", "timeout: 0", 7, "greater than 0"),
        ("timeout: 5 min", "timeout: never", 7, "A duration is a number of seconds"),
        ("{times: 2, delay: 30 s, reset: true}", "twice", 6, "does not fit"),
        ("timeout: 1 s", "retry: {times: 1, reset: true}", 0, ""),
    ],
)
def test_what_is_wrong_is_named_by_its_line(was: str, written: str, line: int, message: str) -> None:
    cell = CELL.replace(was, written)
    if not line:
        parse_workcell(cell, descriptions())
        return
    (fault,) = faults(cell)
    assert (fault.file, fault.line) == ("corner.yaml", line)
    assert message in fault.message


def test_a_module_that_cannot_be_reset_is_not_reset_before_retries() -> None:
    about = "  about: {actions: {poke: {}}}\n  interface: wei_rest_node\n  config: {rest_node_address: 'http://x'}\n"
    cell = "labos: 1\nname: corner\nmodules:\n- name: thing\n" + about + "  retry: {times: 1, reset: true}\n"
    (fault,) = faults(cell)
    assert "'thing' has no action 'reset'" in fault.message
    assert fault.line == 8


@pytest.mark.parametrize(
    ("written", "message"),
    [("retry: often", "'often' is not one of the choices"), ("timeout: -1", "greater than 0")],
)
def test_what_is_wrong_in_a_step_is_named_too(written: str, message: str) -> None:
    with pytest.raises(SpecErrors) as caught:
        compile_flow(f"{OPEN}, {written}}}\n")
    (fault,) = caught.value.findings
    assert (fault.file, fault.line) == ("flow.yaml", 4)
    assert message in fault.message


CUTTER = """\
labos: 1
name: corner
modules:
- name: cutter
  interface: wei_rest_node
  config: {rest_node_address: "http://cutter.lab:2000"}
  about: {actions: {cut: {dangerous: laser}, look: {}}}
"""


@pytest.mark.parametrize(("more", "dangers"), [("  second_person: true\n", ["laser", ""]), ("", ["", ""])])
def test_what_is_dangerous_takes_a_second_person_where_the_workcell_says_so(
    more: str, dangers: list[str]
) -> None:
    steps = "".join(f"- {{name: {name}, module: cutter, action: {name}}}\n" for name in ("cut", "look"))
    assert [step.dangerous for step in compile_flow(steps, CUTTER + more).plan.steps] == dangers
    # What an action says of dangers stands in the plan in any case: a policy may ask for it.
    assert [step.hazard for step in compile_flow(steps, CUTTER + more).plan.steps] == ["laser", ""]
