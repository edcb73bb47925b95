"""``on_cancel``: what may stand there, and what is found when a run is cancelled on paper."""

from __future__ import annotations

from labos.core.model import MAIN, ON_CANCEL
from tests.unit.spec.spec_bench import compile_steps, faults

CARRY = "- {name: %s, module: arm, action: transfer, args: {source: %s, target: %s}}\n"
GET = "- {name: Get, module: stack, action: get_plate, args: {loc: tower1}}\n"
FLOW = GET + CARRY % ("In", "stack.exchange", "cycler.default") + (
    "- {name: Close, module: cycler, action: close_lid}\n"
    "- {name: Open, module: cycler, action: open_lid}\n"
) + CARRY % ("Away", "cycler.default", "wc.trash")  # fmt: skip
FROM_EXCHANGE = CARRY % ("From exchange", "stack.exchange", "wc.trash")
FROM_CYCLER = CARRY % ("From cycler", "cycler.default", "wc.trash")
OPEN = "- {name: Open it, module: cycler, action: open_lid}\n"


def test_its_steps_stand_apart() -> None:
    found = compile_steps(FLOW + "on_cancel:\n" + OPEN + FROM_EXCHANGE + FROM_CYCLER)
    assert [step.part for step in found.plan.steps] == [MAIN] * 5 + [ON_CANCEL] * 3
    assert [step.key for step in found.plan.steps][-1] == "on_cancel/From cycler"
    assert [step.after for step in found.plan.steps][-3:] == [(), (5,), (5, 6)]
    assert found.inputs == ()


def test_a_file_may_hold_them() -> None:
    out = b"name: out\nsteps:\n" + (OPEN + FROM_EXCHANGE + FROM_CYCLER).encode()
    found = compile_steps(FLOW + "on_cancel: out.yaml\n", files={"out.yaml": out})
    assert [step.key for step in found.plan.steps][5:] == [
        "on_cancel/Open it",
        "on_cancel/From exchange",
        "on_cancel/From cycler",
    ]


def test_a_closed_module_is_an_error_where_the_run_may_be_cancelled() -> None:
    (fault,) = faults(FLOW + "on_cancel:\n" + FROM_EXCHANGE + FROM_CYCLER)
    assert fault.severity == "error"
    assert "After a cancellation that follows 'Close': cycler.default is out of reach" in fault.message
    assert fault.line == 11


def test_labware_that_is_left_in_the_way_is_a_warning() -> None:
    (fault,) = faults(FLOW + "on_cancel:\n" + OPEN + FROM_CYCLER)
    assert fault.severity == "warning"
    assert "labware stays at stack.exchange" in fault.message
    assert "'Get'" in fault.message


def test_new_labware_is_refused() -> None:
    (fault,) = faults(FLOW + "on_cancel:\n" + OPEN + FROM_EXCHANGE + FROM_CYCLER + GET)
    assert "A workflow on cancellation cannot take new labware." in fault.message


def test_keys_that_belong_to_the_workflow_are_refused() -> None:
    (fault,) = faults(FLOW + "on_cancel:\n" + OPEN.replace("}", ", on_error: skip}"))
    assert "A step under `on_cancel` cannot have 'on_error'" in fault.message


def test_a_used_file_has_no_way_out_of_its_own() -> None:
    inner = b"name: inner\nsteps:\n" + OPEN.encode() + b"on_cancel:\n" + OPEN.encode()
    (fault,) = faults("- {name: Use, use: inner.yaml}\n", files={"inner.yaml": inner})
    assert "`on_cancel` is allowed only in the submitted workflow" in fault.message
