"""Set-ups in a workcell file."""

from __future__ import annotations

import pytest

from labos.core.setups import Setup, SetupChange
from labos.errors import LabosError
from labos.spec import parse_workcell
from tests.simulation.mixes import DESCRIPTIONS

OVEN = """
labos: 1
name: corner
modules:
  - name: oven
    about: {actions: {bake: {duration: 30 min, args: {celsius: {type: float}}}}}
    setup: %s
"""


def test_a_module_says_what_a_change_costs() -> None:
    text = OVEN % "{by: celsius, takes: 20 min, changes: [{from: 37, to: 60, takes: 8 min}]}"
    [oven] = parse_workcell(text, DESCRIPTIONS).workcell.modules
    assert oven.setup == Setup("celsius", 1200.0, (SetupChange(37, 60, 480.0),))


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("{by: celsus, takes: 20 min}", "No action of oven has the argument 'celsus'"),
        ("{by: celsius}", "takes"),
        ("{by: celsius, takes: -3}", "takes"),
        ("{by: celsius, takes: 20, changes: [{to: 60, takes: 8}]}", "from"),
    ],
)
def test_a_slip_is_told(written: str, told: str) -> None:
    with pytest.raises(LabosError, match=told):
        parse_workcell(OVEN % written, DESCRIPTIONS)
