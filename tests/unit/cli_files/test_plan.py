"""``labos plan``: steps, times and what is used up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.spec import SpecErrors
from tests.unit.cli_files.calls import call

BRANCHES = """\
labos: 1
name: branches
parameters: {seconds: {default: 4}}
steps:
  - {name: Open, module: biometra, action: open_lid}
  - {name: Seal, module: sealer, action: seal, args: {time: payload.seconds}, after: []}
  - name: Carry
    module: pf400
    action: transfer
    args: {source: sealer.default, target: biometra.default}
    after: [Open, Seal]
    within: {after: Open, at_most: 1}
"""


def test_the_packaged_workflow() -> None:
    told = call("plan", "pcr", "--workcell", "rpl")
    assert "pcr on rpl: 14 steps" in told
    assert "sciclops.tower2 → sciclops.exchange" in told
    assert "time=3, temperature=175" in told
    assert "Used up: 1 of 1000 foil of sealer." in told
    assert "Taken: 1 from sciclops.tower2." in told
    plan = json.loads(call("plan", "pcr", "--workcell", "rpl", "--json"))
    steps = [step for step in plan["steps"] if not step["on_cancel"]]
    assert plan["total_s"] == sum(step["duration_s"] for step in steps)
    assert plan["critical"] == [step["key"] for step in steps]
    assert "If the run is cancelled, the necessary steps of: 'Open the cycler' (biometra.open_lid)" in told
    mix = plan["steps"][2]
    assert (mix["stations"], mix["after"]) == (["ot2_pcr_alpha.deck1_cooler"], ["Move to OT-2"])
    assert plan["outputs"] == ["wc.output"]


def test_branches_and_windows(tmp_path: Path) -> None:
    file = tmp_path / "branches.yaml"
    file.write_text(BRANCHES)
    plan = json.loads(call("plan", str(file), "--workcell", "rpl", "-p", "seconds=5", "--json"))
    opening, seal, carry = plan["steps"]
    assert (opening["start_s"], seal["start_s"]) == (0, 0)
    assert carry["start_s"] == max(opening["end_s"], seal["end_s"])
    assert seal["args"]["time"] == 5
    assert seal["stations"] == ["sealer.default"]
    assert plan["critical"] == ["Seal", "Carry"]
    assert (opening["critical"], plan["inputs"]) == (False, ["sealer.default"])
    assert carry["late_s"] == carry["start_s"] - opening["end_s"] - 1
    assert "'Carry' starts 5 s later than its window allows." in call("plan", str(file), "--workcell", "rpl")


def test_what_is_wrong_is_said_as_elsewhere() -> None:
    with pytest.raises(SpecErrors, match="The payload has no 'color_A_volumes'"):
        call("plan", "cp_mixcolor", "--workcell", "rpl")


FORKS = """\
labos: 1
name: forks
hold: {biometra: {from: Open, until: Seal}}
steps:
- {name: Open, module: biometra, action: open_lid, on_error: ask}
- {name: Get plate, module: sciclops, action: get_plate, args: {loc: tower1}}
- name: To sealer
  module: pf400
  action: transfer
  args: {source: sciclops.exchange, target: sealer.default}
- name: Seal
  module: sealer
  action: seal
  timeout: 10 min
  retry: {times: 1, reset: true}
  on_error: {run: [{name: Look, module: biometra, action: close_lid}]}
- name: To output
  module: pf400
  action: transfer
  args: {source: sealer.default, target: wc.output}
  when: steps.Seal.result == null
