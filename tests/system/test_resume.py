"""A program of an experiment is killed with SIGKILL and started again, until it has come to its end.

The simulated bench says afterwards that each well was mixed once and one plate was used; the log says that
nothing was submitted, decided or computed twice.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.client import LabClient
from tests.support import mixing
from tests.support.lab_process import Up, until

MODULES = ("sciclops", "pf400", "ot2_cp_gamma", "camera_module")
ROUNDS = 2
BATCH = 12
"""Experiments that the plates and tips of one lab are enough for."""

LONGEST = 9 * BATCH
"""More events than an experiment of so many rounds has."""


@pytest.fixture
def up(tmp_path: Path) -> Iterator[Up]:
    running = Up(tmp_path / "lab", "--simulate", "--quiet", "--speed", "3000")
    try:
        yield running.start_with(*MODULES)
    finally:
        running.clean_up()


class Program:
    """The program of one experiment, in as many lives as it takes."""

    def __init__(self, up: Up) -> None:
        self.up = up
        with up.client() as client:
            self.begun = client.health()["position"]
        self.pipetted = len(up.motions("pipette"))
        self.name = ""
        self.lives = 0

    def start(self, die: str = "") -> subprocess.Popen[str]:
        argv = [sys.executable, "-m", mixing.__name__, "--home", str(self.up.home)]
        argv += ["--rounds", str(ROUNDS), "--die", die, "--resume", self.find()]
        self.lives += 1
        return subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)

    def find(self) -> str:
        """The id of its experiment, as a person reads it in the log; empty if it has not begun."""
        with self.up.client() as client:
            found = list(client.events(self.begun, type="experiment.started"))
        self.name = found[0]["payload"]["experiment"] if found else ""
        return self.name

    def live(self, die: str = "") -> list[float] | None:
        """One life: what it printed, or None if it was killed."""
        process = self.start(die)
        try:
            said, _ = process.communicate(timeout=100)
        finally:
            process.kill()
            process.wait()
        assert process.returncode in (0, -signal.SIGKILL), self.up.read_log()
        return json.loads(said) if process.returncode == 0 else None

    def events(self, client: LabClient) -> list[dict[str, Any]]:
        return list(client.events(self.begun, correlation=self.name)) if self.name else []

    def kill_at(self, number: int) -> bool:
        """Kill it when so many of its experiment's events are in the log; whether it lived to see them."""
        process = self.start()
        try:
            with self.up.client() as client:

                def is_so_far() -> bool:
                    self.name = self.name or self.find()
                    return len(self.events(client)) >= number or process.poll() is not None

                until(is_so_far, f"{number} events are in the log")
            lived = process.poll() is None
        finally:
            process.kill()
            process.wait()
            process.communicate()
        return lived

    def check(self, printed: list[float]) -> None:
        """Each well was mixed once, with what the log says, and nothing was asked for twice."""
        with self.up.client() as client:
            until(lambda: not client.state()["experiments"], "the experiment ends")
            events = self.events(client)
            assert client.state()["interventions"] == []
        mixed = [motion.facts for motion in self.up.motions("pipette")[self.pipetted :]]
        wells = [well for facts in mixed for well in facts["wells"]]
        assert sorted(wells) == ["A1", "A2", "B1", "B2"]
        submitted = [e["payload"] for e in events if e["type"] == "run.submitted"]
        assert Counter(run["workflow"] for run in submitted) == {
            "cp_newplate": 1,
            "cp_mixcolor": ROUNDS,
            "cp_trashplate": 1,
        }
        notes = [e["payload"] for e in events if e["type"] == "experiment.noted"]
        kinds = Counter(note["kind"] for note in notes)
        each = dict.fromkeys(("decision", "local_compute", "condition_checked"), ROUNDS)
        assert kinds == {"loop_started": 1, "loop_ended": 1, **each}
        assert printed == [note["facts"]["result"] for note in notes if note["kind"] == "local_compute"]
        ends = Counter(e["type"] for e in events if e["type"].startswith("experiment."))
        assert ends["experiment.ended"] == 1


def test_a_program_that_is_killed_at_each_of_its_messages_to_the_lab(up: Up) -> None:
    """In one experiment, one message after the other: before it is sent, and when it was carried out."""
    program = Program(up)
    printed = None
    while printed is None:
        # A program that goes on says so first.
        at = 2 if program.find() else 1
        printed = program.live(f"before:{at}")
        if printed is None:
            printed = program.live(f"after:{at}")
    assert program.lives >= 2 * 14
    program.check(printed)
    assert up.disagreements() == []


@pytest.mark.parametrize("number", [1, 9, 30, 55])
def test_a_program_that_is_killed_somewhere(up: Up, number: int) -> None:
    program = Program(up)
    assert program.kill_at(number)
    program.check(program.live() or [])
    assert up.disagreements() == []


@pytest.mark.full
@pytest.mark.timeout(900)
@pytest.mark.parametrize("first", range(1, LONGEST, BATCH))
def test_a_program_that_is_killed_after_each_commit(up: Up, first: int) -> None:
    for number in range(first, first + BATCH):
        program = Program(up)
        killed = program.kill_at(number)
        program.check(program.live() or [])
        if not killed:
            break
    else:
        assert first + BATCH <= LONGEST, "an experiment has more events than are tried"
    assert up.disagreements() == []
