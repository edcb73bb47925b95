"""Keys of a payload that nothing takes."""

from __future__ import annotations

from typing import Any

import pytest
from spec_bench import BENCH, DESCRIPTIONS, compile_steps, faults

from labos.spec import compile_workflow, parse_workflow

SEAL = "- {name: seal, module: sealer, action: seal, args: {time: payload.seal.time}}\n"
LOOK = "- {name: look, module: cam, action: take_picture, args: {file_name: a.jpg}%s}\n"
EACH = (
    "- {name: look, module: cam, action: take_picture, args: {file_name: payload.p.file},"
    " for_each: {item: p, in: payload.plates}}\n"
)
WITH_DEFAULT = f"labos: 1\nname: w\nparameters: {{seal.time: {{default: 3}}, spare: {{}}}}\nsteps:\n{SEAL}"
INNER = {"inner.yaml": b"labos: 1\nname: i\nparameters: {heat: {default: 1}}\nsteps:\n" + SEAL.encode()}


def with_default(payload: dict[str, Any]) -> Any:
    return compile_workflow(parse_workflow(WITH_DEFAULT), payload, BENCH.workcell, DESCRIPTIONS)


@pytest.mark.parametrize(
    ("payload", "key", "remedy"),
    [
        ({"seal": {"tim": 3}}, "seal.tim", "Did you mean 'seal.time'?"),
        ({"seal": 3}, "seal", "Did you mean 'seal.time'?"),
        ({"time": 3}, "time", "Did you mean 'seal.time'?"),
        ({"seal": {"time": 3, "times": 4}}, "seal.times", "Did you mean 'seal.time'?"),
        ({"quite": {"else": 1}}, "quite.else", "Known: seal.time, spare."),
    ],
)
def test_a_slip_of_the_pen_does_not_pass_for_the_default(
    payload: dict[str, Any], key: str, remedy: str
) -> None:
    with pytest.raises(Exception, match="The workflow does not use") as refused:
        with_default(payload)
    assert f"payload.{key}: The workflow does not use {key!r} of the payload. {remedy}" in str(refused.value)


@pytest.mark.parametrize(
    "payload",
    [{}, {"seal": {"time": 5}}, {"seal.time": 5}, {"spare": 1}, {"spare": {"a": {"b": 1}}}, {"seal": {}}],
)
def test_what_is_declared_or_referred_to_may_be_given(payload: dict[str, Any]) -> None:
    assert with_default(payload).plan.steps[0].args["time"] in (3, 5)


@pytest.mark.parametrize(
    ("text", "payload"),
    [
        (LOOK % ", when: payload.a.b > 1", {"a": {"b": 2}}),
        (LOOK % ", when: payload.a > 1" + SEAL.replace("name: seal", "name: s, when: 1 > 2"),
         {"a": 2, "seal": {"time": 1}}),
        (LOOK % ", when: \"'x' in payload\"", {"x": 2, "y": 3}),
        (LOOK % ", when: \"payload.wells[0].od > 1\"", {"wells": [{"od": 2, "note": 1}]}),
        (LOOK % ", expect: result.n > payload.least", {"least": 1}),
        (EACH, {"plates": [{"file": "a.jpg", "note": "b"}]}),
        (EACH + SEAL, {"plates": [], "seal": {"time": 2}}),
        (LOOK % ", within: {of: payload.other, after: x, at_most: 5}", {"other": "w"}),
        ("- {name: a, module: payload.m, action: '${payload.x}pen_lid'}\n", {"m": "cycler", "x": "o"}),
        (LOOK % ", on_error: {run: [{name: s, module: sealer, action: seal, args: {time: payload.t}}]}",
         {"t": 2}),
        (LOOK % "" + "- {name: u, use: inner.yaml, when: payload.a > 1}\n",
         {"a": 0, "seal": {"time": 1}, "heat": 2}),
        (LOOK % ", on_error: {run: inner.yaml}", {"seal": {"time": 1}}),
    ],
)  # fmt: skip
def test_a_key_is_taken_wherever_the_file_names_it(text: str, payload: dict[str, Any]) -> None:
    found = faults(text, payload, files=INNER, simulate=True)
    assert not [fault for fault in found if "takes" in fault.message], found


def test_a_used_file_that_cannot_be_read_may_take_anything() -> None:
    text = LOOK % "" + "- {name: u, use: gone.yaml, when: payload.a > 1}\n"
    assert compile_steps(text, {"a": 0, "b": 1}).plan.steps


def test_a_workflow_without_references_says_so() -> None:
    (found,) = faults(LOOK % "", {"x": 1}, simulate=True)
    assert (found.field, found.remedy) == (
        "payload.x",
        "Leave it out: this workflow uses no payload.",
    )


def test_parameters_of_foreign_files_are_taken() -> None:
    text = (
        "name: w\nparameters:\n  - {name: t, default: 3}\nflowdef:\n"
        "- {name: seal, module: sealer, action: seal, args: {time: $t}}\n"
    )
    found = compile_workflow(parse_workflow(text), {"t": 4}, BENCH.workcell, DESCRIPTIONS)
    assert found.plan.steps[0].args["time"] == 4
    with pytest.raises(Exception, match="Known: t"):
        compile_workflow(parse_workflow(text), {"seal": 4}, BENCH.workcell, DESCRIPTIONS)
