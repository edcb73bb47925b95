"""Who waits for a run is told what it waits for, and learns its end."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli import _narrate
from labos.cli._narrate import Narrator
from labos.client import LabClient, RunResult
from labos.settings import Settings
from labos.spec import parse_workcell

CELL = """
labos: 1
name: corner
modules:
  - name: press
    about:
      stations: {nest: {}}
      actions:
        squeeze: {effects: [{needs: {}}], duration: 2}
        rest: {duration: 3000}
"""
FLOW = "labos: 1\nname: Squeeze\nsteps:\n  - {name: squeeze it, module: press, action: squeeze}\n"
LONG = FLOW.replace("squeeze it", "rest").replace("action: squeeze", "action: rest")


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())]) as running:
        yield running


def wait_for_idle_press(client: LabClient) -> None:
    deadline = time.monotonic() + 20
    while client.state()["modules"][0]["status"] != "IDLE":
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_run_says_what_it_waits_for(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_narrate, "SILENCE_S", 0.3)
    said, results = threading.Event(), list[RunResult]()

    def note(text: str) -> None:
        lines.append(text)
        if "labos explain" in text:
            said.set()

    lines: list[str] = []
    monkeypatch.setattr(_narrate.click, "echo", note)
    with LabClient(lab.url) as client, LabClient(lab.url) as other:
        wait_for_idle_press(client)
        after = client.health()["position"]
        run = client.submit({"name": "squeeze.yaml", "text": FLOW, "files": {}}, user="ada")
        thread = threading.Thread(target=lambda: results.append(Narrator(other, after).follow_run(run)))
        thread.start()
        assert said.wait(20), lines
        assert f"            {run} waits: nothing stands at press.nest" in lines
        client.place("press.nest", "plate96", "ada")
        thread.join(20)
    assert [result.status for result in results] == ["completed"]
    assert "press.squeeze succeeded" in "\n".join(lines)
    assert lines.count(f"            See what to do: labos explain {run}") == 1, "it is said once"


def test_a_long_step_is_told_with_what_is_left(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_narrate, "SILENCE_S", 0.3)
    said, over = threading.Event(), threading.Event()

    def note(text: str) -> None:
        lines.append(text)
        if " left" in text:
            said.set()

    lines: list[str] = []
    monkeypatch.setattr(_narrate.click, "echo", note)
    with LabClient(lab.url) as client, LabClient(lab.url) as other:
        wait_for_idle_press(client)
        watcher = Narrator(other, client.health()["position"])
        thread = threading.Thread(target=lambda: watcher.follow(over))
        thread.start()
        run = client.submit({"name": "rest.yaml", "text": LONG, "files": {}}, user="ada")
        try:
            assert said.wait(20), lines
            assert client.wait(run).succeeded
        finally:
            over.set()
            thread.join(20)
    told = [line for line in lines if " left" in line]
    assert len(told) == 1, lines
    (line,) = told
    assert re.fullmatch(rf" +{run} 'rest': press is at rest, about \d\d min( \d+ s)? left", line), line
