"""Windows that a run cannot keep for all durations: told, warned of, or refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.cli.app import main
from tests.unit.cli_files.calls import call

TIGHT = """\
labos: 1
name: tight
{top}
steps:
- {{name: Open, module: biometra, action: open_lid}}
- {{name: Close, module: biometra, action: close_lid}}
- name: Look
  module: camera_module
  action: take_picture
  within: {{after: Open, at_most: {most}}}
"""
MISSED = "'Look' within 20 s of the end of 'Open': can be missed by 2 s, if 'Close' takes 22 s."
KEPT = "'Look' within 22 s of the end of 'Open': kept for all durations within ±10 %."


def write(folder: Path, top: str = "", most: int = 20) -> str:
    file = folder / "tight.yaml"
    file.write_text(TIGHT.format(top=top, most=most))
    return str(file)


def test_windows_that_are_kept_are_told(tmp_path: Path) -> None:
    flow = write(tmp_path, most=22)
    assert KEPT in call("validate", flow, "--workcell", "rpl")
    assert KEPT in call("plan", flow, "--workcell", "rpl")


def test_a_window_that_breaks_is_a_warning(tmp_path: Path) -> None:
    flow = write(tmp_path)
    told = call("validate", flow, "--workcell", "rpl")
    assert f"warning: {flow}:10:11: steps[2].within: {MISSED} Let `at_most` be 22 s or more" in told
    assert MISSED in told.splitlines()
    found = json.loads(call("validate", flow, "--workcell", "rpl", "--json"))
    assert found["sound"] is True
    assert found["certificate"]["windows"][0]["breaks_by_s"] == 2
    plan = json.loads(call("plan", flow, "--workcell", "rpl", "--json"))
    assert plan["certificate"] == found["certificate"]


def test_a_workflow_may_accept_it(tmp_path: Path) -> None:
    told = call("validate", write(tmp_path, "windows: accept"), "--workcell", "rpl")
    assert "warning" not in told
    assert MISSED in told.splitlines()


@pytest.mark.parametrize("command", ["validate", "plan"])
def test_a_workflow_may_refuse_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    flow = write(tmp_path, "windows: refuse")
    assert main([command, flow, "--workcell", "rpl"]) == 1
    told = capsys.readouterr()
    assert f"{flow}:10:11: steps[2].within: {MISSED}" in told.out + told.err
    assert "write `windows: warn` at the top" in told.out + told.err
    assert KEPT in call("validate", write(tmp_path, "windows: refuse", 22), "--workcell", "rpl")


def test_other_words_are_not_known(tmp_path: Path) -> None:
    told = call("validate", write(tmp_path, "windows: ignore"), "--workcell", "rpl", code=1)
    assert "tight.yaml:3:10: windows: 'ignore' is not one of the choices." in told
