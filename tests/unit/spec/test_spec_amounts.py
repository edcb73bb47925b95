"""What an action will use up: from its arguments, from the file it runs, said where it is wrong."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.effects import Consumes
from labos.errors import SpecError
from labos.spec import compile_workflow, find_spec, parse_workflow
from labos.spec.amounts import amount_of, arguments_of
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
    return amount_of(text, VALUES, FILES.get).amount


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
        ("{text}", "'text' is no number"),
        ("{less}", "less than nothing"),
        ("{n.sum}", "'n' is no list"),
        ("{wells.sum}", "A value of 'wells' is no number"),
        ("{n} + 1", "is no amount"),
        ("{n.__class__}", "is no amount"),
        ("{nobody}", "no argument 'nobody'"),
        ("{file:protocol:resources.foil}", "p.yaml:2:3: resources: It does not say 'resources.foil'"),
        (
            "{file:protocol:resources.ink|8}",
            "p.yaml:3:8: resources.ink: 'much' is no amount",
        ),
        ("{file:protocol:resources.bad}", "p.yaml:5:8: resources.bad: There is no argument 'nobody'"),
    ],
)
def test_what_is_no_amount_is_said(text: str, message: str) -> None:
    with pytest.raises(SpecError) as error:
        amount(text)
    assert message in str(error.value)


def test_which_arguments_decide() -> None:
    assert arguments_of("{volumes.sum}") == {"volumes"}
    assert arguments_of("{file:protocol:resources.tips|8}") == {"protocol"}
    assert arguments_of("8") == set()


def test_a_protocol_says_what_it_uses_and_the_run_keeps_it() -> None:
    compiled = compile_workflow(
        find_spec("workflows", "cp_mixcolor"), PAYLOADS["cp_mixcolor"], CELL.workcell, DESCRIPTIONS
    )
    effects = [e for step in compiled.plan.steps for e in step.effects if isinstance(e, Consumes)]
    assert effects == [Consumes("tips", 2.0)]


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
