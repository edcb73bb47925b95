"""Where an arm changes its grip: at the place that a step names, else at the module's own."""

from __future__ import annotations

import pytest

from labos.bootstrap import descriptions
from labos.core.effects import Move
from labos.spec import compile_workflow, parse_workcell, parse_workflow

CELL = """\
labos: 1
name: corner
modules: [{name: pf400, model: pf400, regrip: wc.regrip}, {name: sealer, model: a4s_sealer}]
stations: {wc.regrip: {}, wc.deck: {}, wc.nest: {}}
"""


@pytest.mark.parametrize(
    ("target_grip", "more", "via"),
    [
        ("wide", "", "wc.regrip"),
        ("wide", ", rotation_deck: wc.deck", "wc.deck"),
        ("narrow", ", rotation_deck: wc.deck", ""),
    ],
)
def test_the_place_is_kept_only_if_the_grip_changes_there(target_grip: str, more: str, via: str) -> None:
    known = descriptions()
    cell = parse_workcell(CELL, known)
    args = "source: sealer.default, target: wc.nest, source_plate_rotation: narrow, target_plate_rotation: "
    step = f"{{name: x, module: pf400, action: transfer, args: {{{args}{target_grip}{more}}}}}"
    flow = f"labos: 1\nname: f\nsteps: [{step}]\n"
    plan = compile_workflow(parse_workflow(flow, "f.yaml"), {}, cell.workcell, known, bench=cell.bench).plan
    (move,) = [effect for effect in plan.steps[0].effects if isinstance(effect, Move)]
    assert move.via.partition("/")[2] == via
