# ruff: noqa: E501
"""``for_each``, ``use`` and ``when``: what is unrolled, in which order, and where faults are told."""

from __future__ import annotations

from typing import Any

import pytest

from labos.spec import Compiled, Finding, SpecErrors
from tests.unit.spec.spec_bench import compile_steps, faults, where

SHOOT = "- {name: Shoot, module: cam, action: take_picture%s}\n"


def order(plan: Compiled) -> dict[str, list[str]]:
    steps = plan.plan.steps
    return {step.key: [steps[i].key for i in step.after] for step in steps}


def only(text: str, payload: dict[str, Any] | None = None, **options: Any) -> Finding:
    (found,) = faults(text, payload, **options)
    return found


def make_used(**files: str) -> dict[str, bytes]:
    return {f"{name}.yaml": f"name: {name}\n{text}".encode() for name, text in files.items()}


def test_a_step_for_each_element_knows_it() -> None:
    text = SHOOT % ", for_each: {item: p, in: payload.ps}, args: {file_name: payload.p.file}"
    plan = compile_steps(text, {"ps": [{"file": "a"}, {"file": "b"}]})
    assert order(plan) == {"Shoot[1]": [], "Shoot[2]": ["Shoot[1]"]}
    assert [step.args["file_name"] for step in plan.plan.steps] == ["a", "b"]


def test_a_slip_in_the_payload_of_a_file_is_told_once() -> None:
    prep = "steps:\n" + SHOOT % ", args: {file_name: payload.file.name}"
    use = (
        "- {name: P, use: prep.yaml, for_each: {item: n, in: [1, 2]}, payload: {file: {name: a, nmae: b}}}\n"
    )
    found = only(use, files=make_used(prep=prep))
    assert found.message == "prep.yaml does not use 'file.nmae' of its payload."
    assert "Did you mean 'file.name'" in found.remedy
    assert found.field == "steps[0].payload.file"
    assert (
        compile_steps(use.replace(", nmae: b", ""), files=make_used(prep=prep))
        .plan.steps[1]
        .args["file_name"]
        == "a"
    )


def test_parallel_rounds_do_not_wait_for_each_other_and_all_are_waited_for() -> None:
    text = (
        SHOOT
        % ""
        + "- {name: Open, module: cycler, action: open_lid, for_each: {item: n, in: [1, 2], parallel: true}}\n"
        "- {name: Close, module: cycler, action: close_lid}\n"
    )
    assert order(compile_steps(text)) == {
        "Shoot": [], "Open[1]": ["Shoot"], "Open[2]": ["Shoot"], "Close": ["Open[1]", "Open[2]"],
    }  # fmt: skip


def test_an_empty_list_leaves_nothing_and_the_order_is_closed() -> None:
    text = SHOOT % "" + "- {name: Open, module: cycler, action: open_lid, for_each: {item: n, in: []}}\n" + (
        "- {name: Close, module: cycler, action: close_lid, after: [Open]}\n"
    )  # fmt: skip
    assert order(compile_steps(text)) == {"Shoot": [], "Close": ["Shoot"]}


def test_the_result_of_one_round_can_be_read() -> None:
    text = SHOOT % ", for_each: {item: n, in: [1, 2]}" + (
        "- {name: Again, module: cam, action: take_picture, args: {file_name: 'steps.Shoot[2].result.file'}}\n"
    )
    plan = compile_steps(text).plan
    assert plan.steps[2].args == {"file_name": {"$result": [1, "file"]}}
    assert plan.feeds == (1,)


PREP = """\
parameters: {file: {default: x.jpg}}
steps:
- {name: Open, module: cycler, action: open_lid}
- {name: Look, module: cam, action: take_picture, args: {file_name: payload.file}, after: []}
- {name: Again, module: cam, action: take_picture, args: {file_name: steps.Look.result}, after: [Look]}
"""


def test_a_used_file_brings_its_steps_with_their_own_names_and_payload() -> None:
    text = (
        SHOOT % "" + "- {name: P, use: prep.yaml, payload: {file: payload.f}}\n"
        "- {name: Q, use: prep.yaml, payload: {}}\n"
        "- {name: End, module: cam, action: take_picture, args: {file_name: steps.P/Again.result}}\n"
    )
    plan = compile_steps(text, {"f": "a.jpg"}, files=make_used(prep=PREP))
    assert order(plan) == {
        "Shoot": [],
        "P/Open": ["Shoot"],
        "P/Look": ["Shoot"],
        "P/Again": ["P/Look"],
        "Q/Open": ["P/Open", "P/Again"],
        "Q/Look": ["P/Open", "P/Again"],
        "Q/Again": ["Q/Look"],
        "End": ["Q/Open", "Q/Again"],
    }
    args = {step.key: step.args.get("file_name") for step in plan.plan.steps}
    assert (args["P/Look"], args["Q/Look"]) == ("a.jpg", "x.jpg")
    assert args["Q/Again"] == {"$result": [5]}
    assert args["End"] == {"$result": [3]}
    assert list(plan.plan.files) == ["prep.yaml"], "what was used is on record"
    assert plan.plan.files["prep.yaml"] in plan.files


def test_files_are_used_in_files_and_for_each_element() -> None:
    inner = "steps:\n" + SHOOT % ", args: {file_name: payload.p}"
    outer = "steps:\n- {name: in, use: inner.yaml}\n- {name: in, use: inner.yaml}\n"
    text = "- {name: out, use: outer.yaml, for_each: {item: p, in: [a, b]}}\n"
    plan = compile_steps(text, files=make_used(inner=inner, outer=outer))
    assert [(step.key, step.args["file_name"]) for step in plan.plan.steps] == [
        ("out[1]/in/Shoot", "a"), ("out[1]/in#2/Shoot", "a"), ("out[2]/in/Shoot", "b"), ("out[2]/in#2/Shoot", "b"),
    ]  # fmt: skip
    keys = list(order(plan))
    assert list(order(plan).values()) == [[], *([key] for key in keys[:-1])]


