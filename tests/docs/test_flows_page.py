"""The page about flows and transfers: its program prints what the page says."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.docs.markdown import DOCS, blocks

PAGE = DOCS / "flows.md"


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = list(blocks(PAGE.read_text()))
    (program,) = (block.text for block in found if block.language == "python")
    (printed,) = (block.text for block in found if block.language == "text")
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    said = io.StringIO()
    with LabThread(settings, [cell], nodes="none") as running, LabClient(running.url) as lab:
        with contextlib.redirect_stdout(said):
            exec(compile(program, PAGE.name, "exec"), {"__name__": "application"})
        kinds = [event["payload"]["kind"] for event in lab.events(type="experiment.noted")]
    assert said.getvalue().strip() == printed.strip()
    assert kinds == ["flow", "local_compute", "local_compute", "flow", "transfer"]
