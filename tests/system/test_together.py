"""Four plates of four runs in one centrifuge, with a real lab and a real node, either of which is killed."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.node.world import World
from tests.docs.markdown import REFERENCE, blocks
from tests.support.lab_process import PATIENCE_S, Up, until

PAGE = {block.title: block.text for block in blocks((REFERENCE / "workcell.md").read_text()) if block.title}
"""The workcell and the workflow that the page shows."""


class Spinning:
    """A lab with a centrifuge, and four runs in it."""

    def __init__(self, folder: Path) -> None:
        self.cell, self.workflow = folder / "centrifuge.yaml", folder / "spin-down.yaml"
        self.cell.write_text(PAGE["centrifuge.yaml"])
        self.workflow.write_text(PAGE["spin-down.yaml"])
        self.up = Up(folder / "lab", "--simulate", "--speed", "100")
        self.runs: list[str] = []

    def begin(self) -> None:
        """Four runs, until their plates are in the rotor and it turns."""
        self.up.start(str(self.cell))
        with self.up.client() as client:
            self.runs = [client.submit(self.workflow, user="ada") for _ in range(4)]
        until(lambda: len(self.requests()) == 4, "the rotor turns", 4 * PATIENCE_S)

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [json.loads(r.payload) for r in self.up.records() if r.head.type == kind]

    def requests(self) -> list[dict[str, Any]]:
        return [event for event in self.events("action.requested") if event["name"] == "spin"]

    def at_work(self) -> list[dict[str, Any]]:
        names = {request["action"] for request in self.requests()}
        return [event for event in self.events("action.accepted") if event["action"] in names]

    def spins(self) -> list[str]:
        """The plates that the device says it has spun."""
        world = World(str(self.up.home / "world" / "corner.db"))
        try:
            return [motion.plate for motion in world.motions("spin")]
        finally:
            world.close()

    def kill_node(self) -> None:
        [note] = [json.loads(n.read_text()) for n in (self.up.home / "nodes").glob("*spinner*.json")]
        os.kill(note["pid"], signal.SIGKILL)


@pytest.fixture
def spinning(tmp_path: Path) -> Iterator[Spinning]:
    lab = Spinning(tmp_path)
    yield lab
    lab.up.clean_up()


def check_ends(lab: Spinning) -> None:
    with lab.up.client() as client:
        statuses = [client.wait(run, timeout_s=4 * PATIENCE_S).status for run in lab.runs]
    assert statuses == ["completed"] * 4
    assert len(lab.spins()) == len(set(lab.spins())) == 4


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_lab_that_is_killed_while_the_rotor_turns_goes_on(spinning: Spinning) -> None:
    spinning.begin()
    spinning.up.kill()
    spinning.up.start()
    check_ends(spinning)
    [names] = {tuple(request["together"]) for request in spinning.requests()}
    assert sorted(names) == sorted({request["action"] for request in spinning.requests()})


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_node_that_is_killed_while_the_rotor_turns_asks_for_each(spinning: Spinning) -> None:
    spinning.begin()
    until(lambda: len(spinning.at_work()) == 4, "the node is at it")
    spinning.kill_node()
    with spinning.up.client() as client:
        until(lambda: len(client.state()["interventions"]) == 4, "each action is asked about", 2 * PATIENCE_S)
        assert spinning.spins() == []
        for question in client.state()["interventions"]:
            client.resolve(question["id"], "not_done", by="ada")
    check_ends(spinning)