def test_a_fault_is_told_where_it_was_written_with_the_element() -> None:
    text = (
        SHOOT % ""
        + "- name: Seal\n  module: sealer\n  action: seal\n  args: {time: payload.t}\n  for_each: {item: t, in: [1, -1]}\n"
    )
    found = only(text)
    assert "Step 'Seal[2]': The argument 'time' is -1 s" in found.message
    assert where(found) == (8, 16)
    assert found.field == "steps[1].args.time (Seal[2])"


def test_a_fault_in_a_used_file_names_that_file() -> None:
    bad = "steps:\n- name: Seal\n  module: sealer\n  action: seal\n  args: {time: payload.t}\n"
    found = only("- {name: P, use: bad.yaml, payload: {t: -1}}\n", files=make_used(bad=bad))
    assert (found.file, *where(found)) == ("bad.yaml", 6, 16)
    assert "'P/Seal'" in found.message
    unknown = only(
        "- {name: P, use: bad.yaml}\n", files=make_used(bad="steps:\n- {name: S, modul: x, action: y}\n")
    )
    assert (unknown.file, *where(unknown)) == ("bad.yaml", 3, 31)


@pytest.mark.parametrize(
    ("text", "files", "why"),
    [
        ("- {name: P, use: no.yaml}\n", {}, "The file 'no.yaml' was not found"),
        ("- {name: P, use: ../no.yaml}\n", {}, "was not found"),
        ("- {name: P, use: a.yaml}\n", {"a": "steps:\n- {name: b, use: b.yaml}\n", "b": "steps:\n- {name: a, use: a.yaml}\n"}, "The file uses itself: a.yaml → b.yaml → a.yaml"),
        ("- {name: P, use: a.yaml, args: {x: 1}}\n", {}, "The key 'args' belongs to a step"),
        ("- {name: P, action: seal}\n", {}, "The key 'module' is missing"),
        (SHOOT % ", payload: {x: 1}", {}, "Only an entry that uses a file has a payload"),
        (SHOOT % ", for_each: {item: n, in: payload.n}", {}, "needs a list, and this is not one"),
        (SHOOT % ", for_each: {item: n, in: payload.long}", {}, "more than 2000 steps"),
        (SHOOT % ", when: payload.n", {}, "neither true nor false"),
        (SHOOT % ", when: payload.gone == 1", {}, "There is no 'gone' in payload"),
        (SHOOT % ", when: 'payload.n >'", {}, "cannot be read"),
        (SHOOT % ", when: result.x > 1", {}, "can use only the payload and earlier results"),
        (SHOOT % "" + SHOOT % ", when: payload.n > 9" + "- {name: A, module: cam, action: take_picture, args: {file_name: steps.Shoot#2.result}}\n", {}, "it is left out by its `when`"),
        ("- {name: 'S[1]', module: cam, action: take_picture}\n- {name: S, module: cam, action: take_picture, for_each: {item: n, in: [1]}}\n", {}, "Two steps would be called 'S[1]'"),
        ("- {name: P, use: a.yaml}\n", {"a": "hold: {sealer: none}\nsteps:\n" + SHOOT % ""}, "`hold` is allowed only in the submitted workflow"),
    ],
)  # fmt: skip
def test_what_is_refused(text: str, files: dict[str, str], why: str) -> None:
    payload = {"n": 1, "long": [0] * 3000}
    found = faults(text, payload, files=make_used(**files))
    assert any(why in finding.message for finding in found), found
    assert all(finding.line for finding in found)


def test_what_grows_without_measure_is_stopped() -> None:
    """Ten times ten times ten …: nothing is unrolled beyond the limit, also if nothing comes out."""
    files = {
        f"f{n}": f"steps:\n- {{name: s, use: f{n + 1}.yaml, for_each: {{item: i, in: {list(range(10))}}}}}\n"
        for n in range(6)
    }
    files["f6"] = "steps:\n" + SHOOT % ", when: 1 > 2"
    found = only("- {name: P, use: f0.yaml}\n", files=make_used(**files))
    assert "more than 2000 steps" in found.message


def test_a_step_left_out_by_the_payload_leaves_the_rest_consistent() -> None:
    text = SHOOT % "" + "- {name: Open, module: cycler, action: open_lid, when: payload.n > 1}\n" + (
        "- {name: Close, module: cycler, action: close_lid, when: payload.n == 1 and 'x' in payload.s}\n"
    )  # fmt: skip
    assert order(compile_steps(text, {"n": 1, "s": "xy"})) == {"Shoot": [], "Close": ["Shoot"]}
    assert order(compile_steps(text, {"n": 2, "s": ""})) == {"Shoot": [], "Open": ["Shoot"]}


def test_a_long_chain_of_left_out_steps_is_no_trouble() -> None:
    text = SHOOT % "" + "".join(
        f"- {{name: S{n}, module: cam, action: take_picture, when: 1 > 2}}\n" for n in range(1500)
    )
    assert list(
        order(compile_steps(text + "- {name: End, module: cam, action: take_picture}\n")).values()
    ) == [
        [],
        ["Shoot"],
    ]


def test_all_left_out_is_refused_by_what_is_left() -> None:
    with pytest.raises(SpecErrors, match="No step of this workflow is left"):
        compile_steps(SHOOT % ", when: 1 > 2")
