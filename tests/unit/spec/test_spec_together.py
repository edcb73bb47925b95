"""What a module does for several runs at once, in a workcell file."""

from __future__ import annotations

import pytest

from labos.core.model import Together
from labos.errors import LabosError
from labos.spec import parse_workcell
from tests.simulation.mixes import DESCRIPTIONS

CENTRIFUGE = """
labos: 1
name: corner
modules:
  - name: spinner
    about:
      variables: {lid: open}
      stations:
        rotor: {kind: hotel, capacity: 4%s}
        tray: {kind: hotel, capacity: 4}
      actions:
        spin: {duration: 5 min, args: {g: {type: int}}, effects: [{needs: {}}]}
        home: {duration: 10 s}
        shut: {duration: 10 s, effects: [{needs: {}}, {sets: {of: module, variable: lid, value: closed}}]}
        load: {duration: 10 s, effects: [{move: {source: tray, target: rotor}}]}
        level: {exclusive: false, effects: [{needs: {}}]}
    together: %s
stations:
  spinner.tray: {transfers: false%s}
"""
DOOR = ", access: {lid: open}"


def parse(written: str, access: str = DOOR, tray: str = DOOR) -> Together | None:
    [spinner] = parse_workcell(CENTRIFUGE % (access, written, tray), DESCRIPTIONS).workcell.modules
    return spinner.together


def test_a_module_says_what_it_does_for_several_runs_at_once() -> None:
    assert parse("{actions: [spin], wait: 10 min}") == Together(("spin",), 600.0)
    assert parse("{actions: [spin]}") == Together(("spin",), 0.0)


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("{actions: [spinn], wait: 10 min}", "spinner has no action 'spinn'"),
        (
            "{actions: [home]}",
            "'home' of spinner cannot be done for several runs at once: it needs no labware",
        ),
        ("{actions: [shut]}", "it leaves lid of the module changed"),
        ("{actions: [load]}", "it does more than change labware in its place"),
        ("{actions: [level]}", "it does not occupy the module"),
        ("{actions: []}", "actions"),
        ("{wait: 10 min}", "actions"),
        ("{actions: [spin], wait: -3}", "wait"),
        ("{actions: [spin], size: 4}", "size"),
    ],
)
def test_a_slip_is_told(written: str, told: str) -> None:
    with pytest.raises(LabosError, match=told):
        parse(written)


def test_nobody_may_reach_in_while_it_is_at_work() -> None:
    with pytest.raises(LabosError, match=r"Arms reach into spinner\.rotor at any time"):
        parse("{actions: [spin]}", access="")


def test_labware_of_several_runs_has_to_find_room() -> None:
    nests = "labos: 1\nname: corner\nmodules: [{name: s, about: {stations: {%s}, actions: "
    text = nests + "{spin: {effects: [{needs: {}}]}}}, together: {actions: [spin]}}]"
    with pytest.raises(LabosError, match="s has no room for labware of several runs"):
        parse_workcell(text % "a: {kind: nest}", DESCRIPTIONS)
    with pytest.raises(LabosError, match=r"Labware at s\.a blocks s for other runs"):
        parse_workcell(text % "a: {kind: nest}, b: {kind: nest}", DESCRIPTIONS)
