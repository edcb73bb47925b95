"""On a simulated bench, what an answer says was carried away is carried away."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.node.world import World
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
        squeeze:
          effects: [{needs: {}}, {sets: {of: labware, variable: squeezed, value: true}}]
          duration: 2
"""
FLOW = """
labos: 1
name: Squeeze
steps:
  - {name: once, module: press, action: squeeze}
  - {name: again, module: press, action: squeeze, wait: {after: once, at_least: 30 h}}
"""


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)


@pytest.fixture
def client(settings: Settings) -> Iterator[LabClient]:
    cell = parse_workcell(CELL, descriptions())
    with LabThread(settings, [cell]) as lab, LabClient(lab.url) as client:
        yield client


def until(found: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + 20
    while not (seen := found()):
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize(("choice", "left"), [("removed", []), ("leave", ["plate1"])])
def test_a_plate_that_a_cancelled_run_left(
    client: LabClient, settings: Settings, choice: str, left: list[str]
) -> None:
    client.place("press.nest", "plate96", "ada")
    run = client.submit({"name": "squeeze.yaml", "text": FLOW, "files": {}}, user="ada")
    until(lambda: client.status(run).steps[0].state == "done", "the first step is done")
    client.cancel(run, "ada", why="wrong plate")
    ended = client.wait(run, timeout_s=20)
    assert (ended.status, ended.why) == ("cancelled", "wrong plate")
    (question,) = until(lambda: client.state()["interventions"], "a person is asked about it")
    client.resolve(question["id"], choice, by="ada")
    world = World(str(settings.world("corner")))
    assert world.at("press.nest") == left
    world.close()
    assert len(client.state()["labware"]) == len(left)
