"""``labos import``: what it writes, what it refuses, what it leaves alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.errors import BadInput, NotFound
from tests.unit.cli_files.calls import call

PAPER = Path(__file__).parents[1] / "spec" / "paper"
TWICE = "name: a\nname: Seal\nflowdef:\n  - {name: s, module: sealer, command: seal, args: {foo: bar}}\n"


def folder(tmp_path: Path) -> Path:
    lab = tmp_path / "lab"
    (lab / "flows").mkdir(parents=True)
    (lab / ".git").mkdir()
    (lab / "cell.yaml").write_text((PAPER / "rpl_modular_workcell.yaml").read_text())
    (lab / "flows/seal.yaml").write_text(TWICE)
    (lab / "flows/seal.yml").write_text(TWICE)
    (lab / "own.yaml").write_text("labos: 1 # mine\nname: x\nsteps: [{name: a, module: b, action: c}]\n")
    (lab / "compose.yaml").write_text("services: {}\n")
    (lab / "broken.yaml").write_text("a: [\n")
    (lab / ".git/config.yaml").write_text("a: [\n")
    (lab / "readme.md").write_text("a: [\n")
    return lab


def test_a_folder_keeps_its_order(tmp_path: Path) -> None:
    lab, out = folder(tmp_path), tmp_path / "out"
    told = json.loads(call("import", str(lab), "-o", str(out), "--json", code=1))
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*.yaml")) == [
        "cell.yaml",
        "flows/seal-2.yaml",
        "flows/seal.yaml",
        "own.yaml",
    ]
    written = {Path(file["target"]).name: file for file in told["written"]}
    assert written["cell.yaml"]["kind"] == "workcell"
    assert written["cell.yaml"]["counts"]["modules"] == 14
    assert [finding["line"] for finding in written["seal.yaml"]["assumed"]] == [2, 4]
    assert (out / "own.yaml").read_text() == (lab / "own.yaml").read_text()
    assert [Path(left["source"]).name for left in told["skipped"]] == ["compose.yaml"]
    [refused] = told["refused"]
    assert (Path(refused["source"]).name, refused["why"][0]["line"]) == ("broken.yaml", 2)


def test_what_is_written_can_be_used(tmp_path: Path) -> None:
    told = call("import", str(folder(tmp_path)), "-o", str(tmp_path), code=1)
    assert "4 written, 1 skipped, 1 refused." in told
    seal = tmp_path / "flows/seal.yaml"
    assert seal.read_text() == (
        "# Imported from seal.yaml (WEI). What had to be assumed stands below.\n"
        "labos: 1\n"
        "# Line 2: The key 'name' is there twice; the first is in line 1. The last one is used, as in the\n"
        "# program for which the file was written.\n"
        "name: Seal\n\nsteps:\n"
        "  # Line 4: The key 'foo' is a placeholder.\n"
        "  - {name: s, module: sealer, action: seal}\n"
    )
    told = call("validate", str(seal), "--workcell", str(tmp_path / "cell.yaml"))
    assert "Seal on RPL_Modular_workcell: 1 steps, no errors." in told
    assert "RPL_Modular_workcell: 14 modules, " in call("validate", str(tmp_path / "cell.yaml"))


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    lab, out = folder(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "own.yaml").write_text("mine")
    with pytest.raises(BadInput, match=r"already has .*own\.yaml.*--force"):
        call("import", str(lab), "-o", str(out))
    assert [path.name for path in out.iterdir()] == ["own.yaml"], "and nothing else was written"
    call("import", str(lab), "-o", str(out), "--force", code=1)
    assert (out / "own.yaml").read_text() != "mine"


def test_what_was_written_inside_the_folder_is_not_read_again(tmp_path: Path) -> None:
    lab = folder(tmp_path)
    for _ in range(2):
        told = call("import", str(lab), "-o", str(lab / "own"), "--force", code=1)
        assert "4 written, 1 skipped, 1 refused." in told


def test_a_file_by_itself(tmp_path: Path) -> None:
    told = call("import", str(PAPER / "pcr_demo_wf.yaml"), "-o", str(tmp_path))
    assert "1 written, 0 skipped, 0 refused." in told
    assert "14 steps" in told
    told = call("import", str(folder(tmp_path) / "compose.yaml"), "-o", str(tmp_path), code=1)
    assert "refused:" in told
    assert "Docker Compose" in told


def test_what_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NotFound, match="no file or folder"):
        call("import", str(tmp_path / "nothing"))
    assert main(["import", str(tmp_path / "nothing")]) == 1
    assert capsys.readouterr().err.startswith("labos: There is no file or folder")


def test_files_that_arguments_name_come_along(tmp_path: Path) -> None:
    lab, out = tmp_path / "lab", tmp_path / "out"
    (lab / "flows").mkdir(parents=True)
    (lab / "protocols").mkdir()
    (lab / "protocols/mix.py").write_bytes(b"mix\xff")
    (tmp_path / "secret.txt").write_text("secret")
    (lab / "cell.yaml").write_text("name: corner\nmodules:\n  - {name: ot2, model: ot2}\n")
    (lab / "flows/mix.yaml").write_text(
        "name: Mix\nflowdef:\n"
        "  - {name: a, module: ot2, action: run_protocol, args: {config_path: ../protocols/mix.py}}\n"
        "  - {name: b, module: ot2, action: run_protocol, args: {config_path: ../../secret.txt}}\n"
    )
    told = call("import", str(lab), "-o", str(out))
    assert f"copied: {out / 'protocols/mix.py'}" in told
    assert (out / "protocols/mix.py").read_bytes() == b"mix\xff"
    assert not list(out.rglob("secret*"))
    told = call("validate", str(out / "flows/mix.yaml"), "--workcell", str(out / "cell.yaml"), "--simulate")
    assert "mix.py' " not in told, "it was found"


def test_a_workcell_that_workflows_name_is_written_as_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the folder is given by a relative path: the file as it was must not take its place."""
    lab = tmp_path / "lab"
    (lab / "flows").mkdir(parents=True)
    (lab / "cell.yaml").write_text("name: corner\nmodules:\n  - {name: ot2, model: ot2}\n")
    flow = "name: Mix\nmetadata: {workcell: ../cell.yaml}\nworkcell: ../cell.yaml\nflowdef:\n"
    flow += "  - {name: a, module: ot2, action: run_protocol, args: {config_path: x.py}}\n"
    (lab / "flows/mix.yaml").write_text(flow)
    monkeypatch.chdir(tmp_path)
    told = call("import", "lab", "-o", "out")
    assert "copied" not in told
    assert "labos: 1" in (tmp_path / "out/cell.yaml").read_text()


def test_what_was_assumed_is_listed_by_consequence(tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "cell.yaml").write_text("name: corner\nmodules:\n  - {name: oven}\n  - {name: my_sealer}\n")
    (lab / "bake.yaml").write_text(
        "name: Bake\nflowdef:\n"
        "  - {name: a, module: my_sealer, action: seal, args: {time: 3, mood: good}}\n"
        "  - {name: b, module: oven, action: bake, args: {minutes: 3}}\n"
    )
    told = call("import", str(lab), "-o", str(tmp_path / "out"))
    listed = told.partition("most important first:")[2]
    order = [
        "driver for the module 'oven'",
        "assumed to have the driver a4s_sealer",
        "does not know what mood",
    ]
    assert [listed.index(text) for text in order] == sorted(listed.index(text) for text in order)
    shown = json.loads(call("import", str(lab), "-o", str(tmp_path / "out"), "--force", "--json"))
    (cell,) = [file for file in shown["written"] if file["kind"] == "workcell"]
    assert {finding["assumed"] for finding in cell["assumed"]} == {"module", "driver", "action"}
    again = call("validate", str(tmp_path / "out/bake.yaml"), "--workcell", str(tmp_path / "out/cell.yaml"))
    assert "2 steps, no errors." in again
