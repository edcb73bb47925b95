"""What an action will use up: from its arguments, from the file it runs, said where it is wrong."""

from __future__ import annotations

from typing import Any

import pytest

from labos.bootstrap import descriptions
from labos.core.counts import Count
from labos.core.effects import Consumes
from labos.errors import SpecError
from labos.spec import compile_workflow, find_spec, parse_workflow
from labos.spec.amounts import compute_amount, list_arguments
from labos.spec.findings import SpecErrors
from tests.simulation.mixes import CELL, DESCRIPTIONS, PAYLOADS

VALUES: dict[str, Any] = {
    "n": 3,
    "wells": ["A1", "A2"],
    "volumes": [10, 2.5],
    "none": None,
    "text": "x",
    "less": -1,
    "protocol": "p.yaml",
    "script": "p.py",
}
FILES = {"p.yaml": b"resources:\n  tips: 96\n  ink: much\n  count: '{wells.count}'\n  bad: '{nobody.sum}'\n"}


def amount(text: str) -> float:
    return compute_amount(text, VALUES, FILES.get).amount


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("{n}", 3),
        ("{wells.count}", 2),
        ("{volumes.sum}", 12.5),
        ("{volumes.max}", 10),
        ("{none.sum}", 0),
        ("{none.max}", 0),
        ("{file:protocol:resources.tips}", 96),
        ("{file:protocol:resources.tips|8}", 96),
        ("{file:protocol:resources.foil|8}", 8),
        ("{file:protocol:resources.count}", 2),
        ("{file:script:resources.tips|8}", 8),
        ("{file:text:resources.tips}", 0),
    ],
)
def test_amounts(text: str, number: float) -> None:
    assert amount(text) == number


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{text}", "'text' is not a number"),
        ("{less}", "cannot be negative"),
        ("{n.sum}", "'n' is not a list"),
        ("{wells.sum}", "A value of 'wells' is not a number"),
        ("{n} + 1", "is not an amount"),
        ("{n.__class__}", "is not an amount"),
        ("{nobody}", "no argument 'nobody'"),
        ("{file:protocol:resources.foil}", "p.yaml:2:3: resources: It does not say 'resources.foil'"),
        (
            "{file:protocol:resources.ink|8}",
            "p.yaml:3:8: resources.ink: 'much' is not an amount",
        ),
        ("{file:protocol:resources.bad}", "p.yaml:5:8: resources.bad: There is no argument 'nobody'"),
    ],
)
def test_what_is_no_amount_is_said(text: str, message: str) -> None:
    with pytest.raises(SpecError) as error:
        amount(text)
    assert message in str(error.value)


def seven(name: str, content: bytes, args: Any) -> Count:
    return Count(7 + len(args["wells"]))


def at_least(name: str, content: bytes, args: Any) -> Count:
    return Count(20, "it has a loop")


@pytest.mark.parametrize(
    ("text", "counter", "found"),
    [
        ("{file:protocol:resources.tips|8}", seven, Count(96)),
        ("{file:protocol:resources.foil|8}", seven, Count(9)),
        ("{file:less:resources.foil|8}", seven, Count(9)),
        (
            "{file:protocol:resources.foil|8}",
            at_least,
            Count(20, "it has a loop", "Write it there: `resources: {foil: N}`."),
        ),
        (
            "{file:protocol:resources.foil|8}",
            None,
            Count(8, "it does not say", "Write it there: `resources: {foil: N}`."),
        ),
        (
            "{file:text:resources.foil|8}",
            seven,
            Count(8, "it is not here", "Put the file beside the workflow, and name it."),
        ),
    ],
)
def test_the_file_says_it_or_the_driver_counts_it_or_it_is_assumed(
    text: str, counter: Any, found: Count
) -> None:
    files = {**FILES, "-1": b"of a format of its own"}
    assert compute_amount(text, VALUES, files.get, counter) == found


def test_what_is_assumed_is_a_warning_and_what_is_counted_is_not() -> None:
    text = """
labos: 1
name: mixes
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: ot2_cp_gamma.deck2}
  - {name: Mix, module: ot2_cp_gamma, action: run_protocol, args: {config_path: p.py}}
"""
    one = b"def run(p):\n    a = p.load_instrument('p20_single', 'left')\n    a.pick_up_tip()\n"
    many = one.replace(b"    a.pick", b"    for w in p.x:\n        a.pick")

    def compile_amounts(content: bytes) -> tuple[list[float | str], list[str]]:
        found = compile_workflow(
            parse_workflow(text, "w.yaml"), {}, CELL.workcell, descriptions(), files={"p.py": content}
        )
        amounts = [e.amount for s in found.plan.steps for e in s.effects if isinstance(e, Consumes)]
        return amounts, [str(finding) for finding in found.findings]

    assert compile_amounts(one) == ([1.0], [])
    amounts, (warning,) = compile_amounts(many)
    assert amounts == [8.0]
    assert "w.yaml:10:" in warning
    assert (
        "Step 'Mix' is assumed to use up 8 tips: this cannot be counted from p.py (line 4: only the robot "
        "knows how often" in warning
    )
    assert '`resources = {"tips": N}`' in warning


def test_which_arguments_decide() -> None:
    assert list_arguments("{volumes.sum}") == {"volumes"}
    assert list_arguments("{file:protocol:resources.tips|8}") == {"protocol"}
    assert list_arguments("8") == set()


def test_a_protocol_says_what_it_uses_and_the_run_keeps_it() -> None:
    compiled = compile_workflow(
        find_spec("workflows", "cp_mixcolor"), PAYLOADS["cp_mixcolor"], CELL.workcell, DESCRIPTIONS
    )
    effects = [e for step in compiled.plan.steps for e in step.effects if isinstance(e, Consumes)]
    assert effects == [Consumes("tips", 2.0)]


def test_a_protocol_says_how_long_it_takes() -> None:
    text = """
labos: 1
name: mixes
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: ot2_cp_gamma.deck2}
  - {name: Mix, module: ot2_cp_gamma, action: run_protocol, args: {config_path: p.yaml}}
"""

    def find_duration_s(resources: bytes) -> float:
        files = {"p.yaml": b"resources: {" + resources + b"}\nsteps: []\n"}
        compiled = compile_workflow(
            parse_workflow(text, "w.yaml"), {}, CELL.workcell, descriptions(), files=files
        )
        return compiled.plan.steps[-1].duration_s

    assert find_duration_s(b"tips: 1, seconds: 95") == 95
    assert find_duration_s(b"tips: 1") == 600


def test_a_fault_in_a_protocol_is_told_with_its_place() -> None:
    text = """
labos: 1
name: faulty
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: ot2_cp_gamma.deck2}
  - {name: Mix, module: ot2_cp_gamma, action: run_protocol, args: {config_path: p.yaml}}
"""
    files = {"p.yaml": b"resources:\n  tips: [96]\n"}
    with pytest.raises(SpecErrors) as error:
        compile_workflow(parse_workflow(text, "w.yaml"), {}, CELL.workcell, DESCRIPTIONS, files=files)
    (finding,) = error.value.findings
    assert (finding.file, finding.line, finding.column, finding.field) == ("p.yaml", 2, 9, "resources.tips")
