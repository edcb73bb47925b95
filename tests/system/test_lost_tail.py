"""A log that lost its end: nothing starts before somebody has said what stands where."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.client import LabClient
from labos.core.state import LabState
from labos.errors import LabosError, Refused
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.testing.person import look
from tests.support.cells import PCR
from tests.support.lab_process import Up, statuses, until


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "1000", "--quiet")
    yield up
    up.clean_up()


def run_command(lab: Up, *argv: str, code: int = 0) -> str:
    result = CliRunner().invoke(group, [*argv, "--home", str(lab.home)])
    told = result.output + (str(result.exception) if isinstance(result.exception, LabosError) else "")
    assert result.exit_code == code, told
    return told


def count_done(lab: Up) -> int:
    return lab.types().count("action.succeeded")


def crashes(lab: Up) -> list[str]:
    return [f"{m.device} {m.facts['what']} at {m.place}" for m in lab.motions("crash")]


def cut(lab: Up, tmp_path: Path, after: int, more: int) -> str:
    """A PCR is under way; the lab is closed in order, and its log has lost what came behind ``after`` steps.
    Returns the run."""
    lab.start_with(*PCR)
    copy = tmp_path / "copy.db"
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        until(lambda: count_done(lab) >= after, "the run is on its way")
        with (
            closing(sqlite3.connect(lab.home / "labos.db")) as source,
            closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)
        until(lambda: count_done(lab) >= after + more, "it has gone on")
    assert lab.interrupt() == 0, lab.read_log()
    for file in lab.home.glob("labos.db*"):
        file.unlink()
    shutil.copy(copy, lab.home / "labos.db")
    return run


def answer_by_a_look(lab: Up, client: LabClient, *kinds: str) -> LabState:
    """Answer questions of these kinds as somebody does who looks at the bench; returns the state before."""
    state = LabState()
    fold(state, lab.records())
    world = World(str(lab.home / "world" / "rpl.db"))
    try:
        for question in state.interventions.open.values():
            if question.kind in kinds:
                client.resolve(question.id, look(world, state, question), by="ada")
    finally:
        world.close()
    return state


def is_settled(lab: Up, client: LabClient) -> bool:
    """Whether all is known that the log asks about actions that it knows."""
    return not answer_by_a_look(lab, client, "unknown_action", "lost_labware").actions.open


def the_round(lab: Up) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(run_command(lab, "bench", "round", "--json"))
    return told


@pytest.mark.parametrize(
    "after", [3, pytest.param(6, marks=pytest.mark.full), pytest.param(8, marks=pytest.mark.full)]
)
def test_nothing_moves_before_the_bench_was_compared(lab: Up, tmp_path: Path, after: int) -> None:
    run = cut(lab, tmp_path, after, 6)
    only_after_a_round(lab, run)


@pytest.mark.full
def test_a_flipped_byte_in_the_write_ahead_log_of_a_lab_that_was_killed(lab: Up) -> None:
    """SQLite drops what follows it, without a word."""
    lab.start_with(*PCR)
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        until(lambda: count_done(lab) >= 9, "the run is on its way")
    lab.kill()
    whole = len(lab.records())
    wal = lab.home / "labos.db-wal"
    data = bytearray(wal.read_bytes())
    data[len(data) * 3 // 4] ^= 1
    wal.write_bytes(data)
    assert len(lab.records()) < whole
    only_after_a_round(lab, run)


def only_after_a_round(lab: Up, run: str) -> None:
    """Nothing is requested before all was said, and after it a PCR runs without a collision."""
    length = len(lab.records())
    before = lab.bench()
    lab.start()
    with lab.client() as client:
        until(lambda: all(m["status"] != "GONE" for m in client.state()["modules"]), "all nodes are back")
        until(lambda: is_settled(lab, client), "what was under way is known")
        until(lambda: all(m["status"] == "IDLE" for m in client.state()["modules"]), "nothing moves")
        told = the_round(lab)
        assert told["evidence"]
        (asked,) = [q for q in client.state()["interventions"] if q["kind"] == "log_shorter"]
        # The answer alone is none.
        with pytest.raises(Refused, match="Nobody has reported what stands at"):
            client.resolve(asked["id"], "checked", by="ada")
        assert "nothing starts until the whole bench has been checked" in run_command(lab, "explain", run)
        assert "labos bench round" in run_command(lab, "explain", run)
        assert "nothing starts until the whole bench has been checked" in run_command(lab, "runs")
        waiting = client.submit("pcr", user="bo")
        assert "waits" in run_command(lab, "runs", waiting).lower()
        requested = [r for r in lab.records()[length:] if r.head.type == "action.requested"]
        assert requested == []
        assert lab.bench() == before
        # What is to be seen is said, and the lab goes on.
        answered = run_command(lab, "bench", "round", "--as-simulated", "--user", "ada")
        assert "is answered" in answered
        assert client.status(run).status == "cancelled"
        assert client.status(waiting).status == "paused"
        # All is where the log says. It cannot know of the work that it has lost.
        assert [found for found in lab.disagreements() if "times, the log says" not in found] == []
        client.cancel(waiting)
        answer_by_a_look(lab, client, "failed_run")  # what the run left is carried away
        if "Not known of biometra" in answered:
            assert statuses(client, [client.do("biometra", "open_lid", user="ada")]) == ["completed"]
        again = client.submit("pcr", user="cy")
        assert statuses(client, [again]) == ["completed"], run_command(lab, "explain", again)
    assert lab.interrupt() == 0, lab.read_log()
    assert crashes(lab) == []
    assert "is intact" in run_command(lab, "verify")
