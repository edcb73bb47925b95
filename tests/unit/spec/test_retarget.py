"""``labos retarget``: what it proposes, what it says does not fit, and what it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from labos.cli.app import main
from labos.spec.retarget import compare_lines, rename
from tests.apps.growth import APP
from tests.support.corpus import corpus
from tests.unit.cli_files.calls import call

SEAL = """\
# pf400 carries, sealer.default is where it seals
labos: 1
name: pf400
workcell: rpl
modules: [pf400, sealer]
hold:
  pf400: none
steps:
  - {name: To sealer, module: pf400, action: transfer, args: {source: peeler.default, target: sealer.default}}
  - name: Seal # by sealer
    module: sealer
    action: seal
"""


@pytest.mark.parametrize(
    ("flow", "payload"), [("create_plate", ["slot=1"]), ("read_plate", ["slot=1", "made_by=R1"])]
)
def test_the_growth_assay_differs_in_names_of_modules_only(
    flow: str, payload: list[str], tmp_path: Path
) -> None:
    """The workflow of BIO is that of RPL as it was retargeted."""
    shutil.copytree(APP.parents[1], tmp_path / "specs", ignore=shutil.ignore_patterns("__pycache__"))
    old, new = APP / "rpl" / f"{flow}.yaml", APP / "bio" / f"{flow}.yaml"
    output = tmp_path / "specs" / new.relative_to(APP.parents[1])
    output.unlink()
    values = [word for value in payload for word in ("-p", value)]
    told = run_retarget(old, *values, output=output, code=0)
    written = output.read_text()
    assert written == new.read_text()
    assert (told["fits"], told["misfits"]) == (True, [])
    names = {"ot2_growth_beta": "solo", "pf400": "platecrane"}
    lines = compare_lines(old.read_text(), written)[2:]
    if flow == "create_plate":
        assert "\n".join(["```diff", *lines, "```"]) in (APP / "README.md").read_text()
    gone = [line[1:] for line in lines if line.startswith("-")]
    come = [line[1:] for line in lines if line.startswith("+")]
    for one, other in names.items():
        gone = [line.replace(one, other) for line in gone]
    assert gone == come != []


def run_retarget(
    flow: Path, *options: str, old: str = "rpl_growth", output: Path, code: int
) -> dict[str, Any]:
    """What it answers in JSON."""
    words = ["retarget", str(flow), "--from", old, "--to", "bio", "-o", str(output), *options, "--json"]
    found: dict[str, Any] = json.loads(call(*words, code=code))
    return found


def test_it_is_told_and_validated(tmp_path: Path) -> None:
    flow = tmp_path / "seal.yaml"
    flow.write_text(SEAL)
    told = call("retarget", str(flow), "--from", "rpl", "--to", "bio")
    written = tmp_path / "seal_bio.yaml"
    assert "both carry, the same actions" in told
    assert f"{written}: written, no errors." in told
    assert "+modules: [platecrane, sealer]" in told
    text = written.read_text()
    assert text.startswith("# pf400 carries")
    assert "name: pf400\nworkcell: bio\n" in text
    assert "hold:\n  platecrane: none\n" in text


def test_what_is_there_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flow, there = tmp_path / "seal.yaml", tmp_path / "seal_bio.yaml"
    flow.write_text(SEAL)
    there.write_text("mine")
    assert main(["retarget", str(flow), "--from", "rpl", "--to", "bio"]) == 1
    assert "already exists" in capsys.readouterr().err
    assert there.read_text() == "mine"
    assert main(["retarget", str(flow), "--from", "rpl", "--to", "bio", "--force"]) == 0
    assert there.read_text() != "mine"


@pytest.mark.parametrize(
    ("step", "misfit"),
    [
        (
            "module: camera_module, action: take_picture",
            "No module of bio stands in for camera_module (take_picture).",
        ),
        (
            "module: pf400, action: transfer, args: {source: ot2_growth_beta.deck2, target: sealer.default}",
            "No module of bio stands in for ot2_growth_beta (only stations, no action).",
        ),
        (
            "module: pf400, action: transfer, args: {source: sealer.default, target: peeler.default,"
            " source_plate_rotation: narrow}",
            "platecrane.transfer takes no argument 'source_plate_rotation', which pf400.transfer takes.",
        ),
    ],
)
def test_what_does_not_fit_is_said(step: str, misfit: str, tmp_path: Path) -> None:
    flow = tmp_path / "flow.yaml"
    flow.write_text(f"labos: 1\nname: flow\nsteps:\n  - {{name: One, {step}}}\n")
    cell = "rpl" if "camera" in step else "rpl_growth"
    told = run_retarget(flow, old=cell, output=tmp_path / "out.yaml", code=1)
    assert misfit in told["misfits"]
    assert told["fits"] is False


@pytest.mark.parametrize(
    ("pair", "said"),
    [
        ("pf400", "is not a pair of modules"),
        ("=solo", "is not a pair of modules"),
        ("pf401=platecrane", "the workcell rpl has no module 'pf401'"),
        ("pf400=platecran", "the workcell bio has no module 'platecran'"),
    ],
)
def test_wrong_pairs(pair: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flow = tmp_path / "seal.yaml"
    flow.write_text(SEAL)
    assert main(["retarget", str(flow), "--from", "rpl", "--to", "bio", "--map", pair]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "seal_bio.yaml").exists()


def test_who_is_named_is_taken_even_if_it_cannot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flow = tmp_path / "seal.yaml"
    flow.write_text(SEAL)
    words = ["retarget", str(flow), "--from", "rpl", "--to", "bio", "--map", "sealer=peeler"]
    assert main(words) == 1
    assert "does not fit: peeler has no action 'seal', which sealer has." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "becomes"),
    [
        ("    module: arm", "    module: crane"),
        ("    module: arm2", "    module: arm2"),
        (
            "    args: {source: arm.hand, target: my_arm.hand}",
            "    args: {source: crane.hand, target: my_arm.hand}",
        ),
        ("    args: {text: the arm. It moves}", "    args: {text: the arm. It moves}"),
        ("    args: {file: old/arm.yaml}", "    args: {file: old/arm.yaml}"),
        ("    # arm.hand", "    # arm.hand"),
    ],
)
def test_only_names_of_modules_change(line: str, becomes: str) -> None:
    assert rename(f"steps:\n{line}\n", {"arm": "crane"}, ("a", "b")) == f"steps:\n{becomes}\n"


def test_two_modules_may_exchange_their_names() -> None:
    text = "steps:\n  - {name: A, module: one, action: a, args: {at: two.x}}\n"
    swapped = rename(text, {"one": "two", "two": "one"}, ("a", "b"))
    assert swapped == "steps:\n  - {name: A, module: two, action: a, args: {at: one.x}}\n"


# -- workflows of another laboratory --------------------------------------------------------------


def test_workflows_that_were_written_for_bio_elsewhere_are_retargeted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The public BIO workcell and its workflows, as the importer writes them: only the crane's name differs,
    and of places that were never described it is said which of ours is meant."""
    public = corpus() / "corpus/rpl_workcell/_history/bio_workcell"
    assert main(["import", str(public), "-o", str(tmp_path / "specs")]) == 1
    assert "4 written, 0 skipped, 1 refused" in capsys.readouterr().out
    described = {"HidexNest2", "SealerNest", "PeelerNest", "Liconic.Nest"}
    for flow, payload, places in (
        ("demo", ["stacker=1", "slot=1", "seal.time=3", "shaker_speed=1"], described),
        ("platecrane_test", [], described),
        ("liconic_test", ["stacker=1", "slot=1"], set()),
    ):
        file, written = tmp_path / f"specs/workflows/{flow}.yaml", tmp_path / f"{flow}.yaml"
        values = [word for value in payload for word in ("-p", value)]
        cell = str(tmp_path / "specs/bio_workcell.yaml")
        told = run_retarget(file, *values, old=cell, output=written, code=int(bool(places)))
        mapping = {match["module"]: match["becomes"] for match in told["matches"]}
        assert {one: other for one, other in mapping.items() if one != other} in (
            {"plateCrane": "platecrane"},
            {},
        )
        strange = [each["message"] for each in told["findings"] if "There is no station" in each["message"]]
        assert {message.split("There is no station '")[1].split("'")[0] for message in strange} == places
        assert all(
            "Did you mean" in each["remedy"] for each in told["findings"] if each["message"] in strange
        )
        lines = compare_lines(file.read_text(), written.read_text())[2:]
        assert "+workcell: /home/rpl/workspace/rpl_workcell/bio_workcell/bio.yaml" in lines
        assert all("platecrane" in line for line in lines if line[0] == "+" and "workcell:" not in line)
