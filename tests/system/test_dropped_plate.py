"""An arm drops a plate and says that all went well: the lab looks, on real processes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.core.state import LabState
from labos.ports import LogQuery
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import PATIENCE_S, labos, until

CELL = """\
labos: 1
name: corner
modules:
  - {name: pf400, model: pf400}
  - {name: ur, model: ur5}
  - {name: eye, model: camera, config: {reads: true}}
stations:
  wc.shelf: {kind: nest, observer: eye}
  wc.table: {kind: nest, observer: eye}
  wc.left: {kind: nest}
  wc.right: {kind: nest}
stock:
  wc.shelf: {plate96: 1}
  wc.left: {plate96: 1}
"""

CARRY = """\
labos: 1
name: carry
workcell: corner
steps:
  - {name: Carry, module: ARM, action: transfer, args: {source: wc.FROM, target: wc.TO}, on_error: WHAT}
"""


class Corner:
    """A lab whose camera looks at the shelf and the table."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.home = folder, folder / "lab"
        (folder / "corner.yaml").write_text(CELL)
        cell = load_workcell(folder / "corner.yaml", descriptions())
        self.thread = LabThread(Settings.make(self.home, speed=2000.0, simulate=True), [cell])

    def carry(self, client: LabClient, arm: str, source: str, target: str, what: str = "fail") -> str:
        file = self.folder / f"{arm}-{source}-{target}.yaml"
        text = CARRY.replace("ARM", arm).replace("FROM", source).replace("TO", target)
        file.write_text(text.replace("WHAT", what))
        return client.submit(file, user="ada")

    def list_payloads(self, kind: str) -> list[Any]:
        records = self.thread.runtime.store.select(LogQuery(types=(kind,)))
        return [json.loads(record.payload) for record in records]

    def differences(self) -> list[str]:
        state, records = LabState(), list(self.thread.runtime.store.read())
        fold(state, records)
        return list_differences(self.thread.runtime.world("corner"), state, records)


@pytest.fixture
def corner(tmp_path: Path) -> Iterator[Corner]:
    made = Corner(tmp_path)
    with made.thread:
        yield made


def test_a_dropped_plate_is_missed(corner: Corner) -> None:
    world = corner.thread.runtime.world("corner")
    with LabClient(corner.thread.url) as client:
        world.trip("pf400", "drops")
        run = corner.carry(client, "pf400", "shelf", "table")
        other = corner.carry(client, "ur", "left", "right")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "failed"
        assert client.wait(other, timeout_s=PATIENCE_S).status == "completed", "it does not depend on it"
        (failed,) = corner.list_payloads("run.failed")
        assert failed["kind"] == "operational"
        assert "eye saw nothing at wc.table" in failed["why"]
        (question,) = client.state(waits=False)["interventions"]
        assert question["kind"] == "lost_labware"
        seen = labos("bench", "show", "--home", str(corner.home)).stdout
        assert re.search(r"on the floor +P1 \(plate96\)", seen), seen
        assert f"A person is asked: {question['id']}" in seen
        assert labos("resolve", question["id"], "gone", "--home", str(corner.home)).returncode == 0
        assert world.at("floor") == [], "who says so has picked it up"
        seen = labos("bench", "show", "--home", str(corner.home))
        assert (seen.returncode, "The log agrees" in seen.stdout) == (0, True), seen.stdout
    assert corner.differences() == []


def test_who_asks_may_have_it_put_where_it_belongs(corner: Corner) -> None:
    world = corner.thread.runtime.world("corner")
    (plate,) = world.at("wc.shelf")
    with LabClient(corner.thread.url) as client:
        world.trip("pf400", "drops")
        run = corner.carry(client, "pf400", "shelf", "table", "ask")

        def list_asked() -> list[Any]:
            return list(client.state(waits=False)["interventions"])

        until(list_asked, "somebody is asked")
        assert client.status(run).status == "active"
        world.carry(plate, "wc.table")
        assert labos("resolve", list_asked()[0]["id"], "done", "--home", str(corner.home)).returncode == 0
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        # It is seen by its label from now on, and goes back when all goes well.
        back = corner.carry(client, "pf400", "table", "shelf")
        assert client.wait(back, timeout_s=PATIENCE_S).status == "completed"
    assert corner.differences() == []
    assert [event["looks"] for event in corner.list_payloads("action.reported")] == [
        ["corner/wc.shelf", "corner/wc.table"],
        ["corner/wc.table", "corner/wc.shelf"],
    ]


@pytest.mark.parametrize(
    "answer",
    [
        "unload",
        pytest.param("source", marks=pytest.mark.full),
        pytest.param("target", marks=pytest.mark.full),
    ],
)
def test_what_a_hand_kept_is_taken_out_of_it(corner: Corner, answer: str) -> None:
    home = ("--home", str(corner.home))
    with LabClient(corner.thread.url) as client:
        corner.thread.runtime.world("corner").trip("pf400", "keeps")
        run = corner.carry(client, "pf400", "shelf", "table")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "failed"
        until(lambda: corner.list_payloads("labware.observed"), "the arm says that it holds it")
        seen = labos("bench", "show", *home).stdout
        assert re.search(r"in the hand of pf400 +P1 \(plate96\)", seen), seen
        (question,) = client.state(waits=False)["interventions"]
        assert "now P1 was observed at pf400.gripper" in labos("interventions", *home).stdout
        resolved = ("resolve", question["id"], answer)
        told = ("unload", "pf400.gripper", "P1") if answer == "unload" else resolved
        assert labos(*told, *home).returncode == 0
        assert client.state(waits=False)["interventions"] == []
        seen = labos("bench", "show", *home).stdout
        assert "in the hand" not in seen
        assert "The log agrees" in seen
    assert corner.differences() == []
