"""How many tips a protocol uses up, told before it runs: as many as there are, or a doubt with its reason."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from labos_drivers.ot2.tips import count_used_tips
from labos_drivers.solo import protocol as hso

HEAD = """
def run(protocol):
    rack = protocol.load_labware("opentrons_96_tiprack_300ul", "1")
    plate = protocol.load_labware("corning_96_wellplate_360ul_flat", "2")
    one = protocol.load_instrument("p300_single_gen2", "left", tip_racks=[rack])
    eight = protocol.load_instrument("p20_multi_gen2", "right")
"""
WELLS = ["A1", "B1", "C1"]


def python(body: str, before: str = "") -> bytes:
    """A protocol with two pipettes; ``body`` stands in its ``run``."""
    return (before + HEAD + "".join(f"    {line}\n" for line in body.strip().split("\n"))).encode()


def count_python_tips(body: str, before: str = "") -> tuple[float, str]:
    found = count_used_tips(
        "p.py", python(body, before), {"destination_wells": WELLS, "red_volumes": [1.0, 2.0]}
    )
    return found.amount, found.doubt


@pytest.mark.parametrize(
    ("body", "tips"),
    [
        ("one.pick_up_tip()\none.drop_tip()", 1),
        ("eight.pick_up_tip()", 8),
        ("for _ in range(40):\n    one.pick_up_tip()\n    one.drop_tip()", 40),
        (
            "for row in 'ABC':\n    for well in [f'{row}{n}' for n in '1234']:\n        one.pick_up_tip()",
            12,
        ),
        ("for well in LABOS['destination_wells']:\n    one.pick_up_tip()", 3),
        ("for a, b in zip(LABOS['red_volumes'], WELLS):\n    one.pick_up_tip()", 2),
        ("for pipette in [one, eight]:\n    pipette.pick_up_tip()", 9),
        ("n = 2 * 3 - 1\nwhile n > 0:\n    one.pick_up_tip()\n    n -= 1", 5),
        (
            "wells = []\nfor n in range(6):\n    wells.append(n)\nfor w in wells:\n    one.pick_up_tip()",
            6,
        ),
        ("for n in range(9):\n    if n == 4:\n        break\n    one.pick_up_tip()", 4),
        ("for n in range(9):\n    if n % 2:\n        continue\n    one.pick_up_tip()", 5),
        ("if not one.has_tip:\n    one.pick_up_tip()\nif not one.has_tip:\n    one.pick_up_tip()", 1),
        ("one.transfer(10, plate['A1'], plate['B1'])\neight.distribute(5, plate['A1'], [])", 9),
        ("one.pick_up_tip()\none.transfer(10, plate['A1'], plate['B1'], new_tip='never')", 1),
        ("one.pick_up_tip().aspirate(10, plate['A1'])", 1),
        ("for well in plate.wells():\n    one.aspirate(1, well)\none.pick_up_tip()", 1),
        ("if protocol.is_simulating():\n    protocol.comment('x')\none.pick_up_tip()", 1),
        ("if protocol.is_simulating():\n    one.pick_up_tip()\nelse:\n    one.pick_up_tip(rack['A2'])", 1),
        ("if MANY:\n    for _ in range(50):\n        one.pick_up_tip()\nelse:\n    one.pick_up_tip()", 1),
        (
            "def mix(p, n=2):\n    for _ in range(n):\n        p.pick_up_tip()\nmix(one)\nmix(eight, 1)",
            10,
        ),
        ("def fresh():\n    if one.has_tip:\n        return\n    one.pick_up_tip()\nfresh()\nfresh()", 1),
    ],
)
def test_a_protocol_in_python_is_counted(body: str, tips: float) -> None:
    assert count_python_tips(body, "MANY = False\nWELLS = ('A1', 'B1', 'C1')\n") == (tips, "")


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("for well in plate.wells():\n    one.pick_up_tip()", "how often"),
        ("if protocol.is_simulating():\n    one.pick_up_tip()", "depends on"),
        ("for n in range(3):\n    if plate.x:\n        break\n    one.pick_up_tip()", "depends on"),
        ("one.transfer(10, plate.rows()[0], plate.rows()[1], new_tip='always')", "new_tip='always'"),
        ("eight.configure_nozzle_layout(style=1)\neight.pick_up_tip()", "configure_nozzle_layout"),
        ("import helpers\nhelpers.prepare(one)", "what `prepare` does with a pipette"),
        ("import helpers\nhelpers.prepare(protocol)", "what `prepare` does with a pipette"),
        ("take = one.pick_up_tip\ntake()\ntake()", "cannot be determined"),
        ("take = lambda: one.pick_up_tip()\ntake()", "how often"),
        (
            "def a():\n    one.pick_up_tip()\ndef b():\n    a()\na()\nfor w in plate.wells():\n    b()",
            "how often `a`",
        ),
        ("def a():\n    one.pick_up_tip()\na()\n[a() for w in plate.wells()]", "how often `a`"),
        ("def a():\n    one.pick_up_tip()\na()\nx = a() if plate.x else 0", "how often `a`"),
        ("def a():\n    one.pick_up_tip()\na()\nplate.x and a()", "how often `a`"),
        ("p = one\nif plate.x:\n    p = eight\np.pick_up_tip()", "the pipette of"),
        ("wells = [1]\nplate.fill(wells)\nfor w in wells:\n    one.pick_up_tip()", "how often"),
        ("wells = [1]\nwells.extend(plate.wells())\nfor w in wells:\n    one.pick_up_tip()", "how often"),
        ("try:\n    one.pick_up_tip()\nexcept Exception:\n    one.pick_up_tip()", "how often"),
        ("class Mixer:\n    def go(self):\n        one.pick_up_tip()\nMixer().go()", "how often"),
        ("def go():\n    one.pick_up_tip()\n    go()\ngo()", "calls itself"),
        ("while True:\n    one.pick_up_tip()", "more than 100000"),
        ("one.pick_up_tip()\nreturn\none.pick_up_tip()", "whether `pick_up_tip` is done"),
        (
            "a = [1]\nfor n in range(60):\n    a = [a, a]\nfor w in a[n]:\n    one.pick_up_tip()",
            "how often",
        ),
        ("p = protocol.load_instrument(plate.x, 'left')\np.pick_up_tip()", "the pipette of"),
        ("x = [0] * 10 ** 9\nfor w in x:\n    one.pick_up_tip()", "how often"),
    ],
)
def test_what_only_the_robot_knows_is_a_doubt(body: str, why: str) -> None:
    assert why in count_python_tips(body)[1]


def test_a_protocol_in_python_can_say_it_itself() -> None:
    body = "for well in plate.wells():\n    one.pick_up_tip()"
    assert count_python_tips(body, 'resources = {"tips": 96}\n') == (96, "")
    doubt = count_used_tips("p.py", python(body), {})
    assert 'resources = {"tips": N}' in doubt.remedy
    assert "not Python" in count_used_tips("p.py", b"def run(:", {}).doubt
    assert "no `run`" in count_used_tips("p.py", b"x = 1", {}).doubt


def test_it_is_read_and_never_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    text = f"open({str(mark)!r}, 'w').close()\n" + HEAD + f"    open({str(mark)!r}, 'w').close()\n"
    assert count_used_tips("p.py", text.encode(), {}).doubt == ""
    assert not mark.exists()


def count_yaml_tips(commands: str, **args: Any) -> tuple[float, str]:
    text = (
        "equipment:\n"
        "  - {name: corning_96_wellplate_360ul_flat, location: '2', alias: dest}\n"
        "  - {name: opentrons_96_tiprack_300ul, location: '1'}\n"
        "  - {name: p300_multi_gen2, mount: left}\n"
        "  - {name: p20_single_gen2, mount: right}\n"
        f"commands:\n{commands}"
    )
    found = count_used_tips("p.yaml", text.encode(), args)
    return found.amount, found.doubt


@pytest.mark.parametrize(
    ("commands", "tips"),
    [
        ("  - {source: 'dest:A1', destination: 'dest:[A2, A3]', volume: 100}\n", 16),
        ("  - {source: 'dest:A1', destination: 'dest:[A2, A3]', volume: [100, 5]}\n", 9),
        ("  - {source: 'dest:A1', destination: 'dest:[A2, A3]', volume: 100, drop_tip: false}\n", 8),
        ("  - {source: 'dest:A1', destination: 'dest:[1...12]', volume: 5}\n", 12),
        ("  - {command: mix, reps: 3, mix_volume: 10, location: 'dest:[A1, A2]'}\n", 1),
        ("  - {source: 'dest:A1', destination: payload.destination_wells, volume: payload.red_volumes}\n", 2),
    ],
)
def test_a_protocol_in_yaml_is_counted_as_the_robot_would_run_it(commands: str, tips: float) -> None:
    told = {"destination_wells": WELLS, "red_volumes": [3.0, 0.0, 4.0]}
    assert count_yaml_tips(commands, **told) == (tips, "")


@pytest.mark.parametrize(
    ("commands", "why"),
    [
        (
            "  - {source: 'dest:Primer', destination: 'dest:A1', volume: 3}\n",
            "'Primer' is in another file",
        ),
        ("  - {source: 'dest:A1', destination: payload.wells, volume: 3}\n", "'wells', which is not known"),
        ("  - {source: 'dest:A1', destination: 'dest:A2', volume: Much}\n", "cannot be followed"),
        ("  - {source: 'dest:A1', destination: 'dest:A2', volume: 9.0e+9}\n", "more than 100000"),
        ("  - {source: 'dest:A1', destination: 'dest:[1...900000000]', volume: 3}\n", "'A100'"),
        ("  - {shake: 3}\n", "has no destination, source, volume"),
    ],
)
def test_what_a_protocol_in_yaml_leaves_open_is_a_doubt(commands: str, why: str) -> None:
    assert why in count_yaml_tips(commands)[1]


NAMED = {"pipettes": {"l": {"name": "p300_multi_gen2", "mount": "left"}}}
PICK = {"commandType": "pickUpTip", "params": {"pipetteId": "l", "labwareId": "t", "wellName": "A1"}}
LOAD = {"commandType": "loadPipette", "params": {"pipetteName": "p20_single_gen2", "pipetteId": "l"}}


@pytest.mark.parametrize(
    ("told", "tips", "why"),
    [
        ({**NAMED, "commands": [PICK, PICK]}, 16, ""),
        ({"commands": [LOAD, PICK]}, 1, ""),
        ({**NAMED, "commands": [{"command": "pickUpTip", "params": {"pipette": "l"}}]}, 8, ""),
        (
            {
                "pipettes": {"l": {"model": "p10_single_v1"}},
                "procedure": [{"subprocedure": [{"command": "pick-up-tip", "params": {"pipette": "l"}}]}],
            },
            1,
            "",
        ),
        ({"commands": [PICK]}, 0, "'l', which it does not load"),
        ({**NAMED, "commands": [{"commandType": "configureNozzleLayout"}, PICK]}, 0, "at once"),
        ({"x": 1}, 0, "no commands"),
        ([], 0, "not a protocol in JSON"),
    ],
)
def test_the_robots_own_protocols_are_counted(told: Any, tips: float, why: str) -> None:
    found = count_used_tips("p.json", json.dumps(told).encode(), {})
    assert found.amount == tips
    assert why in found.doubt
    assert bool(why) == bool(found.doubt)


def steps(*written: tuple[object, ...]) -> bytes:
    lines = [*["Empty"] * hso.POSITIONS, *(str(part) for step in written for part in (*step, hso.STEP_END))]
    return "".join(f"{line}\r\n" for line in lines).encode()


def tip(number: object) -> tuple[object, ...]:
    return ("GetTip", "Position1", "TipDisposal", number, 1, 0, "False")


@pytest.mark.parametrize(
    ("written", "tips", "why"),
    [
        ([tip(8), ("ShuckTip", "TipDisposal"), tip(1)], 9, ""),
        ([("Loop", 5), tip(8), ("EndLoop",), tip(3)], 43, ""),
        ([("Loop", -1), tip(8), ("EndLoop",)], 0, "how often it goes through a loop"),
        ([tip("x")], 0, "does not say how many"),
        ([tip(8), ("HitPicking",)], 8, "HitPicking"),
        ([("Dance",)], 0, "'Dance' is no step"),
    ],
)
def test_the_steps_of_a_solo_are_counted(written: list[Any], tips: float, why: str) -> None:
    found = hso.count_used_tips("p.hso", steps(*written), {})
    assert found.amount == tips
    assert why in found.doubt


@pytest.mark.skipif(not os.environ.get("LABOS_CORPUS"), reason="the public workcells are not here")
@pytest.mark.parametrize(
    ("name", "tips", "why"),
    [
        ("ot2_pcr_config.yaml", 56, ""),
        ("ot2_beta_test_first.yaml", 8, ""),
        ("ot2_beta_test_second.yaml", 1, ""),
        ("combined_protocol.yaml", 4, ""),
        ("PCR_prep_second_half.yaml", 0, "'Forward Primer' is in another file"),
        ("PCR_prep_full_plate.yaml", 0, "a list for drop_tip is not translated"),
    ],
)
def test_public_protocols_are_counted_or_say_why_not(name: str, tips: float, why: str) -> None:
    path = next(Path(os.environ["LABOS_CORPUS"]).glob(f"**/applications/*/protocol_files/{name}"))
    colors = {f"color_{color}_volumes": [20.0, 350.0] for color in "ABCD"}
    found = count_used_tips(name, path.read_bytes(), {"destination_wells": ["A1", "A2"], **colors})
    assert found.amount == tips
    assert why in found.doubt
    assert bool(why) == bool(found.doubt)