"""


def test_what_may_go_wrong_is_told(tmp_path: Path) -> None:
    flow = tmp_path / "forks.yaml"
    flow.write_text(FORKS)
    told = call("plan", str(flow), "--workcell", "rpl")
    for line in (
        "forks on rpl: 5 steps, 2 min 25 s alone",
        "If 'Open' finally fails, a person is asked.",
        "'Seal' has an unknown outcome if it has not ended after 10 min 00 s.",
        "'Seal' is tried up to 1 times more if it fails, after a reset of sealer.",
        "If 'Seal' finally fails: 'Look' (biometra.close_lid); then the run fails.",
        "'To output' is done only if steps.Seal.result == null.",
        "Kept from others: biometra, from the start of 'Open' to the end of 'Seal'.",
    ):
        assert line in told


PATIENT = """\
labos: 1
name: corner
modules:
- {name: sealer, model: A4S_sealer, retry: {times: 2, reset: true}, timeout: 10 min, on_error: ask}
- {name: arm, model: pf400, timeout: 2 min}
stations:
  wc.a: {}
stock:
  wc.a: {plate96: 1}
"""

SEALED = """\
labos: 1
name: sealed
steps:
- {name: Over, module: arm, action: transfer, args: {source: wc.a, target: sealer.default}}
- {name: Seal, module: sealer, action: seal, retry: {times: 1}}
"""


def test_what_a_module_says_for_its_steps_is_told(tmp_path: Path) -> None:
    cell, flow = tmp_path / "corner.yaml", tmp_path / "sealed.yaml"
    cell.write_text(PATIENT)
    flow.write_text(SEALED)
    told = call("plan", str(flow), "--workcell", str(cell))
    for line in (
        "'Over' has an unknown outcome if it has not ended after 2 min 00 s.",
        "'Seal' has an unknown outcome if it has not ended after 10 min 00 s.",
        "'Seal' is tried up to 1 times more if it fails.",
        "If 'Seal' finally fails, a person is asked.",
    ):
        assert line in told


WATCHED = """\
labos: 1
name: corner
modules:
  - {name: arm, model: pf400}
  - {name: eye, model: camera}
stations:
  wc.a: {observer: eye}
  wc.b: {observer: eye, verify: on_doubt}
  wc.c: {observer: eye, verify: never}
stock:
  wc.a: {plate96: 1}
"""

CARRY = """\
labos: 1
name: carry
steps:
  - {name: Over, module: arm, action: transfer, args: {source: wc.a, target: wc.b}}
  - {name: Away, module: arm, action: transfer, args: {source: wc.b, target: wc.c}}
"""


def test_who_looks_afterwards(tmp_path: Path) -> None:
    cell, flow = tmp_path / "corner.yaml", tmp_path / "carry.yaml"
    cell.write_text(WATCHED)
    flow.write_text(CARRY)
    told = call("plan", str(flow), "--workcell", str(cell))
    assert "After 'Over' its result is observed: eye at wc.a, eye at wc.b (in doubt)." in told
    plan = json.loads(call("plan", str(flow), "--workcell", str(cell), "--json"))
    assert plan["steps"][1]["looks"] == ["eye at wc.b (in doubt)"]


TIPS = """\
labos: 1
name: tips
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: In
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: ot2_cp_gamma.deck2}
  - {name: Mix, module: ot2_cp_gamma, action: run_protocol, args: {config_path: mix.py}}
"""
PROTOCOL = """\
def run(protocol):
    plate = protocol.load_labware("corning_96_wellplate_360ul_flat", "2")
    pipette = protocol.load_instrument("p300_single_gen2", "left")
    for well in {wells}:
        pipette.pick_up_tip()
        pipette.drop_tip()
"""


def test_tips_are_counted_and_what_is_assumed_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, protocol = tmp_path / "tips.yaml", tmp_path / "mix.py"
    file.write_text(TIPS)
    protocol.write_text(PROTOCOL.format(wells="range(40)"))
    assert main(["plan", str(file), "--workcell", "rpl"]) == 0
    told = capsys.readouterr()
    assert "Used up: 40 of 960 tips of ot2_cp_gamma." in told.out
    assert told.err == ""
    protocol.write_text(PROTOCOL.format(wells="plate.wells()"))
    assert main(["plan", str(file), "--workcell", "rpl", "--json"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["resources"][0]["amount"] == 8
    assert "Step 'Mix' is assumed to use up 8 tips: this cannot be counted from mix.py (line 5:" in told.err
    assert 'resources = {"tips": N}' in told.err
