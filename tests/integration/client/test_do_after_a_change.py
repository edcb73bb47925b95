"""What one command has changed, the next one finds: a latch that was closed by hand lets the shaker shake."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput
from labos.settings import Settings
from labos.spec import parse_workcell

CELL = """
labos: 1
name: corner
modules:
  - name: shaker
    about:
      stations: {plate: {access: {latch: open}}}
      variables: {latch: open}
      rest: {latch: open}
      actions:
        latch:
          args: {position: {type: str, choices: [open, closed]}}
          effects: [{sets: {of: module, variable: latch, value: "{position}"}}]
        shake: {effects: [{needs: {}}, {requires: {of: module, variable: latch, value: closed}}]}
"""


@pytest.fixture
def client(tmp_path: Path) -> Iterator[LabClient]:
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())]) as lab, LabClient(lab.url) as found:
        yield found


def test_an_action_that_needs_what_was_changed_by_hand(client: LabClient) -> None:
    client.place("shaker.plate", "plate96", "ada")
    with pytest.raises(BadInput, match="needs latch of shaker closed"):
        client.do("shaker", "shake", user="ada")
    assert client.wait(client.do("shaker", "latch", {"position": "closed"}, user="ada")).status == "completed"
    assert client.wait(client.do("shaker", "shake", user="ada")).status == "completed"
    assert client.wait(client.do("shaker", "latch", {"position": "open"}, user="ada")).status == "completed"
    with pytest.raises(BadInput, match="needs latch of shaker closed"):
        client.do("shaker", "shake", user="ada")
